"""shuttle_marl: two-player badminton for multi-agent reinforcement learning, learned from elite matches."""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

from shuttle_marl.gymnasium_ids import register_when_imported

if TYPE_CHECKING:
    from shuttle_marl.env import match_v0, rally_v0

__version__ = "0.1.0"

_ENVIRONMENTS = ("match_v0", "rally_v0")

__all__ = ["__version__", "match_v0", "rally_v0"]

register_when_imported()


def __getattr__(name: str) -> ModuleType:
    """The environments, imported when first asked for, so that ``import shuttle_marl`` needs no PettingZoo."""
    if name in _ENVIRONMENTS:
        return importlib.import_module(f"shuttle_marl.env.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_ENVIRONMENTS])
