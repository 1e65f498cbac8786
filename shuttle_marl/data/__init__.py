"""Annotated matches: one schema, readers, cleaning, splits, download, and simulated games.

``load_strokes`` is all that most users need; the rest is for those who make or check data.
"""

from shuttle_marl.data.schema import OUTCOMES, REASONS, STROKES, Outcome
from shuttle_marl.data.strict_csv import DataError
from shuttle_marl.data.table import Account, Cleaned, clean_matches, load_account, load_strokes
from shuttle_marl.data.upstream import SPLITS, Split, matches_of, split_of

__all__ = [
    "OUTCOMES",
    "REASONS",
    "SPLITS",
    "STROKES",
    "Account",
    "Cleaned",
    "DataError",
    "Outcome",
    "Split",
    "clean_matches",
    "load_account",
    "load_strokes",
    "matches_of",
    "split_of",
]
