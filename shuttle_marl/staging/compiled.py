"""Inner loops of the staging, compiled: inverse kinematics of the arm, and the integration of flights.

One arm or one flight at a time, in plain loops over numbers: on the few arms and flights of a stroke, arrays would spend
their time in calls. What the numbers mean stands in :mod:`shuttle_marl.staging.arm` and :mod:`shuttle_marl.staging.flight`.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from shuttle_marl.kernel.compiling import compiled

Floats = npt.NDArray[np.float64]

_N = 10
_ROWS = 22


@compiled
def _turn(axis: Floats, angle: float, out: Floats) -> None:
    """Rotation about a unit axis (Rodrigues)."""
    x, y, z = axis[0], axis[1], axis[2]
    s, c = math.sin(angle), math.cos(angle)
    d = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + d * x * x, d * x * y - s * z, d * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = d * x * y + s * z, c + d * y * y, d * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = d * x * z - s * y, d * y * z + s * x, c + d * z * z


@compiled
def _times(a: Floats, b: Floats, out: Floats) -> None:
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled
def _on(a: Floats, v: Floats, out: Floats) -> None:
    for i in range(3):
        out[i] = a[i, 0] * v[0] + a[i, 1] * v[1] + a[i, 2] * v[2]


@compiled
def _cross(a: Floats, b: Floats, out: Floats) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def _pose(q: Floats, fixed: Floats, offset: Floats, middle: Floats, rest_bend: float, m: Floats, v: Floats) -> None:
    """One arm: ``m`` gets rotations (0 collar bone, 1 upper arm, 4 racket), ``v`` axes (0 to 9), pivots (10 to 19), points.

    ``fixed``: 0 raise, 1 forward, 2 and 3 swing, 4 middle, 5 elbow, 6 pronation, 7 bend, 8 deviation, 9 the shaft.
    """
    a, b = m[5], m[6]
    _turn(fixed[1], q[1], a)
    _on(a, fixed[0], v[0])
    v[1] = fixed[1]
    _turn(fixed[0], q[0], b)
    _times(a, b, m[0])
    _on(m[0], offset[0], v[20])
    # The swing is a rotation vector across the middle direction; its two axes turn with it.
    x = q[2] * fixed[2] + q[3] * fixed[3]
    angle = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    safe = max(angle, 1e-6)
    _turn(x / safe, safe if angle > 1e-6 else 0.0, a)
    _times(m[0], a, m[7])
    first, second = (1.0 - math.cos(safe)) / safe**2, (safe - math.sin(safe)) / safe**3
    for k in (2, 3):
        _cross(x, fixed[k], v[23])
        _cross(x, v[23], v[24])
        v[25] = fixed[k] + first * v[23] + second * v[24]
        _on(m[0], v[25], v[k])
    _on(m[7], fixed[4], v[4])
    _turn(fixed[4], q[4], a)
    _times(m[7], a, b)
    _times(b, middle, m[1])
    _on(m[1], fixed[5], v[5])
    _turn(fixed[5], q[5] - rest_bend, a)
    _times(m[1], a, m[2])
    _on(m[2], fixed[6], v[6])
    _turn(fixed[6], q[6] / 2, a)
    _times(m[2], a, m[3])
    _times(m[3], a, m[7])
    _on(m[7], fixed[7], v[7])
    _turn(fixed[7], q[7], a)
    _times(m[7], a, b)
    _on(b, fixed[8], v[8])
    _turn(fixed[8], q[8], a)
    _times(b, a, m[7])
    _on(m[7], fixed[9], v[9])
    _turn(fixed[9], q[9], a)
    _times(m[7], a, m[4])
    _on(m[1], offset[1], v[23])
    v[21] = v[20] + v[23]
    _on(m[3], offset[2], v[23])
    v[22] = v[21] + v[23]
    _on(m[7], offset[3], v[23])
    v[10], v[11] = 0.0, 0.0
    v[12], v[13], v[14] = v[20], v[20], v[20]
    v[15], v[16] = v[21], v[21]
    v[17], v[18] = v[22], v[22]
    v[19] = v[22] + v[23]


@compiled
def _eliminate(a: Floats, b: Floats, x: Floats) -> None:
    """Solve a symmetric positive definite system (Cholesky); ``a`` and ``b`` are overwritten."""
    for j in range(_N):
        for k in range(j):
            a[j, j] -= a[j, k] * a[j, k]
        a[j, j] = math.sqrt(a[j, j])
        for i in range(j + 1, _N):
            for k in range(j):
                a[i, j] -= a[i, k] * a[j, k]
            a[i, j] /= a[j, j]
    for i in range(_N):
        for k in range(i):
            b[i] -= a[i, k] * b[k]
        b[i] /= a[i, i]
    for i in range(_N - 1, -1, -1):
        x[i] = b[i]
        for k in range(i + 1, _N):
            x[i] -= a[k, i] * x[k]
        x[i] /= a[i, i]


@compiled
def _within(x: Floats, limits: Floats, swing: float) -> None:
    for k in range(_N):
        x[k] = min(max(x[k], limits[k, 0]), limits[k, 1])
    length = math.sqrt(x[2] * x[2] + x[3] * x[3])
    if length > swing:
        x[2] *= swing / length
        x[3] *= swing / length


@compiled
def solve_arms(
    x: Floats,
    goal: Floats,
    weight: Floats,
    reach: Floats,
    arm: tuple[Any, ...],
    limits: Floats,
    relaxed: Floats,
    swing: float,
    rounds: int,
    hold: float,
) -> None:
    """Damped least squares of :func:`shuttle_marl.staging.arm.solve` for each row of ``x``, in place.

    Args:
        x: ``[N, 10]`` angles, within the limits.
        goal: ``[N, 4, 3]`` point, shaft, normal, elbow.
        weight: ``[N, 4]`` of those.
        reach: ``[N]`` distance of the point from the grip along the shaft.
        arm: constants of the arm: fixed axes, offsets, middle direction, bend at rest, normal of the strings.
        limits: ``[10, 2]`` least and greatest angles.
        relaxed: ``[10]`` preferred angles.
        swing: greatest swing of the shoulder.
        rounds: steps.
        hold: weight of the preferred angles.
    """
    fixed, offset, middle, rest_bend, normal = arm
    m, v = np.empty((8, 3, 3)), np.empty((26, 3))
    jacobian, residual = np.empty((_ROWS, _N)), np.empty(_ROWS)
    square, slope = np.empty((_N, _N)), np.empty(_N)
    a, b, move, moment = np.empty((_N, _N)), np.empty(_N), np.empty(_N), np.empty(3)
    at, held = np.empty((4, 3)), np.empty(_N, np.bool_)
    for n in range(len(x)):
        q = x[n]
        for step in range(rounds):
            _pose(q, fixed, offset, middle, rest_bend, m, v)
            _on(m[4], fixed[9], at[1])
            _on(m[4], normal, at[2])
            for i in range(3):
                at[0, i] = v[19, i] + reach[n] * at[1, i]
                at[3, i] = v[21, i] - v[20, i]
            length = math.sqrt(at[3, 0] ** 2 + at[3, 1] ** 2 + at[3, 2] ** 2)
            for i in range(3):
                at[3, i] /= length
            for k in range(4):
                for i in range(3):
                    residual[3 * k + i] = weight[n, k] * (goal[n, k, i] - at[k, i])
            for j in range(_N):
                for k in range(4):
                    if k == 0:
                        for i in range(3):
                            moment[i] = at[0, i] - v[10 + j, i]
                    else:
                        for i in range(3):
                            moment[i] = at[k, i]
                    _cross(v[j], moment, v[25])
                    for i in range(3):
                        jacobian[3 * k + i, j] = weight[n, k] * v[25, i] if k < 3 or j < 5 else 0.0
            damping = 1e-2 if step < rounds // 2 else 1e-4
            for i in range(_N):
                for j in range(i + 1):
                    total = 0.0
                    for k in range(12):
                        total += jacobian[k, i] * jacobian[k, j]
                    square[i, j] = total
                    square[j, i] = total
                square[i, i] += hold * hold + damping
                total = hold * hold * (relaxed[i] - q[i])
                for k in range(12):
                    total += jacobian[k, i] * residual[k]
                slope[i] = total
            a[:], b[:] = square, slope
            _eliminate(a, b, move)
            # Angles that are pushed against their limits stay there, and the others do their work.
            for i in range(_N):
                held[i] = (q[i] <= limits[i, 0] + 1e-9 and move[i] < 0) or (q[i] >= limits[i, 1] - 1e-9 and move[i] > 0)
            a[:], b[:] = square, slope
            for i in range(_N):
                if held[i]:
                    a[i, :] = 0.0
                    a[:, i] = 0.0
                    a[i, i] = 1.0
                    b[i] = 0.0
            _eliminate(a, b, move)
            change = 0.0
            for i in range(_N):
                b[i] = q[i]
                q[i] += min(max(move[i], -0.5), 0.5)
            _within(q, limits, swing)
            for i in range(_N):
                change = max(change, abs(q[i] - b[i]))
            if step > rounds // 3 and change < 2e-4:
                break


@compiled
def integrate(vx: Floats, vy: Floats, nodes: Floats, out: Floats) -> None:
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
