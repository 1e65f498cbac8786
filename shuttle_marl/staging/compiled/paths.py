"""Travel of the hips. What the numbers mean stands in :mod:`shuttle_marl.staging.travel`."""

import math

import numpy as np

from shuttle_marl.arrays import F64
from shuttle_marl.kernel.compiling import compiled


@compiled
def factor_bands(weight: F64, still: F64, more: float, along: float, across: float, bands: F64) -> None:
    """Cholesky factor of diag(weight) + along · D1' diag(still + more) D1 + across · D2' D2; D1, D2: first, second differences.

    Args:
        weight: ``[F]``.
        still: ``[F - 1]``.
        more: added to ``still``.
        along: weight of first differences.
        across: weight of second differences.
        bands: ``[3, F]``, written: the factor in the row of each frame, two columns before it, one before it, in it.
    """
    n = len(weight)
    second, first, diagonal = bands[0], bands[1], bands[2]
    for i in range(n):
        second[i], first[i], diagonal[i] = 0.0, 0.0, weight[i]
    for i in range(n - 1):
        w = (still[i] + more) * along
        diagonal[i] += w
        diagonal[i + 1] += w
        first[i + 1] -= w
    for i in range(n - 2):
        diagonal[i] += across
        diagonal[i + 1] += 4 * across
        diagonal[i + 2] += across
        first[i + 1] -= 2 * across
        first[i + 2] -= 2 * across
        second[i + 2] += across
    for i in range(n):
        if i > 1:
            second[i] /= diagonal[i - 2]
            first[i] -= second[i] * first[i - 1]
            diagonal[i] -= second[i] * second[i]
        if i > 0:
            first[i] /= diagonal[i - 1]
            diagonal[i] -= first[i] * first[i]
        diagonal[i] = math.sqrt(diagonal[i])


@compiled
def solve_bands(bands: F64, x: F64) -> None:
    """Solve with a factor of :func:`factor_bands`: ``x`` ``[F, 2]`` is the right side, then the solution."""
    n = len(x)
    for i in range(n):
        for c in range(2):
            if i > 0:
                x[i, c] -= bands[1, i] * x[i - 1, c]
            if i > 1:
                x[i, c] -= bands[0, i] * x[i - 2, c]
            x[i, c] /= bands[2, i]
    for i in range(n - 1, -1, -1):
        for c in range(2):
            if i + 1 < n:
                x[i, c] -= bands[1, i + 1] * x[i + 1, c]
            if i + 2 < n:
                x[i, c] -= bands[0, i + 2] * x[i + 2, c]
            x[i, c] /= bands[2, i]


@compiled
def _copy(x: F64, share: float, out: F64) -> None:
    for i in range(len(x)):
        for c in range(2):
            out[i, c] = share * x[i, c]


@compiled
def _project(now: F64, limit: float, kept: F64, scaled: F64, relax: float) -> float:
    """One step of the multipliers for vectors ``[N, 2]`` that shall be no longer than ``limit``; returns the longest one now."""
    longest = 0.0
    for i in range(len(now)):
        x, y = now[i, 0], now[i, 1]
        longest = max(longest, x * x + y * y)
        x, y = relax * x + (1 - relax) * kept[i, 0] + scaled[i, 0], relax * y + (1 - relax) * kept[i, 1] + scaled[i, 1]
        share = min(1.0, limit / max(math.sqrt(x * x + y * y), 1e-9))
        kept[i, 0], kept[i, 1] = share * x, share * y
        scaled[i, 0], scaled[i, 1] = x - kept[i, 0], y - kept[i, 1]
    return math.sqrt(longest)


@compiled
def _differ(p: F64, speed: float, bend: float, v: F64, a: F64) -> None:
    """Speeds and accelerations of a path."""
    for i in range(len(v)):
        for c in range(2):
            v[i, c] = (p[i + 1, c] - p[i, c]) * speed
    for i in range(len(a)):
        for c in range(2):
            a[i, c] = (p[i + 2, c] - 2 * p[i + 1, c] + p[i, c]) * bend


@compiled
def smooth_path(
    weight: F64,
    target: F64,
    still: F64,
    fps: int,
    bending: float,
    penalties: tuple[float, float],
    limits: tuple[float, float],
    rounds: tuple[int, int],
    stiffer: tuple[int, int],
    slack: tuple[float, float],
    p: F64,
) -> None:
    """The alternating direction method of multipliers of :func:`shuttle_marl.staging.travel.travel`.

    Args:
        weight: ``[F]`` of a place.
        target: ``[F, 2]`` weight times place.
        still: ``[F - 1]`` weight against speed.
        fps: frames a second.
        bending: weight against acceleration.
        penalties: of speed and of acceleration beyond the limits.
        limits: of speed and of acceleration.
        rounds: after which more is allowed, and how many there are at most.
        stiffer: rounds from which on the limits are pressed twelve times as hard.
        slack: by how much the limits may be passed before and after the first of ``rounds``.
        p: ``[F, 2]``, written: the path.
    """
    n = len(weight)
    speed, bend = float(fps), float(fps) * fps
    rho_v, rho_a = penalties
    bands = np.empty((3, n))
    v, a = np.empty((n - 1, 2)), np.empty((n - 2, 2))
    zv, za = np.zeros((n - 1, 2)), np.zeros((n - 2, 2))
    uv, ua = np.zeros((n - 1, 2)), np.zeros((n - 2, 2))
    factor_bands(weight, still, rho_v, speed**2, (bending + rho_a) * bend**2, bands)
    _copy(target, 1.0, p)
    solve_bands(bands, p)
    _differ(p, speed, bend, v, a)
    _project(v, limits[0], zv, uv, 1.0)
    _project(a, limits[1], za, ua, 1.0)
    for step in range(rounds[1]):
        if step in stiffer:
            # Where the start is given, the limits may be far from what is wished: they are pressed harder.
            rho_v, rho_a = 12 * rho_v, 12 * rho_a
            _copy(uv, 1 / 12, uv)
            _copy(ua, 1 / 12, ua)
            factor_bands(weight, still, rho_v, speed**2, (bending + rho_a) * bend**2, bands)
        _copy(target, 1.0, p)
        for i in range(n - 1):
            for c in range(2):
                push = rho_v * speed * (zv[i, c] - uv[i, c])
                p[i, c] -= push
                p[i + 1, c] += push
        for i in range(n - 2):
            for c in range(2):
                push = rho_a * bend * (za[i, c] - ua[i, c])
                p[i, c] += push
                p[i + 1, c] -= 2 * push
                p[i + 2, c] += push
        solve_bands(bands, p)
        _differ(p, speed, bend, v, a)
        fastest, hardest = _project(v, limits[0], zv, uv, 1.6), _project(a, limits[1], za, ua, 1.6)
        allowed = slack[0] if step < rounds[0] else slack[1]
        if step % 10 == 9 and fastest < allowed * limits[0] and hardest < allowed * limits[1]:
            break
