"""Arms: forward kinematics, and inverse kinematics by damped least squares; see :mod:`shuttle_marl.staging.arm`."""

import math
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.staging.linear import add_vec, copy_mat, copy_vec, cross, mat_mul, mat_vec, rotation_about

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
_ROWS: Final = 12
"""Residuals of one arm: three each for point, shaft, normal and elbow."""


class _ArmFrames(NamedTuple):
    """One arm in the frame of the chest: ``[3, 3]`` rotations and ``[3]`` vectors.

    Rotations: ``collar`` bone, ``upper`` arm, ``forearm`` (with half of the pronation), ``hand`` and ``racket``; the others are
    scratch. ``[10, 3]`` ``axes`` of the angles and a point on each, ``pivots``: the first is the origin, the last the middle
    of the grip. ``shoulder``, ``elbow`` and ``wrist`` are positions, ``swing`` is the rotation vector of the shoulder.
    """

    collar: F64
    upper: F64
    forearm: F64
    hand: F64
    racket: F64
    axes: F64
    pivots: F64
    shoulder: F64
    elbow: F64
    wrist: F64
    swing: F64
    joint: F64
    chain: F64
    chain_2: F64
    vector: F64
    vector_2: F64


@compiled
def _arm_frames() -> _ArmFrames:
    m, v = np.empty((8, 3, 3)), np.empty((6, 3))
    axes, pivots = np.empty((_N, 3)), np.empty((_N, 3))
    return _ArmFrames(m[0], m[1], m[2], m[3], m[4], axes, pivots, v[0], v[1], v[2], v[3], m[5], m[6], m[7], v[4], v[5])


@compiled
def _pose(q: F64, arm: ArmConstants, frames: _ArmFrames) -> None:
    """Forward kinematics of one arm: ``[10]`` angles to ``frames``."""
    fixed, axes, pivots = arm.axes, frames.axes, frames.pivots
    joint, chain, chain_2 = frames.joint, frames.chain, frames.chain_2
    rotation_about(fixed[FORWARD], q[FORWARD], joint)
    mat_vec(joint, fixed[RAISE], axes[RAISE])
    copy_vec(fixed[FORWARD], axes[FORWARD])
    rotation_about(fixed[RAISE], q[RAISE], chain)
    mat_mul(joint, chain, frames.collar)
    mat_vec(frames.collar, arm.offset[0], frames.shoulder)
    # The swing is a rotation vector across the middle direction; its two axes turn with it.
    swing, vector, vector_2 = frames.swing, frames.vector, frames.vector_2
    for i in range(3):
        swing[i] = q[SWING_1] * fixed[SWING_1, i] + q[SWING_2] * fixed[SWING_2, i]
    angle = math.sqrt(swing[0] * swing[0] + swing[1] * swing[1] + swing[2] * swing[2])
    safe = max(angle, 1e-6)
    for i in range(3):
        vector[i] = swing[i] / safe
    rotation_about(vector, safe if angle > 1e-6 else 0.0, joint)
    mat_mul(frames.collar, joint, chain_2)
    first, second = (1.0 - math.cos(safe)) / safe**2, (safe - math.sin(safe)) / safe**3
    for k in (SWING_1, SWING_2):
        cross(swing, fixed[k], vector)
        cross(swing, vector, vector_2)
        for i in range(3):
            vector_2[i] = fixed[k, i] + first * vector[i] + second * vector_2[i]
        mat_vec(frames.collar, vector_2, axes[k])
    mat_vec(chain_2, fixed[TWIST], axes[TWIST])
    rotation_about(fixed[TWIST], q[TWIST], joint)
    mat_mul(chain_2, joint, chain)
    mat_mul(chain, arm.to_middle, frames.upper)
    mat_vec(frames.upper, fixed[ELBOW], axes[ELBOW])
    rotation_about(fixed[ELBOW], q[ELBOW] - arm.rest_bend, joint)
    mat_mul(frames.upper, joint, chain)
    mat_vec(chain, fixed[PRONATION], axes[PRONATION])
    rotation_about(fixed[PRONATION], q[PRONATION] / 2, joint)
    mat_mul(chain, joint, frames.forearm)
    mat_mul(frames.forearm, joint, chain)
    mat_vec(chain, fixed[BEND], axes[BEND])
    rotation_about(fixed[BEND], q[BEND], joint)
    mat_mul(chain, joint, chain_2)
    mat_vec(chain_2, fixed[DEVIATION], axes[DEVIATION])
    rotation_about(fixed[DEVIATION], q[DEVIATION], joint)
    mat_mul(chain_2, joint, frames.hand)
    mat_vec(frames.hand, fixed[ROLL], axes[ROLL])
    rotation_about(fixed[ROLL], q[ROLL], joint)
    mat_mul(frames.hand, joint, frames.racket)
    mat_vec(frames.upper, arm.offset[1], vector)
    add_vec(frames.shoulder, vector, frames.elbow)
    mat_vec(frames.forearm, arm.offset[2], vector)
    add_vec(frames.elbow, vector, frames.wrist)
    mat_vec(frames.hand, arm.offset[3], vector)
    for i in range(3):
        pivots[RAISE, i], pivots[FORWARD, i] = 0.0, 0.0
    for k in (SWING_1, SWING_2, TWIST):
        copy_vec(frames.shoulder, pivots[k])
    for k in (ELBOW, PRONATION):
        copy_vec(frames.elbow, pivots[k])
    for k in (BEND, DEVIATION):
        copy_vec(frames.wrist, pivots[k])
    add_vec(frames.wrist, vector, pivots[ROLL])


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
    arm: ArmConstants, goals: ArmGoals, n: int, frames: _ArmFrames, reached: F64, jacobian: F64, residual: F64
) -> None:
    """Weighted residuals ``[12]`` of one arm to goal ``n`` and their geometric Jacobian ``[12, 10]``."""
    point, shaft, normal, elbow = reached[0], reached[1], reached[2], reached[3]
    mat_vec(frames.racket, arm.axes[ROLL], shaft)
    mat_vec(frames.racket, arm.string_normal, normal)
    for i in range(3):
        point[i] = frames.pivots[ROLL, i] + goals.reach[n] * shaft[i]
        elbow[i] = frames.elbow[i] - frames.shoulder[i]
    length = math.sqrt(elbow[0] ** 2 + elbow[1] ** 2 + elbow[2] ** 2)
    for i in range(3):
        elbow[i] /= length
    for k in range(4):
        for i in range(3):
            residual[3 * k + i] = goals.weight[n, k] * (goals.target[n, k, i] - reached[k, i])
    moment, change = frames.vector, frames.vector_2
    for j in range(_N):
        for k in range(4):
            if k == 0:
                for i in range(3):
                    moment[i] = point[i] - frames.pivots[j, i]
            else:
                copy_vec(reached[k], moment)
            cross(frames.axes[j], moment, change)
            for i in range(3):
                jacobian[3 * k + i, j] = goals.weight[n, k] * change[i] if k < 3 or j < ELBOW else 0.0


