"""Annotated matches: one schema, readers, cleaning, splits, download, and simulated games.

``load_strokes`` is all that most users need; the rest is for those who make or check data.
"""

from shuttle_marl.data.account import Account
from shuttle_marl.data.clean import Cleaned, clean_matches
from shuttle_marl.data.errors import DataError
from shuttle_marl.data.schema import OUTCOMES, REASONS, STROKES
from shuttle_marl.data.splits import SPLITS, Split, matches_of, split_of
from shuttle_marl.data.table import load_account, load_strokes

__all__ = [
    "OUTCOMES",
    "REASONS",
    "SPLITS",
    "STROKES",
    "Account",
    "Cleaned",
    "DataError",
    "Split",
    "clean_matches",
    "load_account",
    "load_strokes",
    "matches_of",
    "split_of",
]
