"""Spread of a figure over training runs: mean and deviation, and the interquartile mean with its interval."""

from collections.abc import Sequence

import numpy as np

from shuttle_marl.base.intervals import interquartile_mean


def mean_and_deviation(values: Sequence[float]) -> dict[str, float]:
    """Mean, and standard deviation of a sample (n - 1)."""
    return {"mean": float(np.mean(values)), "deviation": float(np.std(values, ddof=1))}


def iqm(tasks: Sequence[Sequence[float]]) -> dict[str, float]:
    """Interquartile mean and its 95 % interval (Agarwal et al., NeurIPS 2021, arXiv 2108.13264), as ``value``, ``low``, ``high``.

    The bootstrap is stratified, so each task keeps its number of runs.

    Args:
        tasks: scores of the runs, by task; two runs or more.
    """
    return interquartile_mean(tasks, 0)._asdict()
