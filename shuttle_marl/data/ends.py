"""Players who are named by an end of the court or of the picture, which they change between games."""

import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from shuttle_marl.data.words import Words, bare

_OTHER: Final = {"near": "far", "far": "near", "left": "right", "right": "left"}
_DECIDER: Final = 3
"""Game within which the players change ends."""
_PLACE: Final = re.compile("player|court|side|half|end")
EXCHANGED: Final = "names of the ends: those of the first game of a match, exchanged in the second, because the players change"
OF_ONE_GAME: Final = "names of the ends: the same in all rallies, because they are of one game by their numbers"
UNKNOWN: Final = "the players change ends in the third game, and with one name nobody knows the other; name them in each row"


@functools.lru_cache(maxsize=1 << 12)
def end_of(word: str) -> str:
    """``near``, ``far``, ``left`` or ``right`` for the name of an end, such as *top* or *player_near*; else empty."""
    word = _PLACE.sub("", bare(word))
    found = Words("side", ()).meaning(word) or Words("side_of_area", ()).meaning(word) or ""
    return found if found in _OTHER else ""


def ends_in(names: Mapping[str, str]) -> dict[str, str]:
    """Names by end, of a mapping in which some keys are names of ends."""
    return {end: name for word, name in names.items() if (end := end_of(word))}


def at_ends(ends: Mapping[str, str], words: Sequence[str], games: Iterable[int], first: int) -> list[str]:
    """Names of players who are named by the ends of a match, empty where they cannot be known (:data:`UNKNOWN`).

    Args:
        ends: names by end in the first game, see :func:`ends_in`.
        words: the end of each player.
        games: its game, from 1.
        first: the first game of the match, or of the part of the file in which the names hold.
    """
    return [
        ends.get(end_of(word) if game == first else _OTHER.get(end_of(word), ""), "") if game < _DECIDER else ""
        for word, game in zip(words, games, strict=True)
    ]
