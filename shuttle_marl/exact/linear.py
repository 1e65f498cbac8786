"""Linear equations x = T x whose T contracts: a Krylov method for speed, plain sweeps for the proof."""

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.exact.contraction import ROUNDING

Floats = npt.NDArray[np.float64]

_DIRECTIONS: Final = 60
"""Search directions that are kept; solutions take about a dozen."""


def accelerated(linear: Callable[[Floats], Floats], constant: Floats, done: Callable[[Floats], bool]) -> Floats:
    """An approximate solution of x = constant + linear(x), by generalised conjugate residuals.

    (Eisenstat, Elman & Schultz, SIAM J. Numer. Anal. 1983.) Values of rallies have one slow mode, that the rally goes on, and
    a handful of directions remove it, where plain sweeps need one for every stroke of a long rally. Inner products are
    sums of numpy and not of a BLAS library, whose rounding depends on its number of threads.

    Args:
        linear: the linear part.
        constant: ``[S]``, also the first guess.
        done: called with the residual ``constant + linear(x) - x``; whether it is good enough.

    Returns:
        ``[S]``; where the method stagnates, what it had by then.
    """
    x, residual = constant.copy(), linear(constant)
    directions: list[tuple[Floats, Floats]] = []
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
    constant: Floats,
    linear: Callable[[Floats], Floats],
    *,
    norm: Callable[[Floats], float],
    bound: Callable[[float, Floats], float],
    tolerance: float,
) -> tuple[Floats, float, float]:
    """Solve x = T x = constant + linear(x) for an affine contraction T.

    Args:
        constant: ``[S]``, also the first guess.
        linear: the linear part.
        norm: of a residual, in which T contracts.
        bound: error bound of T x from the norm of T x - x, and from T x.
        tolerance: largest error bound that is good enough.

    Returns:
        ``[S]`` z = T x, the norm of z - x, and the error bound of z.
    """
    x = accelerated(linear, constant, lambda r: bound(norm(r), constant) <= tolerance / 2)
    while True:
        z = constant + linear(x)
        residual = norm(z - x)
        error = bound(residual, z)
        # Below the rounding of a sweep nothing gets better any more.
        if error <= tolerance or residual <= ROUNDING:
            return z, residual, error
        x = z
