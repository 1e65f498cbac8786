"""Figures over training seeds: the interquartile mean, the probability of improvement, and their intervals.

As Agarwal et al. (NeurIPS 2021, arXiv 2108.13264) advise where there are few runs: the mean of the middle half is hardly moved by
one run, and the bootstrap is stratified, so each task keeps its number of runs.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import bootstrap, rankdata, trim_mean

from shuttle_marl.arrays import F64

RESAMPLES: Final = 10_000
_TRIMMED: Final = 0.25


class Interval(NamedTuple):
    """A figure and its 95 % interval; NaN ends where there is one run only."""

    value: float
    low: float
    high: float


def interquartile_mean(tasks: Sequence[Sequence[float]], seed: int = 0) -> Interval:
    """Mean of the middle half of all runs of all tasks.

    Args:
        tasks: figures of the runs, by task; one run or more of each.
        seed: of the resampling.
    """

    def middle(*columns: F64, axis: int = -1) -> F64:
        # The runs of all tasks are one sample.
        return np.asarray(trim_mean(np.concatenate(columns, axis=axis), _TRIMMED, axis=axis))

    samples = [np.asarray(task, dtype=np.float64) for task in tasks]
    return _interval(float(middle(*samples)), samples, middle, seed)


def probability_of_improvement(ours: Sequence[float], theirs: Sequence[float], seed: int = 0) -> Interval:
    """Probability that a run of ours has a larger figure than one of theirs, half of it where they are equal.

    Args:
        ours: figures of one way to train, one or more.
        theirs: of the other.
        seed: of the resampling.
    """

    def larger(x: F64, y: F64, axis: int = -1) -> F64:
        # The statistic of Mann and Whitney, from the ranks of all runs together.
        ranks = rankdata(np.concatenate([x, y], axis=axis), axis=axis)
        n, m = x.shape[axis], y.shape[axis]
        own = np.take(ranks, np.arange(n), axis=axis).sum(axis=axis)
        return np.asarray((own - n * (n + 1) / 2) / (n * m))

    samples = [np.asarray(runs, dtype=np.float64) for runs in (ours, theirs)]
    return _interval(float(larger(samples[0], samples[1])), samples, larger, seed)


def _interval(value: float, samples: list[F64], statistic: object, seed: int) -> Interval:
    if any(len(sample) < 2 for sample in samples):
        return Interval(value, float("nan"), float("nan"))
    if np.ptp(np.concatenate(samples)) == 0:
        return Interval(value, value, value)
    found = bootstrap(samples, statistic, n_resamples=RESAMPLES, method="percentile", vectorized=True, rng=seed)
    return Interval(value, float(found.confidence_interval.low), float(found.confidence_interval.high))
