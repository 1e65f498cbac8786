"""Games whose strategies are policies: equilibria and rankings of a matrix of payoffs.

A payoff is what the policy of the row gets against that of the column, on any scale. In the game between N policies both players
choose from the same ones and one wins what the other loses, so the matrix is antisymmetric. Its equilibria are:

- of :func:`nash`: a strategy of each player that nothing beats, for any matrix; there may be many, this is one with few
  policies;
- of :func:`nash_average`: the one with most entropy, which is unique and treats copies of a policy as one (Balduzzi et al.,
  NeurIPS 2018);
- of :func:`maximal_lottery`: the same of margins of votes (Fishburn 1984; Lanctot et al. 2023, arXiv 2312.03121).

:func:`alpha_rank` is no equilibrium, but says where evolution spends its time (Omidshafiei et al., Scientific Reports 2019).
"""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog, minimize
from scipy.special import softmax

from shuttle_marl.arrays import F64, Bools
from shuttle_marl.errors import ShuttleError

_ROUNDING: Final = 1e-9
"""Payoffs, as shares of the largest one, that differ by less are the same."""
_LEAST_LOG: Final = -600.0
"""Log of the least probability in a chain, so that none is 0 and products of two are numbers still."""
_NEWTON_STEPS: Final = 50


class MetaGameError(ShuttleError):
    """Payoffs that make no game."""


class Equilibrium(NamedTuple):
    """An equilibrium of a zero-sum game.

    Attributes:
        row: ``[N]`` probabilities of the player who chooses a row.
        column: ``[M]`` those of the player who chooses a column.
        value: what the player of the row gets.
    """

    row: F64
    column: F64
    value: float


def nash(payoff: npt.ArrayLike) -> Equilibrium:
    """An equilibrium of a zero-sum game, by linear programming.

    Args:
        payoff: ``[N, M]`` of the row against the column.

    Raises:
        MetaGameError: it is no matrix of finite numbers.
    """
    a = _matrix(payoff)
    return Equilibrium(row=_maximin(a), column=_maximin(-a.T), value=float((_maximin(a) @ a).min()))


def _maximin(a: F64) -> F64:
    """``[N]`` probabilities of rows whose least payoff is largest."""
    rows, columns = a.shape
    scale = max(float(np.abs(a).max()), 1e-300)
    # Variables: the probabilities and the payoff v, which no column makes smaller.
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


def uniform(payoff: npt.ArrayLike) -> F64:
    """``[N]`` equal probabilities."""
    count = len(_matrix(payoff))
    return np.full(count, 1 / count)


def nash_average(payoff: npt.ArrayLike) -> F64:
    """``[N]`` probabilities of the equilibrium with most entropy of a symmetric zero-sum game.

    Args:
        payoff: ``[N, N]``, antisymmetric: what one wins the other loses.

    Raises:
        MetaGameError: it is not antisymmetric.
    """
    a = _antisymmetric(payoff)
    a = np.round(a / max(float(np.abs(a).max()), 1e-300) / _ROUNDING) * _ROUNDING
    support = _largest_support(a)
    # Rows of the support tie with each other in every equilibrium; the others may only lose.
    return _most_entropy(a, support)


def _largest_support(a: F64) -> Bools:
    """``[N]`` policies that some equilibrium plays.

    Strategies that are not normalised form a cone, in which one can be found whose every positive entry is 1 or more: by a linear
    program that maximises the sum of the entries, each counted up to 1.
    """
    n = len(a)
    # Variables: p = counted + surplus, both from 0 on, the first at most 1; nothing may win against p.
    against = -np.hstack([a.T, a.T])
    bounds: list[tuple[float, float | None]] = [(0, 1)] * n + [(0, None)] * n
    found = linprog(np.r_[-np.ones(n), np.zeros(n)], A_ub=against, b_ub=np.zeros(n), bounds=bounds, method="highs-ds")
    if not found.success:
        raise MetaGameError(f"the game cannot be solved: {found.message}")
    return np.asarray(found.x[:n] > 0.5)


