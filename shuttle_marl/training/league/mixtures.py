"""Mixtures of policies as one policy, and policy space response oracles (PSRO, Lanctot et al., NeurIPS 2017).

A player of a mixture draws one of its policies at the start of a rally. The posterior probability of each policy in a state is
proportional to its prior times its visits to the state. The policy that plays the posterior mean of their stroke probabilities
generates the same rallies against the same opponent (Kuhn 1953). Against other opponents it differs, because a state does not
hold the whole history; exact figures are those of the single policy.

With the exact best response as oracle and a Nash equilibrium as meta-strategy, PSRO is the double oracle method (McMahan, Gordon
& Blum, ICML 2003): iterated best responses, the baseline of a league.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl import exact
from shuttle_marl.base.arrays import F64, Floats
from shuttle_marl.exact.meta_games import alpha_rank, nash, uniform
from shuttle_marl.game.policy import TemperedPolicy
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.tabulated import TabulatedPolicy, cumulative_positions, from_pair_probabilities, tabulate
from shuttle_marl.training.league.config import MetaSolver
from shuttle_marl.training.league.population import TOLERANCE

_MIN_PRIOR: Final = 1e-12
"""Prior weight of each policy in every state, so that unreachable states have a mean too."""
_MIN_PROBABILITY: Final = 1e-3
"""Smaller probabilities are removed from a meta-strategy: their policies cost time and change little."""
_SOLVERS: Final[dict[MetaSolver, Callable[[F64], F64]]] = {
    "nash": lambda values: nash(values).row,
    "uniform": uniform,
    "alpha-rank": alpha_rank,
}


def merged(
    policies: Sequence[TabulatedPolicy], probabilities: Floats, opponent: TabulatedPolicy | None = None
) -> TabulatedPolicy:
    """The policy that is equivalent to a mixture of policies against an opponent.

    Args:
        probabilities: ``[K]`` probabilities of the mixture.
        opponent: opponent against whom the two are equivalent; None: an approximation that ignores visits.
    """
    mixed = [(policy, float(p)) for policy, p in zip(policies, probabilities, strict=True) if p > 0]
    if len(mixed) == 1:
        return mixed[0][0]
    opponent = opponent or _mean(mixed, [np.full((2, policy.game.n_states), p) for policy, p in mixed])
    weights = [p * (np.stack(exact.visits(policy, opponent, tolerance=TOLERANCE).states) + _MIN_PRIOR) for policy, p in mixed]
    return _mean(mixed, weights)


def sharpened(policy: TabulatedPolicy, temperature: float) -> TabulatedPolicy:
    """The policy with stroke probabilities p^(1 / temperature), normalised.

    The entropy bonus lets a learner play strokes that are nearly optimal; a temperature below 1 makes them rare.
    """
    return tabulate(TemperedPolicy(policy, temperature), policy.game)


def _mean(mixed: Sequence[tuple[TabulatedPolicy, float]], weights: Sequence[Floats]) -> TabulatedPolicy:
    """The mean of policies, weighted ``[2, S]`` in every state in which they strike, and in which they wait."""
    game = mixed[0][0].game
    total = np.sum(weights, axis=0)
    out, waits, waiting = np.zeros(game.n_pairs), np.zeros((game.n_states, N_POSITIONS)), game.recovery is not None
    for (policy, _), weight in zip(mixed, weights, strict=True):
        posterior, receiving = weight / np.maximum(total, 1e-300)
        if waiting:
            own = policy.position_probabilities()
            waits += receiving[:, None] * (game.people_positions(np.arange(game.n_states)) if own is None else own)
        for block in range(game.n_blocks):
            part = posterior[game.block_states(block)][game.base_pair_state]
            out[game.block_pairs(block)] += part * policy.block_probabilities(block)
    mean = from_pair_probabilities(game, out)
    return dataclasses.replace(mean, waits=cumulative_positions(waits)) if waiting else mean


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
    mixture = merged(policies, probabilities, merged(policies, probabilities))
    return mixture, exact.best_response(mixture, tolerance=TOLERANCE)
