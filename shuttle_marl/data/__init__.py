"""Annotated matches: schema of strokes, readers, cleaning, splits, and download.

Most users only need :func:`load_strokes`.
"""

from shuttle_marl.data.cleaning import clean_matches
from shuttle_marl.data.schema import OUTCOMES, REASONS, STROKES, Account, Cleaned, Outcome, named
from shuttle_marl.data.strict_csv import DataError
from shuttle_marl.data.table import Report, anonymised, load_account, load_strokes, provenance_of, validate, write_parquet
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
    "Report",
    "Split",
    "anonymised",
    "clean_matches",
    "load_account",
    "load_strokes",
    "matches_of",
    "named",
    "provenance_of",
    "split_of",
    "validate",
    "write_parquet",
]
