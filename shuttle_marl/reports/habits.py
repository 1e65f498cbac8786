"""Habits: how a player plays in common situations, compared with other players, and which differences are more than chance.

Differences of the counts of two tallies (:mod:`shuttle_marl.dynamics.habits`) are tested together, with the false discovery rate
of Benjamini & Hochberg (J. R. Stat. Soc. B 57, 1995).
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy import stats

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.dynamics.habits import QUESTIONS, Tally
from shuttle_marl.game.shipped import RELIABLE
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES
from shuttle_marl.reports.value import NORMAL

FALSE_DISCOVERIES: Final = 0.05
LEAST_DIFFERENCE: Final = 0.03
"""Smaller differences of shares are of no use on court and are not reported."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Habit:
    """A share of strokes beside that of others.

    Attributes:
        kind, about, answer: the question and the answer.
        strokes: number of strokes of the player that the question asks about.
        share, low, high: share of the answer among them, with its 90 % interval.
        usual: share of the others.
        p: p-value of the difference.
        clear: whether the difference is more than chance, with a correction for the number of differences, and large enough.
    """

    kind: str
    about: tuple[str, ...]
    answer: str
    strokes: float
    share: float
    low: float
    high: float
    usual: float
    p: float
    clear: bool = False


def habits(mine: Tally, others: Tally, *, dispersed: bool = True) -> list[Habit]:
    """Shares of a player beside those of others, for all questions with enough strokes.

    Args:
        mine, others: counted strokes.
        dispersed: whether counts vary by their dispersion; else they are independent, as within one match.
    """
    found: list[Habit] = []
    for number, question in enumerate(QUESTIONS):
        counts = [each.answers(number) for each in (mine, others)]
        n, m = (float(count.sum()) for count in counts)
        if n < RELIABLE or m < RELIABLE:
            continue
        scale = float(max(mine.dispersion[number], others.dispersion[number])) if dispersed else 1.0
        for k, name in enumerate(question.answers):
            share, usual = counts[0][k] / n, counts[1][k] / m
            if max(counts[0][k], usual * n) < 1 or (question.kind == "serve" and k > 0):
                continue
            error = float(difference_error(counts[0][k], n, counts[1][k], m, scale))
            p = float(2 * stats.norm.sf(abs(share - usual) / error)) if error > 0 else 1.0
            low, high = interval(share, n / scale)
            about = question.about
            found.append(
                Habit(kind=question.kind, about=about, answer=name, strokes=n, share=share, low=low, high=high, usual=usual, p=p)
            )
    return sorted(
        with_discoveries(found), key=lambda habit: (not habit.clear, -abs(habit.share - habit.usual) * np.sqrt(habit.strokes))
    )


def with_discoveries(found: Sequence[Habit]) -> list[Habit]:
    """The habits, with those marked whose difference from the others is more than chance."""
    clear = discoveries([habit.p for habit in found])
    return [
        dataclasses.replace(habit, clear=bool(mark) and abs(habit.share - habit.usual) >= LEAST_DIFFERENCE)
        for habit, mark in zip(found, clear, strict=True)
    ]


def discoveries(p: Sequence[float]) -> Bools:
    """``[N]`` which of N hypotheses are rejected, with a false discovery rate of 5 %."""
    if not len(p):
        return np.zeros(0, np.bool_)
    return np.asarray(stats.false_discovery_control(np.asarray(p)) <= FALSE_DISCOVERIES)


def difference_error(won: Any, n: Any, others_won: Any, m: Any, scale: float = 1.0) -> F64:
    """Standard error of the difference of two shares, won of n and of m, if both are the same one; any shape.

    Args:
        scale: dispersion of the counts.
    """
    pooled = (won + others_won) / (n + m)
    return np.asarray(np.sqrt(scale * pooled * (1 - pooled) * (1 / n + 1 / m)))


def interval(share: float, n: float, z: float = NORMAL) -> tuple[float, float]:
    """Wilson's 90 % interval of a share of n independent strokes; n may be fractional."""
    centre, width = share + z * z / (2 * n), z * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    return max(0.0, float((centre - width) / scale)), min(1.0, float((centre + width) / scale))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ending:
    """Shares of faults and winners among the strokes of one shot type.

    Attributes:
        shot, technique: shot type, and technique; None: all of them.
        fault, winner: shares, each with the 90 % interval and the share of the others.
        clear: whether the share of faults, and that of winners, differs by more than chance.
    """

    shot: str
    technique: str | None
    strokes: float
    fault: tuple[float, float, float, float]
    winner: tuple[float, float, float, float]
    clear: tuple[bool, bool]


def endings(mine: Tally, others: Tally) -> list[Ending]:
    """Faults and winners of a player beside others, by shot type, and by shot type and technique, for enough strokes."""
    kinds: list[tuple[str, str | None]] = [(shot, None) for shot in SHOTS]
    kinds += [(shot, technique) for shot in SHOTS for technique in TECHNIQUES]
    counts = [
        np.concatenate([each.ends.sum(axis=1), each.ends[:, :-1].reshape(-1, 3)]).astype(np.float64) for each in (mine, others)
    ]
    n, m = (count[:, :1] for count in counts)
    enough = np.flatnonzero((n[:, 0] >= RELIABLE) & (m[:, 0] >= RELIABLE))
    if not len(enough):
        return []
    n, m = n[enough], m[enough]
    shares, usual = (count[enough, 1:] / size for count, size in zip(counts, (n, m), strict=True))
    error = difference_error(shares * n, n, usual * m, m)
    with np.errstate(invalid="ignore"):
        p = np.where(error > 0, 2 * stats.norm.sf(np.abs(shares - usual) / error), 1.0)
    clear = discoveries(p.ravel().tolist()).reshape(-1, 2)
    found = []
    for i, kind in enumerate(enough.tolist()):
        size = float(n[i, 0])
        fault, winner = ((s, *interval(s, size), u) for s, u in zip(shares[i].tolist(), usual[i].tolist(), strict=True))
        shot, technique = kinds[kind]
        mark = bool(clear[i, 0]), bool(clear[i, 1])
        found.append(Ending(shot=shot, technique=technique, strokes=size, fault=fault, winner=winner, clear=mark))
    return found
