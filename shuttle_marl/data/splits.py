"""The fixed splits of the matches: train, validation, test.

Test is the twelve matches of ShuttleSet22 named in ``splits.json``; nothing is fitted or chosen on them. Validation was
drawn once, by match, from the rest: within each stratum (data set x discipline) the matches were ordered by the SHA-256
of their names and the first of them taken, 14 in all. Train is what remains.
"""

import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, get_args

Split = Literal["train", "validation", "test"]
SPLITS: Final[tuple[Split, ...]] = get_args(Split)


@functools.cache
def _by_match() -> dict[str, Split]:
    names = json.loads((Path(__file__).parent / "splits.json").read_text(encoding="utf-8"))
    return {match: split for split in SPLITS for match in names[split]}


def split_of(match: str) -> Split | None:
    """Split of a match, None for a match that is in neither data set."""
    return _by_match().get(match)


def matches_of(split: Split) -> Sequence[str]:
    """Names of the matches of a split."""
    return [match for match, other in _by_match().items() if other == split]
