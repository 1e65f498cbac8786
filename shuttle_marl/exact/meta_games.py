"""Meta-games: equilibria of a payoff matrix whose strategies are policies.

An entry is the payoff of the row policy against the column policy, on any scale. The symmetric zero-sum game between N policies
has an antisymmetric matrix.

- :func:`nash`: a Nash equilibrium of any zero-sum matrix game, by linear programming; one of possibly many, with small support.
- :func:`nash_average`: the maximum-entropy equilibrium of an antisymmetric matrix, which is unique and invariant to copies of a
  policy (Balduzzi et al., NeurIPS 2018).
"""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog, minimize
from scipy.special import softmax

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.base.errors import ShuttleError

_ROUNDING: Final = 1e-9  # payoffs that differ by less, relative to the largest one, are equal


class MetaGameError(ShuttleError):
    """Invalid payoff matrix or parameters."""


class Equilibrium(NamedTuple):
    """An equilibrium of a zero-sum game.

    Attributes:
        row: ``[N]`` strategy of the row player.
        column: ``[M]`` strategy of the column player.
        value: payoff of the row player.
    """

    row: F64
    column: F64
    value: float


def nash(payoff: npt.ArrayLike) -> Equilibrium:
    """A Nash equilibrium of a zero-sum game, by linear programming.

    Args:
        payoff: ``[N, M]`` payoff of the row player.

    Raises:
        MetaGameError: the payoff is not a matrix of finite numbers.
    """
    a = _matrix(payoff)
    row = _maximin(a)
    return Equilibrium(row=row, column=_maximin(-a.T), value=float((row @ a).min()))


def _maximin(a: F64) -> F64:
    """``[N]`` maximin strategy of the row player."""
    rows, columns = a.shape
    scale = max(float(np.abs(a).max()), 1e-300)
    # Variables: the probabilities and the value v, a lower bound of the payoff against every column.
    against, one = np.c_[-a.T / scale, np.ones(columns)], np.r_[np.ones(rows), 0.0][None]
    return _normalised(_program(np.r_[np.zeros(rows), -1.0], against, [(0, None)] * rows + [(None, None)], one)[:rows])


def _program(cost: F64, above: F64, bounds: list[tuple[float | None, float | None]], one: F64 | None = None) -> F64:
    """The variables x of least cost with ``above @ x <= 0``, and ``one @ x = 1`` if that is given."""
    found = linprog(cost, above, np.zeros(len(above)), one, None if one is None else [1.0], bounds, "highs-ds")
    if not found.success:
        raise MetaGameError(f"the game cannot be solved: {found.message}")
    return np.asarray(found.x)


def nash_average(payoff: npt.ArrayLike) -> F64:
    """``[N]`` maximum-entropy equilibrium of a symmetric zero-sum game.

    Args:
        payoff: ``[N, N]`` antisymmetric matrix.

    Raises:
        MetaGameError: the matrix is not antisymmetric.
    """
    a = _antisymmetric(payoff)
    a = np.round(a / max(float(np.abs(a).max()), 1e-300) / _ROUNDING) * _ROUNDING
    support = _largest_support(a)
    # All rows of the support have payoff 0 against every equilibrium; the other rows have at most 0.
    return _most_entropy(a, support)


def _largest_support(a: F64) -> Bools:
    """``[N]`` union of the supports of all equilibria.

    Unnormalised equilibria form a cone. It contains one in which every entry of the largest support is at least 1, which a linear
    program finds: it maximises the sum of the entries, each counted up to 1.
    """
    n = len(a)
    # Variables: p = counted + surplus, both non-negative, counted at most 1; no row may have a positive payoff against p.
    return _program(np.r_[-np.ones(n), np.zeros(n)], -np.hstack([a.T, a.T]), [(0, 1)] * n + [(0, None)] * n)[:n] > 0.5


def _most_entropy(a: F64, support: Bools) -> F64:
    """``[N]`` maximum-entropy equilibrium, by its dual problem.

    The equilibrium is ``p = softmax(A weight)`` over the support. The weights, non-negative outside of the support, minimise
    ``logsumexp(A weight)``, a smooth convex function.
    """
    free, outside = np.flatnonzero(support), np.flatnonzero(~support)
    rows = a[support][:, np.r_[free, outside]]

    def dual(weight: F64) -> tuple[float, F64]:
        logits = rows @ weight
        top = float(logits.max())
        return top + math.log(float(np.exp(logits - top).sum())), softmax(logits) @ rows

    bounds: list[tuple[float | None, float | None]] = [(None, None)] * len(free) + [(0, None)] * len(outside)
    options = {"ftol": 1e-16, "gtol": 1e-12, "maxiter": 10_000, "maxfun": 100_000}
    weight = minimize(dual, np.zeros(len(a)), jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    out = np.zeros(len(a))
    out[support] = softmax(rows @ weight)
    return out


def _matrix(payoff: npt.ArrayLike) -> F64:
    a = np.asarray(payoff, dtype=np.float64)
    if a.ndim != 2 or not a.size or not np.isfinite(a).all():
        raise MetaGameError(f"payoffs of shape {a.shape}: expected a matrix of finite numbers")
    return a


def _antisymmetric(payoff: npt.ArrayLike) -> F64:
    a = _matrix(payoff)
    if a.shape[0] != a.shape[1]:
        raise MetaGameError(f"payoffs of shape {a.shape}: expected a square matrix")
    if not np.allclose(a, -a.T, rtol=0, atol=1e-6 * max(float(np.abs(a).max()), 1e-300)):
        raise MetaGameError("the payoff matrix is not antisymmetric; expected a = -a.T")
    return np.asarray((a - a.T) / 2)


def _normalised(p: F64) -> F64:
    p = np.maximum(p, 0.0)
    return np.asarray(p / p.sum())
