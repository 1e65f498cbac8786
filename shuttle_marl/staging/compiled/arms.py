"""The arm: from angles to bones, and inverse kinematics. What the numbers mean stands in :mod:`shuttle_marl.staging.arm`."""

import math
from typing import Any, Final

import numpy as np

from shuttle_marl.arrays import F64
from shuttle_marl.kernel.compiling import compiled
from shuttle_marl.staging.compiled.linear import add, cross, on, place, put, times, turn

_N: Final = 10
_ROWS: Final = 22


@compiled
def _pose(q: F64, fixed: F64, offset: F64, middle: F64, rest_bend: float, m: F64, v: F64) -> None:
    """One arm: ``m`` gets rotations (0 collar bone, 1 upper arm, 4 racket), ``v`` axes (0 to 9), pivots (10 to 19), points.

    ``fixed``: 0 raise, 1 forward, 2 and 3 swing, 4 middle, 5 elbow, 6 pronation, 7 bend, 8 deviation, 9 the shaft.
    """
    a, b = m[5], m[6]
    turn(fixed[1], q[1], a)
    on(a, fixed[0], v[0])
    put(fixed[1], v[1])
    turn(fixed[0], q[0], b)
    times(a, b, m[0])
    on(m[0], offset[0], v[20])
    # The swing is a rotation vector across the middle direction; its two axes turn with it.
    x = v[24]
    for i in range(3):
        x[i] = q[2] * fixed[2, i] + q[3] * fixed[3, i]
    angle = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    safe = max(angle, 1e-6)
    for i in range(3):
        v[23, i] = x[i] / safe
    turn(v[23], safe if angle > 1e-6 else 0.0, a)
    times(m[0], a, m[7])
    first, second = (1.0 - math.cos(safe)) / safe**2, (safe - math.sin(safe)) / safe**3
    for k in (2, 3):
        cross(x, fixed[k], v[23])
        cross(x, v[23], v[25])
        for i in range(3):
            v[25, i] = fixed[k, i] + first * v[23, i] + second * v[25, i]
        on(m[0], v[25], v[k])
    on(m[7], fixed[4], v[4])
    turn(fixed[4], q[4], a)
    times(m[7], a, b)
    times(b, middle, m[1])
    on(m[1], fixed[5], v[5])
    turn(fixed[5], q[5] - rest_bend, a)
    times(m[1], a, m[2])
    on(m[2], fixed[6], v[6])
    turn(fixed[6], q[6] / 2, a)
    times(m[2], a, m[3])
    times(m[3], a, m[7])
    on(m[7], fixed[7], v[7])
    turn(fixed[7], q[7], a)
    times(m[7], a, b)
    on(b, fixed[8], v[8])
    turn(fixed[8], q[8], a)
    times(b, a, m[7])
    on(m[7], fixed[9], v[9])
    turn(fixed[9], q[9], a)
    times(m[7], a, m[4])
    on(m[1], offset[1], v[23])
    add(v[20], v[23], v[21])
    on(m[3], offset[2], v[23])
    add(v[21], v[23], v[22])
    on(m[7], offset[3], v[23])
    for i in range(3):
        v[10, i], v[11, i] = 0.0, 0.0
        for k in range(12, 15):
            v[k, i] = v[20, i]
        v[15, i], v[16, i] = v[21, i], v[21, i]
        v[17, i], v[18, i] = v[22, i], v[22, i]
    add(v[22], v[23], v[19])


@compiled
def _eliminate(square: F64, slope: F64, a: F64, b: F64, x: F64) -> None:
    """Solve a symmetric positive definite system (Cholesky); ``a`` and ``b`` are overwritten."""
    for i in range(_N):
        b[i] = slope[i]
        for j in range(_N):
            a[i, j] = square[i, j]
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
def _within(x: F64, limits: F64, swing: float) -> None:
    for k in range(_N):
        x[k] = min(max(x[k], limits[k, 0]), limits[k, 1])
    length = math.sqrt(x[2] * x[2] + x[3] * x[3])
    if length > swing:
        x[2] *= swing / length
        x[3] *= swing / length


@compiled
def solve_arms(
    x: F64,
    goal: F64,
    weight: F64,
    reach: F64,
    arm: tuple[Any, ...],
    limits: F64,
    relaxed: F64,
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
            on(m[4], fixed[9], at[1])
            on(m[4], normal, at[2])
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
                    cross(v[j], moment, v[25])
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
            _eliminate(square, slope, a, b, move)
            # Angles that are pushed against their limits stay there, and the others do their work.
            for i in range(_N):
                held[i] = (q[i] <= limits[i, 0] + 1e-9 and move[i] < 0) or (q[i] >= limits[i, 1] - 1e-9 and move[i] > 0)
            for i in range(_N):
                if held[i]:
                    for j in range(_N):
                        square[i, j], square[j, i] = 0.0, 0.0
                    square[i, i], slope[i] = 1.0, 0.0
            _eliminate(square, slope, a, b, move)
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
def pose_arms(angles: F64, arm: tuple[Any, ...], rotation: F64, position: F64, axes: F64, pivot: F64) -> None:
    """Bones of :meth:`shuttle_marl.staging.arm.Arm.pose` for each row of ``angles``.

    Args:
        angles: ``[N, 10]``.
        arm: constants of the arm.
        rotation: ``[5, N, 3, 3]``, written: collar bone, upper arm, forearm, hand, racket.
        position: ``[5, N, 3]``, written: where they begin.
        axes: ``[N, 10, 3]``, written: axis about which each angle turns.
        pivot: ``[N, 10, 3]``, written: a point on it.
    """
    fixed, offset, middle, rest_bend, _ = arm
    m, v = np.empty((8, 3, 3)), np.empty((26, 3))
    for n in range(len(angles)):
        _pose(angles[n], fixed, offset, middle, rest_bend, m, v)
        for k, of in enumerate((0, 1, 3, 7, 4)):
            place(m[of], rotation[k, n])
        for k, of in enumerate((10, 20, 21, 22, 19)):
            put(v[of], position[k, n])
        for k in range(_N):
            put(v[k], axes[n, k])
            put(v[_N + k], pivot[n, k])
