"""Tilted mixtures: a model of the opponent from few rallies, and a restricted response to it.

The model has three parts, each of which can be left out (``BASELINES`` lists the ablations):

1. *Levels*: the known population is extended by levels of reasoning (Camerer, Ho & Chong 2004): best responses to known types,
   best responses to those, and KL-regularised play around the imitated average player.
2. *Mixture*: the opponent draws one of the types for every stroke; the weights are estimated by expectation maximisation with a
   Dirichlet prior. Without it, the weights are the posterior over types.
3. *Tilt*: the log-probabilities of the mixture are shifted by a sum over features of the stroke, a maximum a posteriori estimate
   with a normal prior: shot type, area, technique by shot type, shot type by incoming shot type and contact, area by shot type.
"""

import functools

import numpy as np
from scipy.optimize import minimize

from shuttle_marl.arrays import F64, I64
from shuttle_marl.exact.optimal import best_response
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.adapt import AdaptSetting, PlayedRally
from shuttle_marl.suite.methods.adapters import PosteriorMean, respond
from shuttle_marl.suite.tabular import cloned

_DEVIATIONS = (1.0, 0.7, 0.7, 0.5, 0.5)
"""Standard deviation of the shifts of each group of features."""
_ITERATIONS = 40
_FLOOR = 1e-6
_TAUS = (0.03, 0.07, 0.15)
_STRENGTH = 3.0
"""Strokes that the prior of the weights of a mixture counts as."""
_SWEEPS = 60


class Tilt(PosteriorMean):
    levels = False
    mixture = False
    tilt = True
    counts = 0.0

    def __init__(self, setting: AdaptSetting, argument: str = "1") -> None:
        super().__init__(setting, argument)
        if self.levels:
            known = tuple(setting.known.items())
            self.types += reasoners(self.game, known)
            self.log_posterior = np.full(len(self.types), -np.log(len(self.types)))
        self.chance = np.stack([block(each) for each in self.types])
        self.features, self.deviation = features(self.game)
        self.pairs = np.zeros(0, dtype=np.int64)
        self.theta = np.zeros(len(self.deviation))

    def observe_rally(self, rally: PlayedRally) -> None:
        """Update the posterior over types, and keep the strokes."""
        super().observe_rally(rally)
        self.pairs = np.append(self.pairs, rally.pair[~rally.own] % self.game.n_base_pairs)

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """The restricted response to the estimate."""
        return respond(self.estimate(), self.p)

    def estimate(self) -> PairPolicy:
        """The opponent, estimated."""
        weight = self.posterior
        if self.mixture:
            weight = mixture_weights(self.chance[:, self.pairs], np.full(len(weight), 1 / len(weight)))
        chance = weight @ self.chance
        if self.tilt and len(self.pairs):
            base = np.log(np.maximum(chance, _FLOOR))
            self.theta = fitted_shift(self.game, base, self.features, self.deviation, self.pairs, self.theta)
            chance = shifted(self.game, base, self.features, self.theta)
        if self.counts and len(self.pairs):
            chance = cloned(self.game, self.pairs, shrink=self.counts, prior=chance)
        return PairPolicy(game=self.game, probability=chance)


@functools.lru_cache(maxsize=32)
def block(policy: TabulatedPolicy) -> F64:
    """Probabilities of a policy at effort 0."""
    return policy.block_probabilities(0)


@functools.lru_cache(maxsize=1)
def reasoners(game: Game, known: tuple[tuple[str, TabulatedPolicy], ...]) -> list[TabulatedPolicy]:
    """Best responses to the known types that differ most, best responses to those, and regularised play around bc."""
    found = []
    for name, policy in known:
        if ":" not in name:
            first = best_response(policy, tolerance=1e-5).policy
            found += [first, best_response(first, tolerance=1e-5).policy]
    return [*found, *(tabulate(resolve(f"human:{tau}", game), game) for tau in _TAUS)]


def mixture_weights(likelihood: F64, prior: F64) -> F64:
    """``[K]`` weights of a mixture by expectation maximisation.

    Args:
        likelihood: ``[K, M]`` probability of each observation under each component.
        prior: ``[K]`` mean of the Dirichlet prior of :data:`_STRENGTH` pseudo-observations.
    """
    weight = prior
    likelihood = np.maximum(likelihood, _FLOOR)
    for _ in range(_SWEEPS):
        part = likelihood * weight[:, None]
        weight = (part / part.sum(axis=0)).sum(axis=1) + _STRENGTH * prior
        weight /= weight.sum()
    return weight


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
