"""Policy space response oracles (PSRO, Lanctot et al., NeurIPS 2017), whose mixtures are policies of the game.

With the exact best response as oracle and a Nash equilibrium as meta-strategy, PSRO is the double oracle method (McMahan, Gordon
& Blum, ICML 2003): iterated best responses, the baseline of a league. Where equilibria are deterministic, it ends in one. In the
game with recovery they mix in the states, and a mixture of whole policies may be exploitable by one of them. There the
meta-strategy is the linear average: the k-th best response counts k times, which is fictitious play in a zero-sum stochastic
game (Leslie, Perkins & Xu, Journal of Economic Theory 2020) with the weights of Tammelin et al. (IJCAI 2015).
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl import exact
from shuttle_marl.base.arrays import F64, Floats
from shuttle_marl.exact.meta_games import alpha_rank, nash
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.policy.computed import mixture
from shuttle_marl.training.league.config import MetaSolver
from shuttle_marl.training.league.population import TOLERANCE

_MIN_PROBABILITY: Final = 1e-3
"""Smaller probabilities are removed from a meta-strategy: their policies cost time and change little."""
_SOLVERS: Final[dict[MetaSolver, Callable[[F64], F64]]] = {
    "nash": lambda values: nash(values).row,
    "linear": lambda values: np.arange(1.0, len(values) + 1),
    "alpha-rank": alpha_rank,
}


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
    mixed = mixture(policies, probabilities)
    return mixed, exact.best_response(mixed, tolerance=TOLERANCE)
