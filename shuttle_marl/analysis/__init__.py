"""Figures of what was played: shot mix, tempo, endings, landings, transitions, and the value that each stroke added.

Everything works on stroke tables of one schema (:mod:`shuttle_marl.data.schema`), so annotated matches and rally logs go the
same ways. See ``docs/analysis.md``. Names are imported when first used.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from shuttle_marl.analysis.summary import AnalysisError, Summary, rally_table, strokes_of, strokes_of_log, summarise
    from shuttle_marl.analysis.values import PlayerValue, add_values, rank_players

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

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "summary": ("AnalysisError", "Summary", "rally_table", "strokes_of", "strokes_of_log", "summarise"),
        "values": ("PlayerValue", "add_values", "rank_players"),
    },
)
