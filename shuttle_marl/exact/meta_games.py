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

_ROUNDING: Final = 1e-9
"""Payoffs that differ by less, relative to the largest one, are equal."""
_LEAST_LOG: Final = -600.0
"""Lower bound of log rates, so that neither rates nor products of two of them underflow."""


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
    return Equilibrium(row=_maximin(a), column=_maximin(-a.T), value=float((_maximin(a) @ a).min()))


def _maximin(a: F64) -> F64:
    """``[N]`` maximin strategy of the row player."""
    rows, columns = a.shape
    scale = max(float(np.abs(a).max()), 1e-300)
    # Variables: the probabilities and the value v, a lower bound of the payoff against every column.
    found = linprog(
        np.r_[np.zeros(rows), -1.0],
        A_ub=np.c_[-a.T / scale, np.ones(columns)],
        b_ub=np.zeros(columns),
        A_eq=np.r_[np.ones(rows), 0.0][None],
        b_eq=[1.0],
        bounds=[(0, None)] * rows + [(None, None)],
        method="highs-ds",
    )
    if not found.success:
        raise MetaGameError(f"the game cannot be solved: {found.message}")
    return _normalised(found.x[:rows])


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
    against = -np.hstack([a.T, a.T])
    bounds: list[tuple[float, float | None]] = [(0, 1)] * n + [(0, None)] * n
    found = linprog(np.r_[-np.ones(n), np.zeros(n)], A_ub=against, b_ub=np.zeros(n), bounds=bounds, method="highs-ds")
    if not found.success:
        raise MetaGameError(f"the game cannot be solved: {found.message}")
    return np.asarray(found.x[:n] > 0.5)


def _most_entropy(a: F64, support: Bools) -> F64:
    """``[N]`` maximum-entropy equilibrium, by its dual problem.

    The equilibrium is ``p = softmax(A weight)`` over the support. The weights, non-negative outside of the support, minimise
    ``logsumexp(A weight)``, a smooth convex function.
    """
    rows = a[support]
    free = np.flatnonzero(support)
    outside = np.flatnonzero(~support)
    order = np.r_[free, outside]
    rows = rows[:, order]

    def dual(weight: F64) -> tuple[float, F64]:
        logits = rows @ weight
        top = float(logits.max())
        return top + math.log(float(np.exp(logits - top).sum())), softmax(logits) @ rows

    bounds: list[tuple[float | None, float | None]] = [(None, None)] * len(free) + [(0, None)] * len(outside)
    options = {"ftol": 1e-16, "gtol": 1e-12, "maxiter": 10_000, "maxfun": 100_000}
    weight = minimize(dual, np.zeros(len(order)), jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
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


def alpha_rank(payoff: npt.ArrayLike, *, alpha: float = 100.0, population: int = 50, noise: float = 0.01) -> F64:
    """``[N]`` stationary distribution of a population that consists of one policy at a time, with rare mutants.

    A mutant r replaces a population of s with the fixation probability ``(1 - exp(-u)) / (1 - exp(-m u))``, ``u = alpha
    (payoff[r, s] - payoff[s, r])``.

    Args:
        payoff: ``[N, N]`` payoff of the row against the column.
        alpha: selection intensity; infinite: the fitter policy replaces the other with probability 1 - noise.
        population: population size m.
        noise: probability that the less fit policy replaces the other if alpha is infinite.

    Raises:
        MetaGameError: the payoffs are not finite, or a parameter is out of range.
    """
    a = _square(payoff)
    if not (alpha > 0 and population >= 2 and 0 < noise < 1):
        raise MetaGameError(
            f"alpha {alpha}, population {population}, noise {noise}: expected alpha > 0, population >= 2 and 0 < noise < 1"
        )
    gain = a.T - a  # advantage of the mutant (column) over the population (row)
    if math.isinf(alpha):
        rate = np.where(np.abs(gain) < 1e-14, 0.5, np.where(gain > 0, 1 - noise, noise))
    else:
        rate = np.exp(np.maximum(_log_fixation(alpha * gain, population), _LEAST_LOG))
    return _stationary(rate)


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