def _most_entropy(a: F64, support: Bools) -> F64:
    """``[N]`` the equilibrium with most entropy, by its dual.

    The equilibrium is ``p = softmax(A weight)`` over the support. The weights of the policies, which are not negative outside of
    the support, make the logarithm of the sum of the exponentials least: a smooth convex function.
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
    weight: F64 = minimize(dual, np.zeros(len(order)), jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    # Newton's method over what is not at its bound gets the last digits.
    moving = np.r_[np.ones(len(free), np.bool_), weight[len(free) :] > 0]
    for _ in range(_NEWTON_STEPS):
        p = softmax(rows @ weight)
        part = rows[:, moving]
        slope = p @ part
        curvature = part.T @ (part * p[:, None]) - np.outer(slope, slope)
        step, *_rest = np.linalg.lstsq(curvature, -slope, rcond=1e-12)
        trial = weight.copy()
        trial[moving] += step
        if dual(trial)[0] > dual(weight)[0] or (trial[len(free) :] < 0).any():
            break
        weight = trial
        if np.abs(slope).max(initial=0.0) < 1e-14:
            break
    out = np.zeros(len(a))
    out[support] = softmax(rows @ weight)
    return out


def maximal_lottery(votes: npt.ArrayLike) -> F64:
    """``[N]`` probabilities of the maximal lottery with most entropy: it is liked at least as well as any other lottery.

    Args:
        votes: ``[N, N]`` how often, or with what probability, the row was better than the column; only the difference of the two
            numbers of a pair counts.

    Raises:
        MetaGameError: it is no square matrix of finite numbers.
    """
    counts = _square(votes)
    return nash_average(counts - counts.T)


def alpha_rank(payoff: npt.ArrayLike, *, alpha: float = 100.0, population: int = 50, noise: float = 0.01) -> F64:
    """``[N]`` shares of the time that a population spends at each policy when mutants appear rarely and the fitter ones spread.

    A mutant r takes over a population of s with the probability of fixation ``(1 - exp(-u)) / (1 - exp(-m u))``, ``u = alpha
    (payoff[r, s] - payoff[s, r])``.

    Args:
        payoff: ``[N, N]`` of the row against the column.
        alpha: strength of selection; infinite: the better one always wins but for the noise.
        population: number m of its members.
        noise: probability with which the worse one takes over where alpha is infinite.

    Raises:
        MetaGameError: payoffs that are not finite, or a number out of its range.
    """
    a = _square(payoff)
    if not (alpha > 0 and population >= 2 and 0 < noise < 1):
        raise MetaGameError(
            f"alpha {alpha}, population {population}, noise {noise}: expected a number above 0, 2 or more, and a number in (0, 1)"
        )
    gain = a.T - a  # of the mutant of the column over the population of the row
    if math.isinf(alpha):
        rate = np.where(np.abs(gain) < 1e-14, 0.5, np.where(gain > 0, 1 - noise, noise))
    else:
        rate = np.exp(np.maximum(_log_fixation(alpha * gain, population), _LEAST_LOG))
    return _stationary(rate)


def _log_fixation(u: F64, m: int) -> F64:
    """Log of the probability that one mutant takes over m - 1 others, u its advantage in the log of the odds of copying."""
    size = np.maximum(np.abs(u), 1e-12)
    # log(exp(x) - 1) = x + log(1 - exp(-x)) for x > 0; the two signs of u differ by exp((m - 1) u).
    log = np.log(-np.expm1(-size)) - np.log(-np.expm1(-m * size))
    return np.asarray(np.where(np.abs(u) < 1e-14, -math.log(m), np.where(u > 0, log, log - (m - 1) * size)))


def _stationary(rate: F64) -> F64:
    """``[N]`` stationary distribution of a chain with these positive rates between its states.

    By elimination of one state after another without a subtraction (Grassmann, Taksar & Heyman 1985), so that small shares are as
    precise as large ones.
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
        out /= out.max()  # shares far apart would leave the range of a number
    return _normalised(out)


def _matrix(payoff: npt.ArrayLike) -> F64:
    a = np.asarray(payoff, dtype=np.float64)
    if a.ndim != 2 or not a.size or not np.isfinite(a).all():
        raise MetaGameError(f"payoffs of shape {a.shape}: expected a matrix of finite numbers")
    return a


def _square(payoff: npt.ArrayLike) -> F64:
    a = _matrix(payoff)
    if a.shape[0] != a.shape[1]:
        raise MetaGameError(f"payoffs of shape {a.shape}: expected as many rows as columns")
    return a


def _antisymmetric(payoff: npt.ArrayLike) -> F64:
    a = _square(payoff)
    if not np.allclose(a, -a.T, rtol=0, atol=1e-6 * max(float(np.abs(a).max()), 1e-300)):
        raise MetaGameError("payoffs of a game in which one player does not lose what the other wins; expected a = -a.T")
    return np.asarray((a - a.T) / 2)


def _normalised(p: F64) -> F64:
    p = np.maximum(p, 0.0)
    return np.asarray(p / p.sum())
