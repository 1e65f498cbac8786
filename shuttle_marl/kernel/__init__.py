"""The game compiled to machine code: rallies by the thousand, against tabulated opponents, and whole tournaments.

Names are imported when first used, because numba takes longer to import than a command's help.
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from shuttle_marl.kernel.core import KernelError, Players, pack
    from shuttle_marl.kernel.matches import play_matches
    from shuttle_marl.kernel.played import Matches, Played
    from shuttle_marl.kernel.rally import RallyBatch, Tally
    from shuttle_marl.kernel.rows import IllegalStrokeError
    from shuttle_marl.kernel.versus import VersusBatch

__all__ = [
    "IllegalStrokeError",
    "KernelError",
    "Matches",
    "Played",
    "Players",
    "RallyBatch",
    "Tally",
    "VersusBatch",
    "pack",
    "play_matches",
]

_MODULES: Final = {
    "core": ("KernelError", "Players", "pack"),
    "matches": ("play_matches",),
    "played": ("Matches", "Played"),
    "rally": ("RallyBatch", "Tally"),
    "rows": ("IllegalStrokeError",),
    "versus": ("VersusBatch",),
}
_HOME: Final = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"shuttle_marl.kernel.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
