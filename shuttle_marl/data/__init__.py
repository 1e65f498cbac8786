"""Annotated matches: schema of strokes, readers, cleaning, splits, and download.

Most users only need :func:`read_matches`.
"""

from shuttle_marl.data.cleaning import clean_matches
from shuttle_marl.data.schema import OUTCOMES, REASONS, STROKES, Account, Cleaned, DataError, Outcome, named, to_df
from shuttle_marl.data.table import Report, anonymised, provenance_of, read_matches, validate, write_parquet
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
    "matches_of",
    "named",
    "provenance_of",
    "read_matches",
    "split_of",
    "to_df",
    "validate",
    "write_parquet",
]
