"""Spread of a figure over training runs: mean and deviation, and the interquartile mean with its interval."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from shuttle_marl.base.intervals import interquartile_mean


def mean_and_deviation(values: Sequence[float]) -> dict[str, float]:
    """Mean, and standard deviation of a sample (n - 1)."""
    return {"mean": float(np.mean(values)), "deviation": float(np.std(values, ddof=1))}


@dataclasses.dataclass(frozen=True, kw_only=True)
class IQM:
    """Interquartile mean, and its 95 % interval (Agarwal et al., NeurIPS 2021, arXiv 2108.13264).

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
        return cls(**interquartile_mean(tasks, seed)._asdict())

    def as_json(self) -> dict[str, Any]:
        """The fields as JSON."""
        return dataclasses.asdict(self)
