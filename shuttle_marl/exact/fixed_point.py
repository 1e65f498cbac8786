"""Fixed points x = T x of contractions, with error bounds.

Let player i strike in state s. With W(s') the value of the next state, seen by the receiver who strikes there, the value of
s to player i is

    (T_i W)(s) = opt_a [now(s, a) - sum_j next_j(s, a) W(4 e + j)],      e the edge that follows (s, a), j from 0 to 3,

where *opt* is the maximum over the legal strokes, or their mean under a policy pi_i, j the receiver's contact and whether they
are hurried, and sum_j next_j = p r the probability that the rally continues. (Shapley 1953 and Condon 1992 for such games; Patek
& Bertsekas 1999 for games without discount that end with probability 1.)

**T_i is a contraction in the sup norm over the rally states**, those other than the serve. Rally states only follow each
other, and |max_a f - max_a g| <= max_a |f - g|, so |T_i W - T_i U| <= c_i |W - U| with

- c_i = d, the supremum of p r over all legal pairs but the serves, for the maximum;
- c_i = max_s sum_a pi_i(a | s) p r, the largest mean continuation, for the mean under pi_i: at most d.

**The bound.** From x, an approximation of V_0 however found, let y = T_1 x, z = T_0 y and rho = |z - x|. T_0 T_1 contracts
with D = c_0 c_1 and has the fixed point V_0, so |x - V_0| <= |x - z| + |z - V_0| <= rho + D |x - V_0|, so
|x - V_0| <= rho / (1 - D), |z - V_0| <= D |x - V_0|, and for y' = T_1 z, |y' - V_1| <= c_1 |z - V_0|. All rally values
returned, z and y', are within D rho / (1 - D). In the symmetric game V = T V, one operator does: from x, z = T x and
rho = |z - x|, |z - V| <= d rho / (1 - d).

**The serve** follows no state, so its value is one application of T_i to rally values. A serve continues with probability at
most 1, so its error is at most that of the rally values it is computed from, whatever its own p r. It is therefore always
computed last, from rally values for which the bound holds already.

**Rounding.** One application of T_0 T_1 in double precision is off by less than :data:`ROUNDING`; that is added to rho, once
more to the bound because z itself is rounded, and once more for y' and the serve.
"""

import functools
from collections.abc import Callable
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.tables import Game

ROUNDING: Final = 2.0**-40
"""Bound of the rounding of two applications: a term passes through K + 8 roundings at most, as a product of three numbers, in the
sum, and scaled by a unit, and the absolute values of the terms add up to 2 at most. So each application loses at most
2 (K + 8) 2^-53 in double precision: both less than 2^-41 for states of K <= 1000 legal strokes."""

TOLERANCE: Final = 1e-9
"""Default of ``tolerance``: the largest acceptable error bound of values, on the scale from -1 to 1."""

FIRST_RALLY_STATE: Final = 4
"""Base states 0 to 3 are the start of the rally; no state leads there."""

_DIRECTIONS: Final = 60
"""Largest number of search directions; solutions take about a dozen."""

_SOLVED: Final = 1e-3
"""Relative residual at which the linear system of a Newton step counts as solved."""

Linear = Callable[[F64], F64]
"""The linear part of an operator at some x: ``[S]`` to ``[S]``."""
Operator = Callable[[F64], tuple[F64, Linear]]
"""x to T x and the linear part of T at x."""


class ExactError(ShuttleError):
    """Games with different layouts, or values without an error bound."""


def largest_continuation(game: Game) -> float:
    """The supremum d of p r, the probability that the rally continues, over all legal pairs but the serves.

    Raises:
        ExactError: it is 1, so some stroke never ends a rally and values have no bound.
    """
    # The second threshold is the probability, in fixed point, that the stroke ends the rally.
    first = game.pairs_of(FIRST_RALLY_STATE).start
    ends = game.limits[:, first:, 1]
    if not ends.size or ends.min() > 0:
        return float(1 - ends.min(initial=ONE - 1) / ONE)
    level, place = np.unravel_index(int(ends.argmin()), ends.shape)
    pair = first + int(place)
    state = int(level) * game.levels * game.n_base_states + int(game.base_pair_state[pair])
    raise ExactError(
        f"{game.catalogue.names[game.base_pair_stroke[pair]]} never ends the rally in state: "
        f"{game.describe(state)}; exact values need a probability above 0 for every stroke to end it"
    )


