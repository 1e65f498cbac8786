"""Curves between key poses, flights of shuttles, and travel of the hips.

See :mod:`shuttle_marl.staging.curves`, :mod:`shuttle_marl.staging.flight` and :mod:`shuttle_marl.staging.assemble`.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.compiling import compiled


class TravelWishes(NamedTuple):
    """Weights of the objective over F frames.

    Attributes:
        weight: ``[F]`` weight of a place.
        target: ``[F, 2]`` weight times place.
        still: ``[F - 1]`` weight of the speed.
    """

    weight: F64
    target: F64
    still: F64


_BENDING: Final = 2e-3
"""Weight of the acceleration."""
_TOP_SPEED, _TOP_ACCELERATION = 6.5, 12.0
"""Limits of the hips over the floor, which are never passed [m/s] and [m/s²]."""
_MARGIN: Final = 0.90
"""Fraction of the limits that the solver aims at."""
_SPEED_PENALTY, _ACCELERATION_PENALTY = 2e-2, 3e-3
"""Penalties of what is above the limits."""
_ROUNDS, _MOST_ROUNDS = 240, 4000
"""Iterations after which the margin is given up, and their maximum number."""
_STIFFER: Final = (400, 1200)
"""Iterations at which the penalties grow twelvefold."""
_SLACK, _LATE_SLACK = 1.02, 0.995 / _MARGIN
"""Factors of the aim below which a path is accepted: paths that want to break the limits converge slowly."""


@compiled
def _at_end(near: float, far: float, chord: float, next_chord: float) -> float:
    """Slope at an end of a curve, from the lengths and the chords of the two intervals next to it."""
    slope = ((2 * near + far) * chord - near * next_chord) / (near + far)
    if slope * chord <= 0:
        return 0.0
    if chord * next_chord <= 0 and abs(slope) > 3 * abs(chord):
        return 3 * chord
    return slope


@compiled
def monotone_slopes(frame: I64, pose: F64, out: F64) -> None:
    """Slopes ``[K, C]`` of C curves through ``[K, C]`` values, at least two, such that cubics never overshoot."""
    k, c = pose.shape
    for j in range(c):
        for i in range(k):
            left = float(frame[i] - frame[i - 1]) if i else 0.0
            right = float(frame[i + 1] - frame[i]) if i + 1 < k else 0.0
            before = (pose[i, j] - pose[i - 1, j]) / left if i else 0.0
            after = (pose[i + 1, j] - pose[i, j]) / right if i + 1 < k else 0.0
            if k == 2:
                out[i, j] = after if i == 0 else before
            elif i == 0:
                further = float(frame[2] - frame[1])
                out[i, j] = _at_end(right, further, after, (pose[2, j] - pose[1, j]) / further)
            elif i == k - 1:
                further = float(frame[i - 1] - frame[i - 2])
                out[i, j] = _at_end(left, further, before, (pose[i - 1, j] - pose[i - 2, j]) / further)
            elif before * after <= 0:
                out[i, j] = 0.0
            else:
                first, second = 2 * right + left, right + 2 * left
                out[i, j] = (first + second) / (first / before + second / after)


@compiled
def run_between(frame: I64, pose: F64, slope: F64, out: F64) -> None:
    """Cubics through ``[K, C]`` values with given slopes, in every frame ``[F, C]``; held before the first and after the last."""
    last, c = len(frame) - 1, pose.shape[1]
    k = 0
    for f in range(len(out)):
        if f <= frame[0] or f >= frame[last]:
            row = 0 if f <= frame[0] else last
            for j in range(c):
                out[f, j] = pose[row, j]
            continue
        while frame[k + 1] <= f:
            k += 1
        h = float(frame[k + 1] - frame[k])
        u = (f - frame[k]) / h
        for j in range(c):
            chord = pose[k + 1, j] - pose[k, j]
            a, b = h * slope[k, j] - chord, chord - h * slope[k + 1, j]
            out[f, j] = pose[k, j] + u * chord + u * (1 - u) * ((1 - u) * a + u * b)


@compiled
def integrate(vx: F64, vy: F64, nodes: F64, out: F64) -> None:
    """Classical Runge-Kutta of flights in scaled units: ``[4, N, K + 1]`` places and velocities at instants ``[N, K + 1]``."""
    k = np.empty((4, 4))
    for n in range(len(vx)):
        out[0, n, 0], out[1, n, 0], out[2, n, 0], out[3, n, 0] = 0.0, 0.0, vx[n], vy[n]
        for i in range(nodes.shape[1] - 1):
            h = nodes[n, i + 1] - nodes[n, i]
            for stage in range(4):
                share = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                u, w = out[2, n, i], out[3, n, i]
                if stage:
                    u += share * k[stage - 1, 2]
                    w += share * k[stage - 1, 3]
                drag = -math.sqrt(u * u + w * w)
                k[stage, 0], k[stage, 1], k[stage, 2], k[stage, 3] = u, w, drag * u, drag * w - 1.0
            for c in range(4):
                out[c, n, i + 1] = out[c, n, i] + h / 6 * (k[0, c] + 2 * k[1, c] + 2 * k[2, c] + k[3, c])


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
def _project(now: F64, limit: float, projected: F64, scaled: F64, relax: float) -> float:
    """Update the multipliers of ``[N, 2]`` vectors limited to length ``limit``; returns the greatest current length."""
    longest = 0.0
    for i in range(len(now)):
        x, y = now[i, 0], now[i, 1]
        longest = max(longest, x * x + y * y)
        x, y = relax * x + (1 - relax) * projected[i, 0] + scaled[i, 0], relax * y + (1 - relax) * projected[i, 1] + scaled[i, 1]
        share = min(1.0, limit / max(math.sqrt(x * x + y * y), 1e-9))
        projected[i, 0], projected[i, 1] = share * x, share * y
        scaled[i, 0], scaled[i, 1] = x - projected[i, 0], y - projected[i, 1]
    return math.sqrt(longest)


@compiled
def _smooth(wishes: TravelWishes, fps: int, p: F64) -> None:
    """Alternating direction method of multipliers of :func:`shuttle_marl.staging.assemble.travel`; ``p`` is written."""
    weight, target, still = wishes.weight, wishes.target, wishes.still
    rho_v, rho_a = _SPEED_PENALTY, _ACCELERATION_PENALTY
    top_speed, top_acceleration = _MARGIN * _TOP_SPEED, _MARGIN * _TOP_ACCELERATION
    n = len(weight)
    speed, bend = float(fps), float(fps) * fps
    bands = np.empty((3, n))
    zv, za = np.zeros((n - 1, 2)), np.zeros((n - 2, 2))
    uv, ua = np.zeros((n - 1, 2)), np.zeros((n - 2, 2))
    for step in range(-1, _MOST_ROUNDS):
        if step < 0 or step in _STIFFER:
            # Where the start is given, the wishes may violate the limits by much: the penalties grow.
            if step > 0:
                rho_v, rho_a = 12 * rho_v, 12 * rho_a
                uv *= 1 / 12
                ua *= 1 / 12
            factor_bands(weight, still, rho_v, speed**2, (_BENDING + rho_a) * bend**2, bands)
        p[:] = target
        if step >= 0:
            push = rho_v * speed * (zv - uv)
            p[1:] += push
            p[:-1] -= push
            push = rho_a * bend * (za - ua)
            p[2:] += push
            p[1:-1] -= 2 * push
            p[:-2] += push
        solve_bands(bands, p)
        relax = 1.6 if step >= 0 else 1.0
        fastest = _project((p[1:] - p[:-1]) * speed, top_speed, zv, uv, relax)
        hardest = _project((p[2:] - 2 * p[1:-1] + p[:-2]) * bend, top_acceleration, za, ua, relax)
        allowed = _SLACK if step < _ROUNDS else _LATE_SLACK
        if step > 0 and step % 10 == 9 and fastest < allowed * top_speed and hardest < allowed * top_acceleration:
            break


def smooth_path(wishes: TravelWishes, fps: int) -> F64:
    """``[F, 2]`` path of the hips over the floor, see :mod:`shuttle_marl.staging.assemble` [m]."""
    path = np.empty_like(wishes.target)
    _smooth(wishes, fps, path)
    return path
