"""A sequential test of who is better, which stops a pairing when it is decided: the generalised likelihood ratio of fishtest.

Cells of swapped seats are the units, as pairs of games are there; without draws, the five results of a pair are three: an entrant
wins neither match, one, or both. The ratio compares the likeliest distribution under which the first entrant is so many points
better with the likeliest under which the second one is; it crosses a bound of Wald's when one of them is to be rejected
(Van den Bergh, "Comments on normalized Elo"; Wald 1945).
"""

import math
from typing import Final

import numpy as np
from scipy.optimize import brentq

from shuttle_marl.arrays import F64

ERROR: Final = 0.05
"""Probability of each of the two errors, at the two hypotheses."""
BOUND: Final = math.log((1 - ERROR) / ERROR)
_RESULTS: Final = np.array([0.0, 0.5, 1.0])
_LEAST: Final = 1e-3
"""A result that was never seen counts this much, as in fishtest."""


def share_of(elo: float) -> float:
    """Expected share of matches of one who is so many Elo points better."""
    return 1 / (1 + 10 ** (-elo / 400))


def log_likelihood_ratio(cells: tuple[int, int, int], elo: float) -> float:
    """Log of the likelihood that the first entrant is ``elo`` points better over that it is ``elo`` points worse.

    Args:
        cells: in how many cells it won no match, one, both.
        elo: above 0.
    """
    counts = np.maximum(np.array(cells, dtype=np.float64), _LEAST)
    better, worse = (_likeliest(counts / counts.sum(), share_of(points)) for points in (elo, -elo))
    return float((counts * np.log(better / worse)).sum())


def _likeliest(shares: F64, mean: float) -> F64:
    """``[3]`` the likeliest distribution of results with a mean, by its multiplier (Owen 1988)."""
    away = _RESULTS - mean
    low, high = -1 / away.max(), -1 / away.min()
    room = 1e-9 * (high - low)
    multiplier = brentq(lambda m: float((shares * away / (1 + m * away)).sum()), low + room, high - room, xtol=1e-14)
    return np.asarray(shares / (1 + multiplier * away))


def decided(cells: tuple[int, int, int], elo: float) -> bool:
    """Whether it is decided which of the two is better, with an error of :data:`ERROR` if they are ``elo`` points apart."""
    return abs(log_likelihood_ratio(cells, elo)) >= BOUND
