"""Worth of a stroke: the one definition that values, marks, advice, reports, pictures, the page and the suite read.

A stroke is worth the probability with which its striker wins the rally, if both players then go on as two policies do. Its
**advantage** is that minus the probability before the choice, the mean over what the striker's own policy plays there. A figure
of the game that is promised is **calibrated**: the mean over the refits of the game on resampled matches, times the share of
predicted advantages that real matches realise (:func:`~shuttle_marl.game.shipped.factor_of`).
"""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, Bools, Ints
from shuttle_marl.exact.profile import StatePolicy, met_by
from shuttle_marl.game.layout import ALL, Indices
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.tables import Game

NORMAL: Final = 1.6448536
"""95 % quantile of the normal distribution: intervals of the reports contain the truth in 90 % of cases."""
LEAST_REFITS: Final = 5
"""Number of refits below which nothing is advised and no refits agree."""


class Worth:
    """What strokes are worth to one player.

    Args:
        game: tables with which the player strikes.
        values: ``[S]`` each: value to a player, of -1 to 1, of the states in which player 0 strikes and in which player 1 does.
        seat: of the striker.
        opponent: policy by which the receiver waits in the game with recovery; None: as people do.
    """

    def __init__(self, game: Game, values: tuple[F64, F64], seat: int = 0, opponent: StatePolicy | None = None) -> None:
        self._tables = game if opponent is None else met_by(game, opponent)
        self._before, self._after = values[seat], values[1 - seat]

    def before(self, states: slice | Indices) -> F64:
        """``[...]`` probability of winning the rally before the choice in some states."""
        return np.asarray((1 + self._before[states]) / 2)

    def win(self, pairs: slice | Indices = ALL) -> F64:
        """``[...]`` probability of winning the rally with legal pairs, all by default."""
        return np.asarray((1 + self._tables.stroke_values(self._after, pairs)) / 2)

    def advantage(self, pairs: slice | Indices, states: Ints) -> F64:
        """``[...]`` change of that probability by legal pairs of some states."""
        return np.asarray((self._tables.stroke_values(self._after, pairs) - self._before[states]) / 2)


def error_of(values: F64) -> F64:
    """``[...]`` standard deviation of figures in one more refit, from ``[R, ...]`` in R refits; NaN of fewer than two."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(values.std(axis=0, ddof=1) * np.sqrt(1 + 1 / len(values)))


def agree(values: F64) -> Bools:
    """Whether ``[R, ...]`` values in the refits have a mean that is larger than their disagreement; False of too few refits."""
    return np.asarray((np.abs(values.mean(axis=0)) > NORMAL * error_of(values)) & (len(values) >= LEAST_REFITS))


def calibrated(values: F64, factor: Estimate | None) -> Estimate:
    """Calibrated figure: mean over the refits times the factor, with a 90 % interval.

    Args:
        values: ``[R]`` in each refit.
        factor: share of advantages that real matches realise, with its 95 % interval; None: unknown, taken as 1.
    """
    factor = factor or Estimate(1.0, 1.0, 1.0)
    mean, off = float(np.mean(values)), (factor.high - factor.low) / (2 * 1.959964)
    error = NORMAL * float(np.hypot(factor.value * error_of(values), mean * off))
    return Estimate(factor.value * mean, factor.value * mean - error, factor.value * mean + error)
