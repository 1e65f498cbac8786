"""Tilt: maximum a posteriori estimate of the opponent as a shifted known type, and a restricted response to it.

The log-probabilities of the posterior mean of the known types are shifted by a sum over features of the stroke: shot type,
area, technique by shot type, shot type by incoming shot type and contact, and area by shot type. The shifts have a normal prior,
so that after few rallies the estimate is the mean of the known types. The argument is p of the restricted Nash response.
"""

import functools
from typing import Any

import numpy as np
from scipy.optimize import minimize

from shuttle_marl.arrays import F64, I64
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.suite.adapt import AdaptSetting, PlayedRally
from shuttle_marl.suite.methods.adapters import PosteriorMean, respond

_DEVIATIONS = (1.0, 0.7, 0.7, 0.5, 0.5)
"""Standard deviation of the shifts of each group of features."""
_ITERATIONS = 40
_FLOOR = 1e-6


class Tilt(PosteriorMean):
    """Shift around the posterior mean of the known types."""

    def __init__(self, setting: AdaptSetting, argument: str = "1") -> None:
        super().__init__(setting, argument)
        self.features, self.deviation = features(self.game)
        self.pairs: list[Any] = []
        self.theta = np.zeros(len(self.deviation))

    def observe_rally(self, rally: PlayedRally) -> None:
        """Update the posterior over types, and keep the strokes."""
        super().observe_rally(rally)
        self.pairs.append(rally.pair[~rally.own] % self.game.n_base_pairs)

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """The restricted response to the estimate."""
        return respond(self.estimate(), self.p)

    def estimate(self) -> PairPolicy:
        """The opponent, estimated."""
        base = np.log(np.maximum(self.mean().block_probabilities(0), _FLOOR))
        if self.pairs:
            self.theta = fitted_shift(self.game, base, self.features, self.deviation, np.concatenate(self.pairs), self.theta)
        return PairPolicy(game=self.game, probability=shifted(self.game, base, self.features, self.theta))


@functools.lru_cache(maxsize=1)
def features(game: Game) -> tuple[I64, F64]:
    """``[groups, base pairs]`` number of the feature of each group that a pair has, and ``[features]`` prior deviations."""
    stroke, state, catalogue = game.base_pair_stroke, game.base_pair_state, game.catalogue
    shot, area, technique = (part[stroke].astype(np.int64) for part in (catalogue.shot, catalogue.area, catalogue.technique))
    came = 2 * np.append(catalogue.shot, 13).astype(np.int64)[game.incoming(state)] + game.contact(state)
    groups, start, deviations = [], 0, []
    for part, deviation in zip((shot, area, 3 * shot + technique, 13 * came + shot, 9 * shot + area), _DEVIATIONS, strict=True):
        groups.append(part + start)
        size = int(part.max()) + 1
        start += size
        deviations.append(np.full(size, deviation))
    return np.stack(groups), np.concatenate(deviations)


def shifted(game: Game, base: F64, feature: I64, theta: F64) -> F64:
    """``[base pairs]`` probabilities of the shifted policy."""
    weight = np.exp(base + theta[feature].sum(axis=0))
    return np.asarray(weight / np.bincount(game.base_pair_state, weight, game.n_base_states)[game.base_pair_state])


def fitted_shift(game: Game, base: F64, feature: I64, deviation: F64, played: I64, start: F64) -> F64:
    """``[features]`` maximum a posteriori shifts.

    Args:
        game: the rules.
        base: ``[base pairs]`` log-probabilities without a shift.
        feature, deviation: see :func:`features`.
        played: ``[M]`` base pairs that the opponent played.
        start: initial guess.
    """
    states, number = np.unique(game.base_pair_state[played], return_counts=True)
    row, pair = game.pairs(states)
    first = np.flatnonzero(np.diff(row, prepend=-1))
    here, log_base = feature[:, pair], base[pair]
    observed = np.bincount(feature[:, played].ravel(), minlength=len(deviation))

    def loss(theta: F64) -> tuple[float, F64]:
        logit = log_base + theta[here].sum(axis=0)
        top = np.maximum.reduceat(logit, first)
        weight = np.exp(logit - top[row])
        total = np.add.reduceat(weight, first)
        expected = weight / total[row] * number[row]
        gradient = np.bincount(here.ravel(), np.tile(expected, len(here)), len(deviation)) - observed + theta / deviation**2
        value = (number * (np.log(total) + top)).sum() - observed @ theta + 0.5 * ((theta / deviation) ** 2).sum()
        return float(value), gradient

    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": _ITERATIONS})
    return np.asarray(found.x)
