"""Arms: forward kinematics, and inverse kinematics by damped least squares; see :mod:`shuttle_marl.staging.arm`."""

import math
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.staging.linear import (
    Mat,
    add,
    cross,
    dot,
    mat_mul,
    mat_vec,
    over,
    put_mat,
    put_vec,
    rotation_about,
    scaled,
    sub,
)

ANGLES: Final = (
    "collar bone up",
    "collar bone forward",
    "shoulder swing 1",
    "shoulder swing 2",
    "shoulder twist",
    "elbow bend",
    "forearm pronation",
    "wrist bend",
    "wrist deviation",
    "grip roll",
)
"""Names of the angles."""
RAISE, FORWARD, SWING_1, SWING_2, TWIST, ELBOW, PRONATION, BEND, DEVIATION, ROLL = range(10)


class ArmConstants(NamedTuple):
    """Geometry and limits of a right arm, for the compiled solver.

    Attributes:
        axes: ``[10, 3]`` axis of each angle in its own frame; the last one is the shaft.
        offset: ``[4, 3]`` from collar bone to shoulder, elbow, hand and grip at rest [m].
        to_middle: ``[3, 3]`` rotation of the arm at rest into :data:`shuttle_marl.staging.arm.MIDDLE`.
        rest_bend: bend of the elbow at rest [rad].
        string_normal: ``[3]`` side of the strings that a forehand strikes with, at rest.
        limits: ``[10, 2]`` least and greatest angles [rad].
        relaxed: ``[10]`` preferred angles [rad].
        swing_limit: greatest swing of the shoulder [rad].
    """

    axes: F64
    offset: F64
    to_middle: F64
    rest_bend: float
    string_normal: F64
    limits: F64
    relaxed: F64
    swing_limit: float


class ArmGoals(NamedTuple):
    """Goals of N arms, for the compiled solver.

    Attributes:
        target: ``[N, 4, 3]`` point, shaft, normal and elbow of :class:`Goal`.
        weight: ``[N, 4]`` their weights.
        reach: ``[N]`` distance of the point from the grip along the shaft [m].
    """

    target: F64
    weight: F64
    reach: F64


_N: Final = 10
_BEGINS: Final = (RAISE, TWIST, ELBOW, BEND, ROLL)
"""Angles at whose pivots the bones begin."""
_ROWS: Final = 12
"""Residuals of one arm: three each for point, shaft, normal and elbow."""


@compiled
def _hinged(chain: Mat, axis: F64, angle: float, out: F64) -> Mat:
    """A rotation followed by one about a hinge, whose axis is written to ``out``."""
    put_vec(mat_vec(chain, axis), out)
    return mat_mul(chain, rotation_about(axis, angle))


@compiled
def _pose(q: F64, arm: ArmConstants, axes: F64, pivots: F64) -> tuple[Mat, Mat, Mat, Mat, Mat]:
    """Forward kinematics of one arm with ``[10]`` angles: collar bone, upper arm, forearm, hand and racket.

    ``[10, 3]`` axes of the angles and a point on each are written: the first is the origin, the last the middle of the grip.
    """
    fixed = arm.axes
    raised = rotation_about(fixed[FORWARD], q[FORWARD])
    put_vec(fixed[FORWARD], axes[FORWARD])
    collar = _hinged(raised, fixed[RAISE], q[RAISE], axes[RAISE])
    # The swing is a rotation vector across the middle direction; its two axes turn with it.
    swing = add(scaled(q[SWING_1], fixed[SWING_1]), scaled(q[SWING_2], fixed[SWING_2]))
    angle = math.sqrt(dot(swing, swing))
    safe = max(angle, 1e-6)
    swung = mat_mul(collar, rotation_about(over(swing, safe), safe if angle > 1e-6 else 0.0))
    first, second = (1.0 - math.cos(safe)) / safe**2, (safe - math.sin(safe)) / safe**3
    for k in (SWING_1, SWING_2):
        across = cross(swing, fixed[k])
        along = add(add(fixed[k], scaled(first, across)), scaled(second, cross(swing, across)))
        put_vec(mat_vec(collar, along), axes[k])
    upper = mat_mul(_hinged(swung, fixed[TWIST], q[TWIST], axes[TWIST]), arm.to_middle)
    bent = _hinged(upper, fixed[ELBOW], q[ELBOW] - arm.rest_bend, axes[ELBOW])
    forearm = _hinged(bent, fixed[PRONATION], q[PRONATION] / 2, axes[PRONATION])
    pronated = mat_mul(forearm, rotation_about(fixed[PRONATION], q[PRONATION] / 2))
    wrist = _hinged(pronated, fixed[BEND], q[BEND], axes[BEND])
    hand = _hinged(wrist, fixed[DEVIATION], q[DEVIATION], axes[DEVIATION])
    racket = _hinged(hand, fixed[ROLL], q[ROLL], axes[ROLL])
    begins = mat_vec(collar, arm.offset[0])
    elbow = add(begins, mat_vec(upper, arm.offset[1]))
    ends = add(elbow, mat_vec(forearm, arm.offset[2]))
    grip = add(ends, mat_vec(hand, arm.offset[3]))
    origin = (0.0, 0.0, 0.0)
    points = (origin, origin, begins, begins, begins, elbow, elbow, ends, ends, grip)
    for k in range(_N):
        put_vec(points[k], pivots[k])
    return collar, upper, forearm, hand, racket


