"""Does an earlier advantage still count, beyond the value of the current state?"""

import dataclasses
from typing import Final

import numpy as np

from experiments.truth.decisions import Promises, realised, slope
from experiments.truth.matches import Strokes
from shuttle_marl.base.arrays import F64

LAGS: Final = (1, 2, 4, 6, 8)
"""Strokes ago of the advantages whose memory is measured."""


def memory(strokes: Strokes, promised: Promises) -> dict[str, dict[str, float]]:
    """Slopes of (result of the rally - V of the state now) on the advantage of an earlier stroke, for all of :data:`LAGS`.

    Advantages of the opponent count with the opposite sign. Effects of player and match are removed.
    """
    ended = realised(strokes, promised.value, None)
    return {
        str(lag): slope(strokes, dataclasses.replace(promised, advantage=_ago(strokes, promised.advantage, lag)), ended)
        for lag in LAGS
    }


def _ago(strokes: Strokes, advantage: F64, lag: int) -> F64:
    """``[N]`` advantage of the stroke ``lag`` strokes ago to the one who strikes now; NaN where there is none."""
    earlier = np.maximum(np.arange(len(strokes)) - lag, 0)
    same = (strokes.rally[earlier] == strokes.rally) & (strokes.number - strokes.number[earlier] == lag)
    return np.where(same, advantage[earlier] * (1 if lag % 2 == 0 else -1), np.nan)
