"""Tilted mixtures: a model of the opponent from few rallies, and the restricted Nash response to it.

The model has four parts, and subclasses leave one out each:

- *levels*: the known types are extended by levels of reasoning (Camerer, Ho & Chong 2004): best responses to bc and to styles,
  best responses to those, and KL-regularised play around bc;
- *mixture*: the opponent draws a type for every stroke. The weights are the maximum a posteriori, found by expectation
  maximisation; the mean of their Dirichlet prior is the posterior over types, which replaces them without this part;
- *tilt*: the log-probabilities of the mixture are shifted by a sum over features of the stroke and the incoming one, the maximum
  a posteriori under a normal prior (L-BFGS);
- *change*: strokes before a change of the opponent are dropped, found by the ratio of the likelihoods of one mixture and of two.

The argument is p of the restricted Nash response.
"""

import functools
from typing import ClassVar, Final

import numpy as np
from scipy.optimize import minimize

from shuttle_marl.base.arrays import F32, F64, I64, Floats
from shuttle_marl.exact.optimal import best_response
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.adapt import AdaptSetting, PlayedRally
from shuttle_marl.suite.methods.adapters import TOLERANCE, Population, respond

_ANSWERED: Final = ("bc", "attacking", "defensive", "safe")
"""Known types whose best responses are types too."""
_TAUS: Final = (0.03, 0.07, 0.15)
_SHARE: Final = 0.3
"""Prior probability of the levels together."""
_STRENGTH: Final = 10.0
"""Strokes that the posterior over types counts as, the prior mean of the weights."""
_SWEEPS: Final = 60
_FLOOR: Final = 1e-6
_DEVIATIONS: Final = (1.0, 0.7, 0.7, 0.5, 0.5, 0.5)
"""Standard deviation of the shifts of each group of features."""
_ITERATIONS: Final = 40
_CHANGES: Final = 32
"""Number of rallies at which a change is considered."""
_LEAST: Final = 200
"""Strokes from which on a change is considered."""
_GAIN: Final = 12.0
"""Difference of log-likelihoods from which on a change is believed."""


class TiltedMixture(Population):
    """Restricted Nash response to a tilted mixture of types."""

    levels: ClassVar = True
    mixture: ClassVar = True
    tilt: ClassVar = True
    change: ClassVar = True

    def __init__(self, setting: AdaptSetting, argument: str = "0.9") -> None:
        super().__init__(setting)
        self.p, n = float(argument), len(self.types)
        self.prior = np.full(n, 1 / n)
        if self.levels:
            self.types += levels(self.game, tuple(setting.known[name] for name in _ANSWERED))
            more = len(self.types) - n
            self.prior = np.append((1 - _SHARE) * self.prior, np.full(more, _SHARE / more))
            self.log_posterior = np.log(self.prior)
        self.chance = chances(tuple(self.types))
        self.features, self.deviation = features(self.game)
        self.theta = np.zeros(len(self.deviation))
        self.rallies: list[I64] = []

    def observe_rally(self, rally: PlayedRally) -> None:
        """Update the posterior over types, and keep the strokes of the opponent."""
        super().observe_rally(rally)
        self.rallies.append(rally.pair[~rally.own] % self.game.n_base_pairs)

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """The restricted response to the model."""
        return respond(self.estimate(), self.p)

    def estimate(self) -> PairPolicy:
        """The opponent, estimated."""
        pairs = np.concatenate([np.zeros(0, dtype=np.int64), *self.rallies])
        if self.change and len(pairs) >= _LEAST:
            ends = np.cumsum([len(rally) for rally in self.rallies])
            first = change_point(self.chance[:, pairs], ends, _STRENGTH * self.prior)
            self.rallies, pairs = self.rallies[first:], pairs[ends[first - 1] if first else 0 :]
        weight = mixture_weights(self.chance[:, pairs], _STRENGTH * self.posterior)[0] if self.mixture else self.posterior
        chance = weight @ self.chance
        if self.tilt and len(pairs):
            base = np.log(np.maximum(chance, _FLOOR))
            self.theta = fitted_shift(self.game, base, self.features, self.deviation, pairs, self.theta)
            chance = shifted(self.game, base, self.features, self.theta)
        return PairPolicy(game=self.game, probability=chance)