def error_bound(residual: float, contraction: float) -> float:
    """``|z - V|`` for ``z = T x``, ``residual = |z - x|`` and an operator T that contracts with ``contraction`` (see above)."""
    return (residual + ROUNDING) * contraction / (1 - contraction) + 2 * ROUNDING


def newton(
    operator: Operator, start: F64, contraction: float, tolerance: float, *, affine: bool
) -> tuple[F64, int, float, float]:
    """The fixed point of an operator that is not linear, by Newton's method: policy iteration, where it takes a maximum.

    Each step solves the operator's linear part at x. If that does not reduce the residual by ``contraction``, as may happen far
    from the fixed point when both players maximise, a plain sweep replaces the step. The error bound is that of a final plain
    sweep.

    Args:
        operator: T, and its linear part; T contracts the rally states.
        start: ``[S]`` initial guess.
        contraction: factor of T.
        tolerance: largest acceptable error bound.
        affine: whether T is affine, so that one Newton step solves it.

    Returns:
        ``[S]`` T x, the number of applications, the residual ``|T x - x|``, and the error bound of T x. Residual and bound
        are over the rally states; the value of the serve is one application behind.
    """
    x = start
    z, linear = operator(x)
    applications, residual = 1, _largest(z - x)
    while True:
        bound = error_bound(residual, contraction)
        # Rounding prevents further progress.
        if bound <= tolerance or residual <= ROUNDING:
            return z, applications, residual, bound
        # At most half of the residual that satisfies the tolerance.
        close_enough = max(0.0 if affine else _SOLVED * residual, tolerance * (1 - contraction) / (2 * contraction))
        there = x + accelerated(linear, z - x, functools.partial(_within, close_enough))
        image, slope = operator(there)
        applications += 1
        left = _largest(image - there)
        if not left <= contraction * residual:
            there, (image, slope) = z, operator(z)
            applications += 1
            left = _largest(image - there)
        x, z, linear, residual = there, image, slope, left


def accelerated(linear: Linear, constant: F64, done: Callable[[F64], bool]) -> F64:
    """An approximate solution of x = constant + linear(x), by generalised conjugate residuals.

    (Eisenstat, Elman & Schultz, SIAM J. Numer. Anal. 1983.) Values of rallies have one slow mode, the continuation of the rally,
    which a few directions remove; plain sweeps need one per stroke of a long rally. Inner products are sums of numpy, because the
    rounding of BLAS depends on the number of threads.

    Args:
        constant: ``[S]``, also the initial guess.
        done: whether a residual ``constant + linear(x) - x`` is acceptable.

    Returns:
        ``[S]``; the last iterate if the method stagnates.
    """
    x, residual = constant.copy(), linear(constant)
    directions: list[tuple[F64, F64]] = []
    while not done(residual) and len(directions) < _DIRECTIONS:
        p, q = residual.copy(), residual - linear(residual)
        for before, image in directions:
            along = (q * image).sum()
            q -= along * image
            p -= along * before
        length = np.sqrt((q * q).sum())
        if not length > 0:
            break
        p /= length
        q /= length
        directions.append((p, q))
        step = (residual * q).sum()
        x += step * p
        residual -= step * q
    return x


def solve_linear(
    constant: F64,
    linear: Linear,
    *,
    norm: Callable[[F64], float],
    bound: Callable[[float, F64], float],
    tolerance: float,
) -> tuple[F64, float, float]:
    """Solve x = T x = constant + linear(x) for an affine contraction T.

    Args:
        constant: ``[S]``.
        norm: norm of a residual, in which T contracts.
        bound: error bound of T x from the norm of T x - x, and from T x.
        tolerance: largest acceptable error bound.

    Returns:
        ``[S]`` z = T x, the norm of z - x, and the error bound of z.
    """
    x = accelerated(linear, constant, lambda r: bound(norm(r), constant) <= tolerance / 2)
    while True:
        z = constant + linear(x)
        residual = norm(z - x)
        error = bound(residual, z)
        # Rounding prevents further progress.
        if error <= tolerance or residual <= ROUNDING:
            return z, residual, error
        x = z


def _largest(difference: F64) -> float:
    """Largest absolute value over the rally states."""
    return float(np.abs(difference[FIRST_RALLY_STATE:]).max(initial=0.0))


def _within(bound: float, difference: F64) -> bool:
    return _largest(difference) <= bound
