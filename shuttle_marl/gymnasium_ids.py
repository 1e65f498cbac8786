"""Tells Gymnasium the ids of the environments as soon as both packages are imported, in either order.

Gymnasium 1.0 stopped reading entry points, so a package registers its environments when it is imported. Importing Gymnasium
for that would make ``import shuttle_marl`` ten times slower; instead the registration waits until another module does.
"""

import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType


def register() -> None:
    """Register ``shuttle_marl/Rally-v0`` and ``shuttle_marl/Match-v0``; the environments are imported when they are made."""
    from gymnasium.envs import registration  # noqa: PLC0415  waits until Gymnasium is wanted

    if "shuttle_marl/Rally-v0" in registration.registry:
        return
    registration.register(
        "shuttle_marl/Rally-v0",
        entry_point="shuttle_marl.env.single:SingleRallyEnv",
        vector_entry_point="shuttle_marl.env.vector:RallyVectorEnv",
    )
    registration.register("shuttle_marl/Match-v0", entry_point="shuttle_marl.env.single:SingleMatchEnv")


class _AfterGymnasium(MetaPathFinder):
    """Lets Python find Gymnasium as always, and registers when it has been imported, not when it was only looked for."""

    def __init__(self) -> None:
        self._asked = False

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:  # noqa: ARG002
        if name != "gymnasium" or self._asked:
            return None
        self._asked = True
        try:
            spec = importlib.util.find_spec(name)
        finally:
            self._asked = False
        if spec is None or spec.loader is None:
            return spec
        loader, run = spec.loader, spec.loader.exec_module

        def run_and_register(module: ModuleType) -> None:
            if self in sys.meta_path:
                sys.meta_path.remove(self)
            loader.exec_module = run  # type: ignore[method-assign]
            run(module)
            register()

        loader.exec_module = run_and_register  # type: ignore[method-assign]
        return spec


def register_when_imported() -> None:
    """Register now if Gymnasium is imported already, else when it will be."""
    if "gymnasium.envs.registration" in sys.modules:
        register()
    else:
        sys.meta_path.insert(0, _AfterGymnasium())
