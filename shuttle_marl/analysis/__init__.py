"""What was played, in figures: shot mix, tempo, endings, landings, transitions, and the value that each stroke added.

Everything works on stroke tables of one schema (:mod:`shuttle_marl.data.schema`), so annotated matches and rally logs go the
same ways. See ``docs/analysis.md``. Names are imported when first used.
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from shuttle_marl.analysis.errors import AnalysisError
    from shuttle_marl.analysis.logs import strokes_of, strokes_of_log
    from shuttle_marl.analysis.ranking import PlayerValue, rank_players
    from shuttle_marl.analysis.summary import Summary, rally_table, summarise
    from shuttle_marl.analysis.values import add_values

__all__ = [
    "AnalysisError",
    "PlayerValue",
    "Summary",
    "add_values",
    "rally_table",
    "rank_players",
    "strokes_of",
    "strokes_of_log",
    "summarise",
]

_MODULES: Final = {
    "errors": ("AnalysisError",),
    "logs": ("strokes_of", "strokes_of_log"),
    "ranking": ("PlayerValue", "rank_players"),
    "summary": ("Summary", "rally_table", "summarise"),
    "values": ("add_values",),
}
_HOME: Final = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"shuttle_marl.analysis.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
