"""Registration of the environment ids with Gymnasium and PettingZoo, when both are imported, in either order.

Gymnasium 1.0 stopped reading entry points, so a package registers its environments when it is imported. Importing a library
for that would make ``import shuttle_marl`` ten times slower; instead registration is deferred until another module imports it.
"""

import importlib.util
import itertools
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType


def register_for_gymnasium() -> None:
    """Register ``Rally-v0``, ``Match-v0``, ``RallyRecovery-v0`` and ``MatchRecovery-v0``; they are imported on creation."""
    from gymnasium.envs import registration  # noqa: PLC0415  imported on demand

    for name, variant in itertools.product(("Rally", "Match"), ("", "Recovery")):
        if f"shuttle_marl/{name}{variant}-v0" not in registration.registry:
            registration.register(
                f"shuttle_marl/{name}{variant}-v0",
                entry_point=f"shuttle_marl.env.single:Single{name}Env",
                vector_entry_point=f"shuttle_marl.env.vector:{name}VectorEnv",
                kwargs={"game": "default:recovery"} if variant else {},
            )


def register_for_pettingzoo() -> None:
    """Register ``shuttle_marl/rally-v0`` and ``shuttle_marl/match-v0`` with PettingZoo; versions before 1.27 have no registry."""
    import pettingzoo  # noqa: PLC0415  imported on demand

    known = getattr(pettingzoo, "aec_registry", None)
    for name in ("rally", "match"):
        if known is not None and f"shuttle_marl/{name}-v0" not in known:
            pettingzoo.register("aec", f"shuttle_marl/{name}-v0", f"shuttle_marl.env.{name}_v0:env")


class _AfterImport:
    """Import hook that registers the environments after a library was imported, but not if it was only searched for."""

    def __init__(self, library: str, register: Callable[[], None]) -> None:
        self._library, self._register = library, register
        self._asked = False

    def find_spec(self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:  # noqa: ARG002
        if name != self._library or self._asked:
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
            self._register()

        loader.exec_module = run_and_register  # type: ignore[method-assign]
        return spec


def register_when_imported() -> None:
    """Register with libraries that are already imported, and with the others after their import."""
    libraries = (
        ("gymnasium", "gymnasium.envs.registration", register_for_gymnasium),
        ("pettingzoo", "pettingzoo", register_for_pettingzoo),
    )
    for library, last_imported, register in libraries:
        if last_imported in sys.modules:
            register()
        else:
            sys.meta_path.insert(0, _AfterImport(library, register))
