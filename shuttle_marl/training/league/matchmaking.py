"""Opponents of a learner: weights of the policies so far, and the order in which they come.

Prioritised fictitious self-play (Vinyals et al., Nature 2019) draws an opponent by a function of the probability of beating it.
Such weights vanish when every opponent is beaten for certain: then all are met alike. So weights are always positive and finite.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.arrays import F64, I64, Floats

FLOOR: Final = 0.02
"""Share of the weight that is spread over all alike, so that none is forgotten for good."""
_HARD: Final = 2.0
"""Exponent: an opponent that is beaten with probability p has the weight (1 - p)^2."""


def uniform(count: int) -> F64:
    """``[K]`` equal weights."""
    return np.full(count, 1 / count) if count else np.zeros(0)


def prioritised(win: npt.ArrayLike) -> F64:
    """``[K]`` weights of opponents by the probability of beating each.

    Args:
        win: ``[K]`` probabilities that the learner beats the opponent; NaN where it is not known: that counts as one half.

    Returns:
        Probabilities, none of them 0.
    """
    p = np.asarray(win, dtype=np.float64)
    p = np.clip(np.where(np.isnan(p), 0.5, p), 0.0, 1.0)
    if not len(p):
        return p
    weight = (1 - p) ** _HARD
    total = float(weight.sum())
    # Where all are beaten for certain, nothing tells them apart.
    shares = weight / total if total > 1e-12 else uniform(len(p))
    return (1 - FLOOR) * shares + FLOOR / len(p)


def chosen(weight: Floats, most: int, rng: np.random.Generator) -> tuple[I64, F64]:
    """Some opponents and how often each is met.

    Args:
        weight: ``[K]`` of the opponents, from 0 on.
        most: number of opponents that can be met in one turn.
        rng: draws them where there are more, without repetition and with probabilities by weight.

    Returns:
        ``[M]`` their numbers, ascending, and ``[M]`` shares that add up to 1.
    """
    positive = np.flatnonzero(np.asarray(weight) > 0)
    if len(positive) <= most:
        return positive, np.asarray(weight[positive] / weight[positive].sum()) if len(positive) else np.zeros(0)
    p = weight[positive] / weight[positive].sum()
    drawn = np.sort(rng.choice(positive, most, replace=False, p=p))
    # Who is drawn stands for all: inclusion grows with the weight, so those drawn are met alike often in expectation.
    return drawn, uniform(most)


def order(shares: Sequence[float], length: int = 200) -> I64:
    """``[length]`` numbers of opponents in the order in which they are met, each as often as its share says and evenly spread.

    Args:
        shares: of each opponent; what they lack to 1 is the learner itself, number -1.
        length: of the order, which is repeated.
    """
    full = np.r_[max(0.0, 1 - float(np.sum(shares))), np.asarray(shares, dtype=np.float64)]
    full /= full.sum()
    owed = np.zeros(len(full))
    out = np.empty(length, np.int64)
    for k in range(length):
        owed += full
        out[k] = int(owed.argmax())
        owed[out[k]] -= 1
    return out - 1