@compiled
def _cholesky_solve(square: F64, right: F64, factor: F64, b: F64, x: F64) -> None:
    """Solve ``square @ x = right``, symmetric positive definite; ``factor`` and ``b`` are overwritten."""
    for i in range(_N):
        b[i] = right[i]
        for j in range(_N):
            factor[i, j] = square[i, j]
    for j in range(_N):
        for k in range(j):
            factor[j, j] -= factor[j, k] * factor[j, k]
        factor[j, j] = math.sqrt(factor[j, j])
        for i in range(j + 1, _N):
            for k in range(j):
                factor[i, j] -= factor[i, k] * factor[j, k]
            factor[i, j] /= factor[j, j]
    for i in range(_N):
        for k in range(i):
            b[i] -= factor[i, k] * b[k]
        b[i] /= factor[i, i]
    for i in range(_N - 1, -1, -1):
        x[i] = b[i]
        for k in range(i + 1, _N):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]


@compiled
def _clip(q: F64, arm: ArmConstants) -> None:
    """Move ``[10]`` angles into their limits, in place."""
    for k in range(_N):
        q[k] = min(max(q[k], arm.limits[k, 0]), arm.limits[k, 1])
    length = math.sqrt(q[SWING_1] * q[SWING_1] + q[SWING_2] * q[SWING_2])
    if length > arm.swing_limit:
        q[SWING_1] *= arm.swing_limit / length
        q[SWING_2] *= arm.swing_limit / length


@compiled
def _residuals(
    arm: ArmConstants, goals: ArmGoals, n: int, racket: Mat, axes: F64, pivots: F64, jacobian: F64, residual: F64
) -> None:
    """Weighted residuals ``[12]`` of one arm to goal ``n`` and their geometric Jacobian ``[12, 10]``."""
    shaft, elbow = mat_vec(racket, arm.axes[ROLL]), sub(pivots[ELBOW], pivots[TWIST])
    point = add(pivots[ROLL], scaled(goals.reach[n], shaft))
    reached = (point, shaft, mat_vec(racket, arm.string_normal), over(elbow, math.sqrt(dot(elbow, elbow))))
    for k in range(4):
        weight = goals.weight[n, k]
        for i in range(3):
            residual[3 * k + i] = weight * (goals.target[n, k, i] - reached[k][i])
        for j in range(_N):
            change = cross(axes[j], sub(point, pivots[j]) if k == 0 else reached[k])
            for i in range(3):
                jacobian[3 * k + i, j] = weight * change[i] if k < 3 or j < ELBOW else 0.0


@compiled
def solve_arms(angles: F64, goals: ArmGoals, arm: ArmConstants, rounds: int, hold: float) -> None:
    """Damped least squares of :func:`shuttle_marl.staging.arm.solve` for each row of ``angles``, in place.

    Args:
        angles: ``[N, 10]`` within the limits.
        rounds: maximum number of steps.
        hold: weight of the preferred angles.
    """
    limits, axes, pivots = arm.limits, np.empty((_N, 3)), np.empty((_N, 3))
    jacobian, residual = np.empty((_ROWS, _N)), np.empty(_ROWS)
    square, slope = np.empty((_N, _N)), np.empty(_N)
    factor, b, move, held = np.empty((_N, _N)), np.empty(_N), np.empty(_N), np.empty(_N, np.bool_)
    for n in range(len(angles)):
        q = angles[n]
        for step in range(rounds):
            racket = _pose(q, arm, axes, pivots)[4]
            _residuals(arm, goals, n, racket, axes, pivots, jacobian, residual)
            damping = 1e-2 if step < rounds // 2 else 1e-4
            for i in range(_N):
                for j in range(i + 1):
                    total = 0.0
                    for k in range(_ROWS):
                        total += jacobian[k, i] * jacobian[k, j]
                    square[i, j] = total
                    square[j, i] = total
                square[i, i] += hold * hold + damping
                total = hold * hold * (arm.relaxed[i] - q[i])
                for k in range(_ROWS):
                    total += jacobian[k, i] * residual[k]
                slope[i] = total
            _cholesky_solve(square, slope, factor, b, move)
            # Angles pushed against their limits are fixed, and the step is solved again for the others.
            for i in range(_N):
                held[i] = (q[i] <= limits[i, 0] + 1e-9 and move[i] < 0) or (q[i] >= limits[i, 1] - 1e-9 and move[i] > 0)
            for i in range(_N):
                if held[i]:
                    for j in range(_N):
                        square[i, j], square[j, i] = 0.0, 0.0
                    square[i, i], slope[i] = 1.0, 0.0
            _cholesky_solve(square, slope, factor, b, move)
            change = 0.0
            for i in range(_N):
                b[i] = q[i]
                q[i] += min(max(move[i], -0.5), 0.5)
            _clip(q, arm)
            for i in range(_N):
                change = max(change, abs(q[i] - b[i]))
            if step > rounds // 3 and change < 2e-4:
                break


@compiled
def pose_arms(angles: F64, arm: ArmConstants, rotation: F64, position: F64, axes: F64, pivot: F64) -> None:
    """Bones of :meth:`shuttle_marl.staging.arm.Arm.pose` for each row of ``angles``.

    Args:
        angles: ``[N, 10]``.
        rotation: ``[5, N, 3, 3]``, written: collar bone, upper arm, forearm, hand, racket.
        position: ``[5, N, 3]``, written: where each begins.
        axes: ``[N, 10, 3]``, written: axis of each angle.
        pivot: ``[N, 10, 3]``, written: a point on that axis.
    """
    for n in range(len(angles)):
        turns = _pose(angles[n], arm, axes[n], pivot[n])
        for k in range(5):
            put_mat(turns[k], rotation[k, n])
            put_vec(pivot[n, _BEGINS[k]], position[k, n])
