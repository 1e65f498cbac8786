"""Spread of a figure over training runs: mean and deviation, and the interquartile mean with its interval."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.stats import bootstrap, trim_mean

RESAMPLES: Final = 10_000
_TRIMMED: Final = 0.25


def mean_and_deviation(values: Sequence[float]) -> dict[str, float]:
    """Mean, and standard deviation of a sample (n - 1)."""
    return {"mean": float(np.mean(values)), "deviation": float(np.std(values, ddof=1))}


@dataclasses.dataclass(frozen=True, kw_only=True)
class IQM:
    """The mean of the middle half, and its 95 % interval (Agarwal et al., NeurIPS 2021, arXiv 2108.13264).

    Attributes:
        value: interquartile mean over all runs of all tasks.
        low: lower end of the interval.
        high: upper end.
    """

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, tasks: Sequence[Sequence[float]], seed: int = 0) -> "IQM":
        """Of the runs of each task: the bootstrap is stratified, so each task keeps its number of runs.

        Args:
            tasks: scores of the runs, by task; two runs or more.
            seed: of the resampling.
        """

        def middle(*columns: npt.NDArray[np.float64], axis: int = -1) -> npt.NDArray[np.float64]:
            # Sorted by each other's company only: the runs of all tasks are one sample.
            joined: npt.NDArray[np.float64] = trim_mean(np.concatenate(columns, axis=axis), _TRIMMED, axis=axis)
            return joined

        samples = [np.asarray(task, dtype=np.float64) for task in tasks]
        value = float(middle(*samples))
        if np.ptp(np.concatenate(samples)) == 0:
            return cls(value=value, low=value, high=value)
        found = bootstrap(samples, middle, n_resamples=RESAMPLES, method="percentile", vectorized=True, rng=seed)
        return cls(value=value, low=float(found.confidence_interval.low), high=float(found.confidence_interval.high))

    def as_json(self) -> dict[str, Any]:
        """The fields as JSON."""
        return dataclasses.asdict(self)
