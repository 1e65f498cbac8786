"""Meta-games: equilibria and rankings of a payoff matrix whose strategies are policies.

An entry is the payoff of the row policy against the column policy, on any scale. The symmetric zero-sum game between N policies
has an antisymmetric matrix.

- :func:`nash`: a Nash equilibrium of any zero-sum matrix game, by linear programming; one of possibly many, with small support.
- :func:`nash_average`: the maximum-entropy equilibrium of an antisymmetric matrix, which is unique and invariant to copies of a
  policy (Balduzzi et al., NeurIPS 2018).
- :func:`maximal_lottery`: the same for margins of votes (Fishburn 1984; Lanctot et al. 2023, arXiv 2312.03121).
- :func:`alpha_rank`: not an equilibrium, but the stationary distribution of an evolving population (Omidshafiei et al.,
  Scientific Reports 2019).
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
_LEAST_LOG: Final = -600.0  # lower bound of log rates, so that neither rates nor products of two of them underflow


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


def maximal_lottery(votes: npt.ArrayLike) -> F64:
    """``[N]`` maximal lottery of maximum entropy: no other lottery is preferred to it by a majority in expectation.

    Args:
        votes: ``[N, N]`` number or fraction of votes that prefer the row to the column; only the differences between the two
            numbers of a pair count.

    Raises:
        MetaGameError: the votes are not a square matrix of finite numbers.
    """
    counts = _square(votes)
    return nash_average(counts - counts.T)


def alpha_rank(payoff: npt.ArrayLike, *, alpha: float = 100.0, population: int = 50) -> F64:
    """``[N]`` stationary distribution of a population that consists of one policy at a time, with rare mutants.

    A mutant r replaces a population of s with the fixation probability ``(1 - exp(-u)) / (1 - exp(-m u))``, ``u = alpha
    (payoff[r, s] - payoff[s, r])``.

    Args:
        payoff: ``[N, N]`` payoff of the row against the column.
        alpha: selection intensity.
        population: population size m.

    Raises:
        MetaGameError: the payoffs are not finite, or a parameter is out of range.
    """
    a = _square(payoff)
    if not (0 < alpha < math.inf and population >= 2):
        raise MetaGameError(f"alpha {alpha}, population {population}: expected a finite alpha > 0, and population >= 2")
    gain = a.T - a  # advantage of the mutant (column) over the population (row)
    return _stationary(np.exp(np.maximum(_log_fixation(alpha * gain, population), _LEAST_LOG)))


def _log_fixation(u: F64, m: int) -> F64:
    """Log of the fixation probability of one mutant among m - 1 others with advantage u."""
    size = np.maximum(np.abs(u), 1e-12)
    # log(exp(x) - 1) = x + log(1 - exp(-x)) for x > 0; the two signs of u differ by exp((m - 1) u).
    log = np.log(-np.expm1(-size)) - np.log(-np.expm1(-m * size))
    return np.asarray(np.where(np.abs(u) < 1e-14, -math.log(m), np.where(u > 0, log, log - (m - 1) * size)))


def _stationary(rate: F64) -> F64:
    """``[N]`` stationary distribution of a Markov chain with these positive rates.

    The GTH algorithm (Grassmann, Taksar & Heyman 1985) eliminates states without subtractions, so small probabilities have the
    relative precision of large ones.
    """
    c = rate.copy()
    np.fill_diagonal(c, 0.0)
    count = len(c)
    out = np.zeros(count)
    for k in range(count - 1, 0, -1):
        c[:k, k] /= c[k, :k].sum()
        c[:k, :k] += np.outer(c[:k, k], c[k, :k])
    out[0] = 1.0
    for k in range(1, count):
        out[k] = out[:k] @ c[:k, k]
        out /= out.max()  # prevents overflow
    return _normalised(out)


def _matrix(payoff: npt.ArrayLike) -> F64:
    a = np.asarray(payoff, dtype=np.float64)
    if a.ndim != 2 or not a.size or not np.isfinite(a).all():
        raise MetaGameError(f"payoffs of shape {a.shape}: expected a matrix of finite numbers")
    return a


def _square(payoff: npt.ArrayLike) -> F64:
    a = _matrix(payoff)
    if a.shape[0] != a.shape[1]:
        raise MetaGameError(f"payoffs of shape {a.shape}: expected a square matrix")
    return a


def _antisymmetric(payoff: npt.ArrayLike) -> F64:
    a = _square(payoff)
    if not np.allclose(a, -a.T, rtol=0, atol=1e-6 * max(float(np.abs(a).max()), 1e-300)):
        raise MetaGameError("the payoff matrix is not antisymmetric; expected a = -a.T")
    return np.asarray((a - a.T) / 2)


def _normalised(p: F64) -> F64:
    p = np.maximum(p, 0.0)
    return np.asarray(p / p.sum())