class WithoutLevels(TiltedMixture):
    """Known types alone."""

    levels = False


class WithoutMixture(TiltedMixture):
    """The posterior over types instead of the weights of a mixture."""

    mixture = False


class WithoutTilt(TiltedMixture):
    """The mixture itself."""

    tilt = False


class WithoutChange(TiltedMixture):
    """All rallies count."""

    change = False


@functools.lru_cache(maxsize=1)
def levels(game: Game, types: tuple[TabulatedPolicy, ...]) -> list[TabulatedPolicy]:
    """Best responses to types, best responses to those, and KL-regularised play around bc."""
    first = [best_response(policy, tolerance=TOLERANCE).policy for policy in types]
    second = [best_response(policy, tolerance=TOLERANCE).policy for policy in first]
    return [*first, *second, *(tabulate(resolve(f"human:{tau}", game), game) for tau in _TAUS)]


@functools.lru_cache(maxsize=2)
def chances(types: tuple[TabulatedPolicy, ...]) -> F32:
    """``[K, base pairs]`` probabilities of policies at effort 0."""
    return np.stack([policy.block_probabilities(0).astype(np.float32) for policy in types])


def mixture_weights(likelihood: Floats, prior: F64, sweeps: int = _SWEEPS) -> tuple[F64, float]:
    """``[K]`` maximum a posteriori weights of a mixture, and their log-posterior without its constant.

    Args:
        likelihood: ``[K, M]`` probability of each observation under each component.
        prior: ``[K]`` pseudo-observations of each component.
        sweeps: iterations of expectation maximisation.
    """
    likelihood, weight = np.maximum(likelihood, _FLOOR), prior / prior.sum()
    for _ in range(sweeps):
        weight = weight * (likelihood @ (1 / (weight @ likelihood))) + prior
        weight /= weight.sum()
    return weight, float(np.log(weight @ likelihood).sum() + prior @ np.log(weight))


def change_point(likelihood: Floats, ends: I64, prior: F64) -> int:
    """First rally after a change of the opponent; 0: there was none.

    Args:
        likelihood: ``[K, M]`` probability of each stroke under each type.
        ends: ``[R]`` number of strokes up to the end of each rally.
        prior: see :func:`mixture_weights`.
    """
    whole = mixture_weights(likelihood, prior, _SWEEPS // 3)[1]
    best, found = _GAIN, 0
    for rally in np.unique(np.linspace(0, len(ends), _CHANGES + 2).astype(int))[1:-1].tolist():
        parts = np.split(likelihood, [ends[rally - 1]], axis=1)
        gain = sum(mixture_weights(part, prior, _SWEEPS // 3)[1] for part in parts) - whole
        if gain > best:
            best, found = gain, rally
    return found


@functools.lru_cache(maxsize=1)
def features(game: Game) -> tuple[I64, F64]:
    """``[groups, base pairs]`` number of the feature of each group that a pair has, and ``[features]`` prior deviations."""
    stroke, state, catalogue = game.base_pair_stroke, game.base_pair_state, game.catalogue
    shot, area, technique = (part[stroke].astype(np.int64) for part in (catalogue.shot, catalogue.area, catalogue.technique))
    came = 2 * np.append(catalogue.shot, 13).astype(np.int64)[game.incoming(state)] + game.contact(state)
    place = 2 * np.append(catalogue.area, 9).astype(np.int64)[game.incoming(state)] + game.contact(state)
    parts = (shot, area, 3 * shot + technique, 13 * came + shot, 9 * shot + area, 9 * place + area)
    groups, start, deviations = [], 0, []
    for part, deviation in zip(parts, _DEVIATIONS, strict=True):
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
