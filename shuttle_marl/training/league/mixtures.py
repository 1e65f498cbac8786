"""Mixtures of policies as one policy, and policy space response oracles (PSRO, Lanctot et al., NeurIPS 2017).

A mixture plays in every state the mean of the stroke probabilities of its policies, and waits by the mean of those of their
positions: it draws a policy anew for every stroke and not once a rally. So it is a policy of the game, and exact figures are
those of this policy.

With the exact best response as oracle and a Nash equilibrium as meta-strategy, PSRO is the double oracle method (McMahan, Gordon
& Blum, ICML 2003): iterated best responses, the baseline of a league. Where equilibria are deterministic, it ends in one. In the
game with recovery they mix in the states, and a mixture of whole policies may be exploitable by one of them. There the
meta-strategy is the linear average: the k-th best response counts k times, which is fictitious play in a zero-sum stochastic
game (Leslie, Perkins & Xu, Journal of Economic Theory 2020) with the weights of Tammelin et al. (IJCAI 2015).
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl import exact
from shuttle_marl.base.arrays import F64, Floats
from shuttle_marl.exact.meta_games import alpha_rank, nash
from shuttle_marl.game.policy import TemperedPolicy
from shuttle_marl.game.tabulated import TabulatedPolicy, cumulative_positions, from_pair_probabilities, tabulate
from shuttle_marl.training.league.config import MetaSolver
from shuttle_marl.training.league.population import TOLERANCE

_MIN_PROBABILITY: Final = 1e-3
"""Smaller probabilities are removed from a meta-strategy: their policies cost time and change little."""
_SOLVERS: Final[dict[MetaSolver, Callable[[F64], F64]]] = {
    "nash": lambda values: nash(values).row,
    "linear": lambda values: np.arange(1.0, len(values) + 1),
    "alpha-rank": alpha_rank,
}


def merged(policies: Sequence[TabulatedPolicy], probabilities: Floats) -> TabulatedPolicy:
    """The mean of policies in every state, in strokes and positions.

    Args:
        probabilities: ``[K]`` probabilities of the mixture.
    """
    mixed = [(policy, float(p)) for policy, p in zip(policies, probabilities, strict=True) if p > 0]
    if len(mixed) == 1:
        return mixed[0][0]
    game = mixed[0][0].game
    blocks = (sum(p * policy.block_probabilities(block) for policy, p in mixed) for block in range(game.n_blocks))
    mean = from_pair_probabilities(game, np.concatenate(list(blocks)))
    if game.recovery is None:
        return mean
    people = game.people_positions(np.arange(game.n_states))
    waits = [p * (people if (own := policy.position_probabilities()) is None else own) for policy, p in mixed]
    return dataclasses.replace(mean, waits=cumulative_positions(np.sum(waits, axis=0)))


def sharpened(policy: TabulatedPolicy, temperature: float) -> TabulatedPolicy:
    """The policy with stroke probabilities p^(1 / temperature), normalised.

    The entropy bonus lets a learner play strokes that are nearly optimal; a temperature below 1 makes them rare.
    """
    return tabulate(TemperedPolicy(policy, temperature), policy.game)


def meta_strategy(solver: MetaSolver, values: npt.ArrayLike) -> F64:
    """``[N]`` probabilities of the policies of a population.

    Args:
        values: ``[N, N]`` value of the row against the column, antisymmetric.
    """
    strategy = _SOLVERS[solver](np.asarray(values, dtype=np.float64))
    strategy = np.where(strategy >= min(_MIN_PROBABILITY, float(strategy.max())), strategy, 0.0)
    return np.asarray(strategy / strategy.sum())


def respond(policies: Sequence[TabulatedPolicy], probabilities: Floats) -> tuple[TabulatedPolicy, exact.Response]:
    """A mixture as one policy, and the exact best response to it.

    Args:
        probabilities: ``[K]`` their probabilities.
    """
    mixture = merged(policies, probabilities)
    return mixture, exact.best_response(mixture, tolerance=TOLERANCE)
