"""Registration of the environment ids with Gymnasium, before or after it is imported, and with PettingZoo, which comes before.

Gymnasium 1.0 stopped reading entry points, so a package registers its environments when it is imported. Importing a library
for that would make ``import shuttle_marl`` ten times slower; instead the first search for a module after a library has loaded its
registry registers them. Gymnasium searches for more modules while it is imported; PettingZoo does not.
"""

import sys
from collections.abc import Callable
from types import ModuleType
from typing import Final


def _for_gymnasium(registration: ModuleType) -> None:
    for name in ("Rally", "Match"):
        for variant, kwargs in (("", {}), ("Recovery", {"game": "default:recovery"})):
            registration.register(
                f"shuttle_marl/{name}{variant}-v0",
                entry_point=f"shuttle_marl.env.single:Single{name}Env",
                vector_entry_point=f"shuttle_marl.env.vector:{name}VectorEnv",
                kwargs=kwargs,
            )


def _for_pettingzoo(registration: ModuleType) -> None:
    for name in ("rally", "match"):
        registration.register("aec", f"shuttle_marl/{name}-v0", f"shuttle_marl.env.{name}_v0:env")


_REGISTRIES: Final[dict[str, Callable[[ModuleType], None]]] = {
    "gymnasium.envs.registration": _for_gymnasium,
    "pettingzoo.env_registry.registration": _for_pettingzoo,  # versions before 1.27 have none
}


class RegistersLoaded:
    """Finder that finds no module, and registers the environments once a registry is loaded."""

    def __init__(self) -> None:
        self._waiting = dict(_REGISTRIES)

    def find_spec(self, *_: object) -> None:
        """Register with the libraries that are imported."""
        for name in [name for name in self._waiting if hasattr(sys.modules.get(name), "register")]:
            self._waiting.pop(name)(sys.modules[name])
