"""Baselines of ``adapt``.

The argument of a name, as in ``restricted-nash:0.75``, is p of the restricted Nash response.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.special import logsumexp

from shuttle_marl.base.arrays import F32, F64, I8, I32, I64, Floats
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.exact.optimal import best_response, restricted_response
from shuttle_marl.exact.profile import PairPolicy, StatePolicy
from shuttle_marl.game.policy import TabulatedPolicy, position_shares, tabulate
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.computed import minimax_policy
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.adapt import AdaptSetting, PlayedRally
from shuttle_marl.suite.tabular import cloned
from shuttle_marl.suite.task import WEIGHT

TOLERANCE = 1e-4  # error bound of responses, far below the error of a model of the opponent
FORGET = 0.01  # fraction of the posterior that returns to the prior after every rally (fixed share, Herbster & Warmuth 1998)
_FLOOR = 1e-4  # least probability of a stroke or a position in a likelihood
_RARE: Final = 1e-3  # posterior probability below which a known type is left out of the mean
_SHRINK: Final = 6.0  # pseudo-observations of a position after each shot type
_SHRINK_STROKES: Final = 8.0  # pseudo-observations of the coarser cell of a stroke


class Adapter:
    """Keeps the rallies, and plays the restricted Nash response to an estimate of the opponent; the argument is p."""

    p = WEIGHT

    def __init__(self, setting: AdaptSetting, argument: str = "") -> None:
        self.game, self.bc, self.types = setting.game, setting.known["bc"], list(setting.known.values())
        self.p = float(argument or self.p)
        self.seen: list[PlayedRally] = []

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """The restricted response to the estimate."""
        return respond(self.estimate(), self.p)

    def observe_rally(self, rally: PlayedRally) -> None:
        """Keep the rally."""
        self.seen.append(rally)

    def estimate(self) -> StatePolicy:
        """The opponent, estimated; here bc."""
        return self.bc


class Minimax(Adapter):
    """Perfect play: nothing to lose, nothing learned."""

    def __init__(self, setting: AdaptSetting) -> None:
        super().__init__(setting)

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """Always the same."""
        return minimax_policy(self.game)


class RestrictedNash(Adapter):
    """Restricted Nash response to bc (Johanson, Zinkevich & Bowling 2007); with p = 1, the default, the best response to bc."""

    p = 1.0


class Population(Adapter):
    """Posterior over the known types, from the probabilities of the opponent's strokes and positions."""

    def __init__(self, setting: AdaptSetting, argument: str = "") -> None:
        super().__init__(setting, argument)
        self.log_posterior = np.full(len(self.types), -np.log(len(self.types)))

    @property
    def posterior(self) -> F64:
        """``[types]`` probabilities."""
        return np.exp(self.log_posterior)

    def observe_rally(self, rally: PlayedRally) -> None:
        """Keep the rally, and update the posterior."""
        super().observe_rally(rally)
        likelihood = self.likelihood(rally)
        posterior = np.exp(likelihood + self.log_posterior - logsumexp(likelihood + self.log_posterior))
        self.log_posterior = np.log((1 - FORGET) * posterior + FORGET / len(posterior))

    def likelihood(self, rally: PlayedRally) -> F64:
        """``[types]`` log-likelihood of what the opponent chose."""
        pair = rally.pair[~rally.own]
        found = np.array([np.log(np.maximum(each.probability_of(pair), _FLOOR)).sum() for each in self.types])
        state, place = rally.state[rally.own], rally.position[rally.own]
        for i, each in enumerate(self.types):
            chance = position_shares(each.waiting_table[state])[np.arange(len(state)), place]
            found[i] += np.log(np.maximum(chance, _FLOOR)).sum()
        return found


class PosteriorMean(Population):
    """The best response to the mean of the posterior, stroke by stroke."""

    p = 1.0

    def estimate(self) -> StatePolicy:
        """The mean of the known types that matter."""
        kept = np.where(self.posterior >= _RARE, self.posterior, 0)
        return mean_of(self.types, kept / kept.sum())


class Counts(Adapter):
    """Response to shrunken counts of the opponent's choices around bc."""

    def estimate(self) -> StatePolicy:
        """The counts."""
        return counted(self.bc, self.seen)


def struck(seen: Sequence[PlayedRally]) -> I64:
    """``[M]`` pairs of the strokes of the opponent."""
    return np.concatenate([np.zeros(0, np.int64), *(rally.pair[~rally.own] for rally in seen)])


def counted(prior: StatePolicy, seen: Sequence[PlayedRally]) -> PairPolicy:
    """Counts of the opponent's choices, shrunken towards a prior."""
    probability = cloned(prior.game, struck(seen), shrink=_SHRINK_STROKES, prior=prior.block_probabilities(0))
    return PairPolicy(game=prior.game, probability=probability, positions=waited(prior, seen))


def waited(prior: StatePolicy, seen: Sequence[PlayedRally]) -> F64:
    """``[S, 9]`` positions of an opponent: those of a prior, tilted towards what was seen after each shot type that it played."""
    state = np.concatenate([np.zeros(0, np.int32), *(rally.state[rally.own] for rally in seen)])
    place = np.concatenate([np.zeros(0, np.int8), *(rally.position[rally.own] for rally in seen)])
    return tilted_positions(prior.position_probabilities(), prior.game, state, place)


