"""Baselines of ``adapt``.

The argument of a name, as in ``restricted-nash:0.75``, is described in the class.
"""

import functools
from collections.abc import Mapping

import numpy as np
from scipy.special import logsumexp

from shuttle_marl.analysis.tabular import cloned
from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.exact.known import pair_odds
from shuttle_marl.exact.optimal import best_response, restricted_response
from shuttle_marl.exact.profile import PairPolicy, StatePolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.policy.computed import best_response_policy, minimax_policy
from shuttle_marl.suite.adapt import AdaptSetting, PlayedRally

TOLERANCE = 1e-4
"""Error bound of responses, far below the error of a model of the opponent."""
FORGET = 0.01
"""Fraction of the posterior that returns to the prior after every rally (fixed share, Herbster & Warmuth 1998)."""
_FLOOR = 1e-4
"""Least probability of a stroke in a likelihood."""


class Minimax:
    """Perfect play: nothing to lose, nothing learned."""

    def __init__(self, setting: AdaptSetting) -> None:
        self._policy = minimax_policy(setting.game)

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """Always the same."""
        return self._policy

    def observe_rally(self, rally: PlayedRally) -> None:
        """Ignored."""


class RestrictedNash(Minimax):
    """Restricted Nash response to bc (Johanson, Zinkevich & Bowling 2007); the argument is p, 1: the best response to bc."""

    def __init__(self, setting: AdaptSetting, argument: str = "1") -> None:
        self._policy = respond(setting.known["bc"], float(argument))


class Population:
    """Posterior over the known types, from the probabilities of the opponent's strokes."""

    def __init__(self, setting: AdaptSetting) -> None:
        self.types, self.game = list(setting.known.values()), setting.game
        self.rng = np.random.default_rng(setting.seed)
        self.log_posterior = np.full(len(self.types), -np.log(len(self.types)))

    @property
    def posterior(self) -> F64:
        """``[types]`` probabilities."""
        return np.exp(self.log_posterior)

    def observe_rally(self, rally: PlayedRally) -> None:
        """Update the posterior."""
        pair = rally.pair[~rally.own]
        likelihood = np.array([np.log(np.maximum(each.probability_of(pair), _FLOOR)).sum() for each in self.types])
        posterior = np.exp(likelihood + self.log_posterior - logsumexp(likelihood + self.log_posterior))
        self.log_posterior = np.log((1 - FORGET) * posterior + FORGET / len(posterior))


class Bayes(Population):
    """The known response with the largest expected value under the posterior (Bard et al. 2013, implicit modelling)."""

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """One of the best responses to the known types."""
        responses, values = responses_to(tuple(self.types))
        return responses[int(np.argmax(values @ self.posterior))]


class Thompson(Population):
    """The best response to a known type drawn from the posterior (Thompson 1933)."""

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """One of the best responses to the known types."""
        responses, _ = responses_to(tuple(self.types))
        return responses[int(self.rng.choice(len(self.types), p=self.posterior / self.posterior.sum()))]


class PosteriorMean(Population):
    """The best response to the mean of the posterior, stroke by stroke; the argument is p of the restricted Nash response."""

    def __init__(self, setting: AdaptSetting, argument: str = "1") -> None:
        super().__init__(setting)
        self.p = float(argument)

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """The restricted response to the mean."""
        return respond(self.mean(), self.p)

    def mean(self) -> PairPolicy:
        """The mean of the known types that matter."""
        return mean_policy(self.game, dict(zip(self.types, self.posterior, strict=True)))


class Bandit(Population):
    """UCB1 over the known responses, by the results of rallies alone (Auer, Cesa-Bianchi & Fischer 2002)."""

    def __init__(self, setting: AdaptSetting) -> None:
        super().__init__(setting)
        self.won, self.number = np.zeros(len(self.types)), np.zeros(len(self.types))
        self.arm = 0

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """The response with the largest upper bound; untried ones count as half won in two rallies."""
        total = self.number.sum() + 1
        mean = (self.won + 1) / (self.number + 2)
        self.arm = int(np.argmax(mean + np.sqrt(0.1 * np.log(total) / (self.number + 2))))
        return responses_to(tuple(self.types))[0][self.arm]

    def observe_rally(self, rally: PlayedRally) -> None:
        """Count the result."""
        self.won[self.arm] += rally.won
        self.number[self.arm] += 1


class Counts:
    """Best response to shrunken counts of the opponent's strokes around bc; the argument is p of the restricted response."""

    shrink = 8.0

    def __init__(self, setting: AdaptSetting, argument: str = "1") -> None:
        self.game, self.p = setting.game, float(argument)
        self.prior = setting.known["bc"].block_probabilities(0)
        self.pairs: list[I64] = []

    def policy_for_next_rally(self) -> TabulatedPolicy:
        """The restricted response to the estimate."""
        return respond(self.estimate(), self.p)

    def observe_rally(self, rally: PlayedRally) -> None:
        """Count the opponent's strokes."""
        self.pairs.append(rally.pair[~rally.own])

    def estimate(self) -> StatePolicy:
        """The opponent, estimated."""
        pairs = np.concatenate([np.zeros(0, np.int64), *self.pairs])
        return PairPolicy(game=self.game, probability=cloned(self.game, pairs, shrink=self.shrink, prior=self.prior))


def respond(opponent: StatePolicy, p: float) -> TabulatedPolicy:
    """The restricted Nash response to a model of the opponent; with p = 1 the best response, which takes half of the time."""
    if p == 1:
        return best_response(opponent, tolerance=TOLERANCE).policy
    return restricted_response(opponent, p, tolerance=TOLERANCE).policy


def mean_policy(game: Game, weights: Mapping[TabulatedPolicy, float], *, least: float = 1e-3) -> PairPolicy:
    """Mean of policies, stroke by stroke, as they play at effort 0; weights below ``least`` are left out."""
    kept = {policy: weight for policy, weight in weights.items() if weight >= least}
    total = sum(kept.values())
    parts = [weight / total * policy.block_probabilities(0) for policy, weight in kept.items()]
    return PairPolicy(game=game, probability=np.sum(parts, axis=0))


@functools.lru_cache(maxsize=1)
def responses_to(types: tuple[TabulatedPolicy, ...]) -> tuple[list[TabulatedPolicy], F64]:
    """Best response to each type, and ``[responses, types]`` fraction of rallies that each wins against each."""
    responses = [best_response_policy(each) for each in types]
    odds = pair_odds([(response, each) for response in responses for each in types], tolerance=1e-6)
    return responses, np.array([each.rally for each in odds]).reshape(len(responses), len(types))