@compiled
def solve_arms(angles: F64, goals: ArmGoals, arm: ArmConstants, rounds: int, hold: float) -> None:
    """Damped least squares of :func:`shuttle_marl.staging.arm.solve` for each row of ``angles``, in place.

    Args:
        angles: ``[N, 10]`` within the limits.
        goals: goals of N arms.
        arm: the arm.
        rounds: maximum number of steps.
        hold: weight of the preferred angles.
    """
    frames, limits = _arm_frames(), arm.limits
    jacobian, residual, reached = np.empty((_ROWS, _N)), np.empty(_ROWS), np.empty((4, 3))
    square, slope = np.empty((_N, _N)), np.empty(_N)
    factor, b, move, held = np.empty((_N, _N)), np.empty(_N), np.empty(_N), np.empty(_N, np.bool_)
    for n in range(len(angles)):
        q = angles[n]
        for step in range(rounds):
            _pose(q, arm, frames)
            _residuals(arm, goals, n, frames, reached, jacobian, residual)
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
        arm: the arm.
        rotation: ``[5, N, 3, 3]``, written: collar bone, upper arm, forearm, hand, racket.
        position: ``[5, N, 3]``, written: where each begins.
        axes: ``[N, 10, 3]``, written: axis of each angle.
        pivot: ``[N, 10, 3]``, written: a point on that axis.
    """
    frames = _arm_frames()
    rotations = (frames.collar, frames.upper, frames.forearm, frames.hand, frames.racket)
    points = (frames.pivots[RAISE], frames.shoulder, frames.elbow, frames.wrist, frames.pivots[ROLL])
    for n in range(len(angles)):
        _pose(angles[n], arm, frames)
        for k in range(5):
            copy_mat(rotations[k], rotation[k, n])
            copy_vec(points[k], position[k, n])
        for k in range(_N):
            copy_vec(frames.axes[k], axes[n, k])
            copy_vec(frames.pivots[k], pivot[n, k])
