"""Policy space response oracles (Lanctot et al., NeurIPS 2017): meta-strategies, and rounds with an exact oracle.

With the exact best response as oracle and a Nash equilibrium as meta-strategy this is the double oracle method (McMahan, Gordon
& Blum, ICML 2003): iterated best responses, the reference that a league has to beat.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl import exact
from shuttle_marl.arrays import F64, Floats
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.league.meta_games import alpha_rank, nash, uniform
from shuttle_marl.training.league.config import Meta
from shuttle_marl.training.league.mixtures import merged
from shuttle_marl.training.league.population import TOLERANCE

_SOLVERS: Final[dict[Meta, Callable[[F64], F64]]] = {
    "nash": lambda values: nash(values).row,
    "uniform": uniform,
    "alpha-rank": alpha_rank,
}
_LEAST: Final = 1e-3
"""Policies of smaller probability are left out of a meta-strategy: each costs time, and changes next to nothing."""


def meta_strategy(meta: Meta, values: npt.ArrayLike) -> F64:
    """``[N]`` probabilities of the policies of a league.

    Args:
        meta: the solver.
        values: ``[N, N]`` value of the row against the column, antisymmetric.
    """
    found = _SOLVERS[meta](np.asarray(values, dtype=np.float64))
    kept = np.where(found >= min(_LEAST, float(found.max())), found, 0.0)
    return np.asarray(kept / kept.sum())


def respond(policies: Sequence[TabulatedPolicy], shares: Floats) -> tuple[TabulatedPolicy, exact.Response]:
    """A mixture as one policy, and the exact best response to it.

    Args:
        policies: of the mixture.
        shares: their probabilities.
    """
    mixture = merged(policies, shares, merged(policies, shares))
    return mixture, exact.best_response(mixture, tolerance=TOLERANCE)