def tilted_positions(prior: F64, game: Game, state: I32, place: I8) -> F64:
    """:func:`waited` for ``[N]`` positions of the receiver where a striker was in ``[N]`` states."""
    shot = game.incoming_shot(np.arange(game.n_states))
    number, expected = (np.full((N_SHOTS + 1, 9), _SHRINK) for _ in range(2))
    np.add.at(number, (shot[state], place), 1)
    np.add.at(expected, shot[state], prior[state])
    found = prior * (number / expected)[shot]
    return np.asarray(found / found.sum(axis=1, keepdims=True))


@functools.lru_cache(maxsize=4)
def respond(opponent: StatePolicy, p: float) -> TabulatedPolicy:
    """The restricted Nash response to a model of the opponent; with p = 1 the best response, which takes half of the time."""
    if p == 1:
        return best_response(opponent, tolerance=TOLERANCE).policy
    return restricted_response(opponent, p, tolerance=TOLERANCE).policy


def mean_of(types: Sequence[TabulatedPolicy], weight: F64, *, least: float = 0.0) -> PairPolicy:
    """The mean of types by ``[K]`` weights, choice by choice, at effort 0; ``least``: weight from which positions count."""
    kept = np.where(weight > least, weight, 0)
    parts = [share * policy.position_probabilities() for policy, share in zip(types, kept / kept.sum(), strict=True) if share]
    return PairPolicy(game=types[0].game, probability=weight @ chances(tuple(types)), positions=np.sum(parts, axis=0))


_ANSWERED: Final = ("bc", "attacking", "defensive", "safe")  # known types whose best responses are types too
_TAUS: Final = (0.03, 0.07, 0.15)
_SHARE: Final = 0.3  # prior probability of the levels together
_STRENGTH: Final = 10.0  # strokes that the posterior over types counts as, the prior mean of the weights
_SWEEPS: Final = 60
_LIKELIHOOD: Final = 1e-6  # least likelihood of a stroke under a type of the mixture
_CHANGES: Final = 32  # number of rallies at which a change is considered
_LEAST: Final = 200  # strokes from which on a change is considered
_LITTLE: Final = 0.01  # weight of a type from which on its positions count
_GAIN: Final = 12.0  # difference of log-likelihoods from which on a change is believed


class Mixture(Population):
    """Restricted Nash response to a mixture of types, a model of the opponent from few rallies.

    The model has four parts:

    - *levels*: the known types are extended by levels of reasoning (Camerer, Ho & Chong 2004): best responses to bc and to
      styles, best responses to those, and KL-regularised play around bc;
    - *weights*: the opponent draws a type for every stroke. The weights are the maximum a posteriori, found by expectation
      maximisation; the mean of their Dirichlet prior is the posterior over types;
    - *places*: positions are those of the mixture, tilted towards what was seen;
    - *change*: what was seen before a change of the opponent is dropped, found by the ratio of the likelihoods of one mixture and
      of two.
    """

    def __init__(self, setting: AdaptSetting, argument: str = "") -> None:
        super().__init__(setting, argument)
        n, further = len(self.types), levels(self.game, tuple(setting.known[name] for name in _ANSWERED))
        self.types += further
        self.prior = np.append((1 - _SHARE) * np.full(n, 1 / n), np.full(len(further), _SHARE / len(further)))
        self.log_posterior = np.log(self.prior)
        self.chance = chances(tuple(self.types))

    def estimate(self) -> PairPolicy:
        """The opponent, estimated."""
        pairs = struck(self.seen) % self.game.n_base_pairs
        if len(pairs) >= _LEAST:
            ends = np.cumsum([np.count_nonzero(~rally.own) for rally in self.seen])
            first = change_point(self.chance[:, pairs], ends, _STRENGTH * self.prior)
            self.seen, pairs = self.seen[first:], pairs[ends[first - 1] if first else 0 :]
        found = mean_of(self.types, mixture_weights(self.chance[:, pairs], _STRENGTH * self.posterior)[0], least=_LITTLE)
        return dataclasses.replace(found, positions=waited(found, self.seen))


@functools.lru_cache(maxsize=1)
def levels(game: Game, types: tuple[TabulatedPolicy, ...]) -> list[TabulatedPolicy]:
    """Best responses to types, best responses to those, and KL-regularised play around bc."""

    def answer(policy: TabulatedPolicy) -> TabulatedPolicy:
        return best_response(policy, tolerance=TOLERANCE).policy

    first = [*in_threads(answer, types)]
    near = in_threads(lambda tau: tabulate(resolve(f"human:{tau}", game), game), _TAUS)
    return [*first, *in_threads(answer, first), *near]


@functools.lru_cache(maxsize=2)
def chances(types: tuple[TabulatedPolicy, ...]) -> F32:
    """``[K, base pairs]`` probabilities of policies at effort 0."""
    return np.stack([policy.block_probabilities(0).astype(np.float32) for policy in types])


def mixture_weights(likelihood: Floats, prior: F64, sweeps: int = _SWEEPS) -> tuple[F64, float]:
    """``[K]`` MAP weights from ``[K, M]`` likelihoods and ``[K]`` pseudo-observations, and their log-posterior but a constant."""
    likelihood, weight = np.maximum(likelihood, _LIKELIHOOD), prior / prior.sum()
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
