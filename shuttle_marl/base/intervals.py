"""Statistics over training seeds: interquartile means, probability of improvement, and intervals.

As recommended by Agarwal et al. (NeurIPS 2021, arXiv 2108.13264) for few runs: the interquartile mean is robust to single runs,
and the bootstrap is stratified by task.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import bootstrap, rankdata, trim_mean
from scipy.stats import t as student

from shuttle_marl.base.arrays import F64

RESAMPLES: Final = 10_000
_TRIMMED: Final = 0.25


class Interval(NamedTuple):
    """A figure and its 95 % interval; the bounds are NaN for a single run."""

    value: float
    low: float
    high: float


def interquartile_mean(tasks: Sequence[Sequence[float]], seed: int = 0) -> Interval:
    """Mean of the middle half of all runs of all tasks; the bootstrap resamples the runs of each task.

    Args:
        tasks: figures of the runs of each task, at least one.
    """

    def middle(*columns: F64, axis: int = -1) -> F64:
        return np.asarray(trim_mean(np.concatenate(columns, axis=axis), _TRIMMED, axis=axis))

    samples = [np.asarray(runs, dtype=np.float64) for runs in tasks]
    return _interval(float(middle(*samples)), samples, middle, seed)


class Moments(NamedTuple):
    """A mean with the variance of its error, and the degrees of freedom of that; without a variance it is NaN."""

    value: float
    variance: float
    freedom: int


def estimate(sample: Sequence[float] | F64, *, trimmed: bool) -> Moments:
    """The mean of a sample, or its interquartile mean.

    The variance is that of a trimmed mean, from the winsorised sample (Tukey & McLaughlin, Sankhya A 25, 1963; Yuen, Biometrika
    61, 1974).

    Args:
        sample: at least one figure.
        trimmed: leave out the lowest and the highest quarter, rounded down.
    """
    ordered = np.sort(np.asarray(sample, dtype=np.float64))
    cut = int(_TRIMMED * len(ordered)) if trimmed else 0
    kept = ordered[cut : len(ordered) - cut]
    n, freedom = len(ordered), len(kept) - 1
    spread = np.clip(ordered, kept[0], kept[-1]).var(ddof=1) if n > 1 else np.nan
    return Moments(float(kept.mean()), float(spread * (n - 1) / (len(kept) * freedom)) if freedom else np.nan, freedom)


def combined(estimates: Sequence[Moments], weights: Sequence[float]) -> Interval:
    """Weighted mean of independent estimates, with an interval of Student's t that holds for few runs, as a bootstrap does not.

    Degrees of freedom are those of Welch and Satterthwaite (Biometrics Bulletin 2, 1946).

    Args:
        estimates: at least one.
    """
    share = np.asarray(weights, dtype=np.float64) / np.sum(weights)
    value, variance, freedom = (np.array(column, dtype=np.float64) for column in zip(*estimates, strict=True))
    mean, error = float(share @ value), share**2 * variance
    if np.isnan(error).any():
        return Interval(mean, float("nan"), float("nan"))
    if not error.any():
        return Interval(mean, mean, mean)
    half = float(student.ppf(0.975, error.sum() ** 2 / (error**2 / freedom).sum()) * np.sqrt(error.sum()))
    return Interval(mean, mean - half, mean + half)


def probability_of_improvement(ours: Sequence[float], theirs: Sequence[float]) -> Interval:
    """Probability that a run of ours has a larger figure than a run of theirs; ties count half.

    Args:
        ours: figures of the runs of one method, at least one.
        theirs: figures of the runs of the other method.
    """

    def larger(x: F64, y: F64, axis: int = -1) -> F64:
        # The Mann-Whitney statistic, from the ranks in the pooled runs.
        ranks = rankdata(np.concatenate([x, y], axis=axis), axis=axis)
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
    found = bootstrap(samples, statistic, n_resamples=RESAMPLES, method="percentile", vectorized=True, rng=seed)
    return Interval(value, float(found.confidence_interval.low), float(found.confidence_interval.high))
