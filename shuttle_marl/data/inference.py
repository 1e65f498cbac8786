"""What a stroke table lacks, from other values: areas and serves from the next stroke, winners from scores."""

import re
import unicodedata
from collections.abc import Sequence
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import SHOTS

MET: Final[dict[str, tuple[tuple[str, float], ...]]] = {
    "clear": (("back-left", 0.24), ("back-right", 0.37), ("back-left", 0.42), ("back-left", 0.39)),
    "lift": (("front-centre", 0.30), ("front-right", 0.48), ("front-left", 0.48), ("front-centre", 0.30)),
    "drop": (("back-right", 0.29), ("back-right", 0.39), ("back-left", 0.43), ("back-left", 0.40)),
    "smash": (("back-centre", 0.25), ("back-centre", 0.28), ("middle-left", 0.33), ("back-left", 0.28)),
    "half-smash": (("back-centre", 0.21), ("back-right", 0.25), ("middle-left", 0.47), ("back-left", 0.31)),
    "drive": (("middle-centre", 0.37), ("middle-right", 0.30), ("middle-centre", 0.51), ("middle-centre", 0.65)),
    "push": (("front-centre", 0.33), ("front-right", 0.37), ("front-left", 0.40), ("front-centre", 0.33)),
    "net-kill": (("front-centre", 0.37), ("front-centre", 0.41), ("front-left", 0.47), ("front-centre", 0.37)),
    "net-shot": (("front-centre", 0.35), ("front-centre", 0.38), ("front-left", 0.41), ("front-centre", 0.35)),
    "block": (("middle-left", 0.37), ("middle-right", 0.63), ("middle-left", 0.57), ("middle-left", 0.37)),
    "cross-court-net-shot": (("front-left", 0.21), ("front-right", 0.36), ("front-left", 0.39), ("front-left", 0.21)),
}
"""Where a stroke was met whose reply is of a shot type: the most frequent area and its share in the published train matches, by
technique of the reply: not known, forehand, backhand, around the head (that of all where these are fewer than 30)."""
_AREA: Final = np.full((len(SHOTS), 4), -1)
_SHARE: Final = np.full((len(SHOTS), 4), np.nan)
for _shot, _entries in MET.items():
    _AREA[SHOTS.index(_shot)] = [AREAS.index(area) for area, _ in _entries]
    _SHARE[SHOTS.index(_shot)] = [share for _, share in _entries]
LONG_REPLIES: Final = tuple(SHOTS.index(name) for name in ("clear", "drop", "smash", "half-smash"))
"""Shot types of replies to long serves: 99 % of these in the published matches, and 1 % of the others."""
PAUSE: Final = 4.0
"""Time between two strokes that ends a rally [s]."""
_SCORE: Final = re.compile(r"\s*(\d{1,2})\s*[-:/\N{EN DASH}\N{EM DASH} ]\s*(\d{1,2})\s*")

Points = tuple[int, int]


def areas_met(reply: I64, technique: I64) -> tuple[I64, F64]:
    """``[n]`` areas where strokes were met, -1 not known, and their shares.

    Args:
        reply: ``[n]`` shot type of the next stroke, -1 without one.
        technique: ``[n]`` its technique, -1 not known.
    """
    known = (reply >= 0) & (reply < len(SHOTS))
    shot = np.where(known, reply, 0)
    area = np.where(known, _AREA[shot, technique + 1], -1)
    return area, np.where(area >= 0, _SHARE[shot, technique + 1], np.nan)


def read_score(text: str) -> Points | None:
    """Two numbers such as ``5-3``; None for other text."""
    found = _SCORE.fullmatch(unicodedata.normalize("NFKC", text))
    return None if found is None else (int(found[1]), int(found[2]))


def winners_by_score(
    scores: Sequence[Points | None], fresh: Bools, server: Sequence[int], told: Sequence[int]
) -> tuple[list[Points | None], list[int], str]:
    """Scores after each rally and winners, in the reading of the scores that agrees best with what else is known.

    Args:
        scores: of each rally, in an unknown order, before or after it; None not known.
        fresh: whether a rally is the first of its game.
        server: 0 or 1.
        told: the winner, where another value tells it; else -1.

    Returns:
        Points of 0 and 1 after each rally; winners, -1 not known; and the reading in words.
    """
    readings: list[tuple[int, int, int, list[Points | None], list[int], str]] = []
    for before in (False, True):
        for order, whose in enumerate(("the first striker's", "the other player's", "the server's")):
            first = [(0, 1, server[r])[order] for r in range(len(scores))]
            points = [s if s is None or who == 0 else s[::-1] for s, who in zip(scores, first, strict=True)]
            after, won, wrong = _followed(points, fresh, told, before=before)
            agree = sum(a == b >= 0 for a, b in zip(won, told, strict=True))
            wrong += sum(0 <= a != b >= 0 for a, b in zip(won, told, strict=True))
            words = f"the score is that {'before' if before else 'after'} the rally; the first number is {whose}"
            readings.append((wrong, -agree, len(readings), after, won, words))
    *_, after, won, words = min(readings, key=lambda reading: reading[:3])
    return after, won, words


def _followed(
    points: Sequence[Points | None], fresh: Bools, told: Sequence[int], *, before: bool
) -> tuple[list[Points | None], list[int], int]:
    """Scores after each rally, winners, and the number of impossible changes."""
    won, after, wrong = [], [], 0
    for r, here in enumerate(points):
        last = r + 1 == len(points) or bool(fresh[r + 1])
        if before:
            start, end = here, None if last else points[r + 1]
            wrong += bool(fresh[r]) and here is not None and here != (0, 0)
        else:
            start, end = (0, 0) if fresh[r] else points[r - 1], here
        gained = None if start is None or end is None else (end[0] - start[0], end[1] - start[1])
        won.append({(1, 0): 0, (0, 1): 1}.get(gained, -1) if gained else -1)
        wrong += gained is not None and won[-1] < 0
        if before and end is None and here is not None and told[r] >= 0:
            end = (here[0] + (told[r] == 0), here[1] + (told[r] == 1))
        after.append(end)
    return after, won, wrong
