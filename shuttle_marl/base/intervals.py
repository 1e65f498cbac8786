"""Wilson intervals; and statistics over training seeds: interquartile means and the probability of improvement.

The latter are as recommended by Agarwal et al. (NeurIPS 2021, arXiv 2108.13264) for few runs: the interquartile mean is robust to
single runs, and the bootstrap is stratified by task.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy  # its parts are imported when first used

from shuttle_marl.base.arrays import F64

RESAMPLES: Final = 10_000
TRIMMED: Final = 0.25  # fraction of the runs that an interquartile mean leaves out at each end


class Interval(NamedTuple):
    """A figure and its 95 % interval; the bounds are NaN for a single run."""

    value: float
    low: float
    high: float


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a probability, from at least one trial (Wilson, J. Am. Stat. Assoc. 1927)."""
    z, share = float(scipy.special.ndtri(0.975)), successes / trials
    whole = 2 * (trials + z**2)
    middle, off = (2 * trials * share + z**2) / whole, z / whole * math.sqrt(4 * trials * share * (1 - share) + z**2)
    return middle - off if successes else 0.0, middle + off if successes < trials else 1.0


def trim_mean(runs: npt.ArrayLike, axis: int = -1) -> F64:
    """The mean without the :data:`TRIMMED` smallest and largest, bit for bit that of ``scipy.stats``, which is slow to import."""
    values = np.asarray(runs)
    cut, n = int(TRIMMED * values.shape[axis]), values.shape[axis]
    middle = np.take(np.partition(values, (cut, n - cut - 1), axis), np.arange(cut, n - cut), axis)
    return np.asarray(middle.mean(axis=axis))


def interquartile_mean(tasks: Sequence[Sequence[float]], seed: int = 0) -> Interval:
    """Mean of the middle half of all runs of all tasks, at least one; the bootstrap resamples the runs of each task."""

    def middle(*columns: F64, axis: int = -1) -> F64:
        return trim_mean(np.concatenate(columns, axis=axis), axis)

    samples = [np.asarray(runs, dtype=np.float64) for runs in tasks]
    return _interval(float(middle(*samples)), samples, middle, seed)


def probability_of_improvement(ours: Sequence[float], theirs: Sequence[float]) -> Interval:
    """Probability that a run of ours, at least one, has a larger figure than a run of theirs; ties count half."""

    def larger(x: F64, y: F64, axis: int = -1) -> F64:
        # The Mann-Whitney statistic, from the ranks in the pooled runs.
        ranks = scipy.stats.rankdata(np.concatenate([x, y], axis=axis), axis=axis)
        n, m = x.shape[axis], y.shape[axis]
        own = np.take(ranks, np.arange(n), axis=axis).sum(axis=axis)
        return np.asarray((own - n * (n + 1) / 2) / (n * m))

    samples = [np.asarray(runs, dtype=np.float64) for runs in (ours, theirs)]
    return _interval(float(larger(samples[0], samples[1])), samples, larger)


def _interval(value: float, samples: list[F64], statistic: object, seed: int = 0) -> Interval:
    if any(len(sample) < 2 for sample in samples):
        return Interval(value, float("nan"), float("nan"))
    if np.ptp(np.concatenate(samples)) == 0:
        return Interval(value, value, value)
    found = scipy.stats.bootstrap(samples, statistic, n_resamples=RESAMPLES, method="percentile", vectorized=True, rng=seed)
    return Interval(value, float(found.confidence_interval.low), float(found.confidence_interval.high))
