"""Trunk, legs and quaternions; see :mod:`shuttle_marl.staging.skeleton` and :mod:`shuttle_marl.staging.body`."""

import math
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.staging.linear import (
    add_vec,
    copy_mat,
    copy_vec,
    cross,
    dot,
    from_yaw_pitch_roll,
    mat_mul,
    mat_mul_transposed,
    mat_vec,
    normalise,
    orthonormal_frame,
    rotation_about,
    transposed_mat_mul,
)


class LegConstants(NamedTuple):
    """Geometry and limits of one leg, for the compiled solver.

    Attributes:
        rest: ``[3, 3]`` from hip to knee, to ankle, to toes at rest [m].
        aligned: ``[2, 3, 3]`` frames of thigh and shank at rest.
        thigh: length of the thigh [m].
        shank: length of the shank [m].
        longest: length of the leg as far as it is used [m].
        toe_height: height of the joint of the toes over the floor [m].
        sign: 1 for the right leg, -1 for the left one.
        hip_limits: :data:`HIP_LIMITS`.
        ankle_limits: :data:`ANKLE_LIMITS`.
        toe_limits: :data:`TOE_LIMITS`.
    """

    rest: F64
    aligned: F64
    thigh: float
    shank: float
    longest: float
    toe_height: float
    sign: float
    hip_limits: F64
    ankle_limits: F64
    toe_limits: F64


class FootPath(NamedTuple):
    """One foot over F frames: ``[F, 3]`` ball, ``[F]`` yaw and ``[F]`` pitch of :class:`~shuttle_marl.staging.feet.Feet`."""

    ball: F64
    yaw: F64
    pitch: F64


_OUT: Final = 0.10
"""Outward turn of the knees."""
_FOLDED: Final = 0.45
"""Least share of the length of a leg between hip and ankle."""


@compiled
def bend_trunks(hips: F64, angles: F64, above: F64, rotation: F64, position: F64) -> None:
    """Bones of :func:`shuttle_marl.staging.skeleton.trunk` for each row of ``angles``.

    Args:
        hips: ``[N, 3]`` where the hips are.
        angles: ``[N, 7]``; the first one is not used.
        above: ``[3, 3]`` from each bone to the next at rest.
        rotation: ``[4, N, 3, 3]``, written.
        position: ``[4, N, 3]``, written.
    """
    third, way = np.empty((3, 3)), np.empty(3)
    for n in range(len(angles)):
        a = angles[n]
        from_yaw_pitch_roll(a[1], a[2], a[3], rotation[0, n])
        from_yaw_pitch_roll(a[4] / 3, a[5] / 3, a[6] / 3, third)
        copy_vec(hips[n], position[0, n])
        for k in range(3):
            mat_vec(rotation[k, n], above[k], way)
            add_vec(position[k, n], way, position[k + 1, n])
            mat_mul(rotation[k, n], third, rotation[k + 1, n])


@compiled
def ankle_of(ball: F64, yaw: float, pitch: float, heel: F64, above: float, m: F64, out: F64) -> None:
    """The ankle of a foot that stands on its ball, the heel raised by ``pitch``; ``m`` is overwritten."""
    from_yaw_pitch_roll(yaw, pitch, 0.0, m)
    mat_vec(m, heel, out)
    for i in range(3):
        out[i] += ball[i]
    out[2] += above


@compiled
def raise_heels(joint: F64, ball: F64, yaw: F64, heel: F64, above: float, limit: float, angles: F64, out: F64) -> None:
    """Least of ``angles`` by which each heel has to be raised for the leg to reach the foot, the last one if none does.

    Args:
        joint: ``[F, 3]`` hip joint.
        ball: ``[F, 3]`` ball of the foot.
        yaw: ``[F]`` heading of the foot.
        heel: ``[3]`` from the joint of the toes to the ankle, of a foot that points forward.
        above: height of the joint of the toes over the floor.
        limit: length of the leg that is used.
        angles: ``[K]`` ascending.
        out: ``[F]``, written.
    """
    m, ankle = np.empty((3, 3)), np.empty(3)
    for f in range(len(joint)):
        out[f] = angles[-1]
        for angle in angles:
            ankle_of(ball[f], yaw[f], angle, heel, above, m, ankle)
            square = 0.0
            for i in range(3):
                square += (ankle[i] - joint[f, i]) ** 2
            if square <= limit * limit:
                out[f] = angle
                break


@compiled
def stand_ankles(ball: F64, yaw: F64, pitch: F64, heel: F64, above: float, out: F64) -> None:
    """``[F, 3]`` ankles of feet that stand on their balls, the heels raised by ``pitch``."""
    m = np.empty((3, 3))
    for f in range(len(ball)):
        ankle_of(ball[f], yaw[f], pitch[f], heel, above, m, out[f])


@compiled
def _shortest_rotation(a: F64, b: F64, axis: F64, out: F64) -> None:
    """The shortest rotation of ``a`` onto ``b``."""
    cross(a, b, axis)
    angle = math.atan2(math.sqrt(dot(axis, axis)), dot(a, b))
    if math.sqrt(dot(axis, axis)) < 1e-12:
        angle = 0.0
    normalise(axis)
    rotation_about(axis, angle, out)


@compiled
def _clip(x: float, limits: F64) -> float:
    return min(max(x, limits[0]), limits[1])


class _HipWorkspace(NamedTuple):
    """Scratch of the hip joint: ``[3, 3]`` rotations and ``[3]`` vectors.

    Rotations of the thigh against the hips: ``relative``, its shortest part ``swing`` and the rest ``twist``; ``product`` of
    two of them. Vectors: direction of the thigh ``way``, an axis ``side`` across it at rest, that axis ``turned`` by
    ``relative`` and ``swung`` by ``swing``, ``axis`` of the swing, and ``normal`` to the two.
    """

    relative: F64
    swing: F64
    twist: F64
    product: F64
    way: F64
    side: F64
    turned: F64
    swung: F64
    axis: F64
    normal: F64


class _LegWorkspace(NamedTuple):
    """One leg in one frame: ``[3, 3]`` rotations and ``[3]`` vectors.

    Rotations: ``thigh``, ``shank`` and ``sole``; ``floor``, a sole that follows the floor, and ``limited``, that sole within the
    range of the ankle; scratch: ``frame`` of a bone, ``bend`` of the knee, ``joint`` of the ankle. Positions: ``knee``, ``ankle``
    and its ``target``. Vectors: ``heel`` from the joint of the toes to the ankle and ``toes`` back; from hip to ankle ``down``,
    to knee ``upper``, from there ``lower``; ``aim`` and ``hinge`` of the knee, ``rest`` direction of the thigh, ``normal`` of
    the floor.
    """

    thigh: F64
    shank: F64
    sole: F64
    floor: F64
    limited: F64
    knee: F64
    ankle: F64
    target: F64
    heel: F64
    toes: F64
    frame: F64
    bend: F64
    joint: F64
    down: F64
    aim: F64
    upper: F64
    lower: F64
    hinge: F64
    rest: F64
    normal: F64
    hip: _HipWorkspace


@compiled
def _leg_workspace() -> _LegWorkspace:
    m, v = np.empty((12, 3, 3)), np.empty((18, 3))
    hip = _HipWorkspace(m[8], m[9], m[10], m[11], v[12], v[13], v[14], v[15], v[16], v[17])
    return _LegWorkspace(
        m[0], m[1], m[2], m[3], m[4], v[0], v[1], v[2], v[3], v[4],
        m[5], m[6], m[7], v[5], v[6], v[7], v[8], v[9], v[10], v[11], hip,
    )  # fmt: skip


@compiled
def _limit_hip(root: F64, leg: LegConstants, work: _LegWorkspace) -> None:
    """Turn the thigh into the range of the hip joint, in place."""
    upper, thigh, hip = work.thigh, work.rest, work.hip
    relative, swing, way, side, turned, swung = hip.relative, hip.swing, hip.way, hip.side, hip.turned, hip.swung
    transposed_mat_mul(root, upper, relative)
    mat_vec(relative, thigh, way)
    _shortest_rotation(thigh, way, hip.axis, swing)
    for i in range(3):
        side[i] = (1.0 if i == 0 else 0.0) - thigh[0] * thigh[i]
    normalise(side)
    mat_vec(relative, side, turned)
    mat_vec(swing, side, swung)
    cross(swung, turned, hip.normal)
    forward, right = math.atan2(way[1], -way[2]), math.asin(min(max(way[0], -1.0), 1.0))
    twist = -math.atan2(dot(hip.normal, way), dot(swung, turned))
    limits, sign = leg.hip_limits, leg.sign
    new_forward, new_right = _clip(forward, limits[0]), sign * _clip(sign * right, limits[1])
    new_twist = sign * _clip(sign * twist, limits[2])
    if max(abs(new_forward - forward), abs(new_right - right), abs(new_twist - twist)) <= 1e-9:
        return
    way[0] = math.sin(new_right)
    way[1], way[2] = math.cos(new_right) * math.sin(new_forward), -math.cos(new_right) * math.cos(new_forward)
    _shortest_rotation(thigh, way, hip.axis, swing)
    rotation_about(way, -new_twist, hip.twist)
    mat_mul(hip.twist, swing, hip.product)
    mat_mul(root, hip.product, upper)


@compiled
def _limit_ankle(leg: LegConstants, work: _LegWorkspace) -> None:
    """Write the sole that follows the floor as far as the ankle allows to ``work.limited``."""
    shank, wanted, joint, normal, out = work.shank, work.floor, work.joint, work.normal, work.limited
    up, tilt, outward, sign = leg.ankle_limits[0], leg.ankle_limits[1], leg.ankle_limits[2], leg.sign
    # Rising about the ball comes first: far outside the range the three angles would not be independent.
    for i in range(3):
        normal[i] = wanted[0, i] * shank[0, 2] + wanted[1, i] * shank[1, 2] + wanted[2, i] * shank[2, 2]
    bent = math.atan2(normal[1], normal[2])
    from_yaw_pitch_roll(0.0, bent - _clip(bent, up), 0.0, joint)
    mat_mul(wanted, joint, out)
    transposed_mat_mul(shank, out, joint)
    twist = math.atan2(-joint[0, 1], joint[1, 1])
    bow = -math.asin(min(max(joint[2, 1], -1.0), 1.0))
    lean = math.atan2(-joint[2, 0], joint[2, 2])
    from_yaw_pitch_roll(sign * _clip(sign * twist, outward), -_clip(-bow, up), sign * _clip(sign * lean, tilt), joint)
    mat_mul(shank, joint, out)


@compiled
def _solve_leg(joint: F64, root: F64, sole: F64, leg: LegConstants, work: _LegWorkspace) -> None:
    """Thigh, shank, knee and ankle of a leg that reaches for ``work.target`` with its ankle: inverse kinematics of two bones."""
    down, aim, upper, lower, frame = work.down, work.aim, work.upper, work.lower, work.frame
    thigh, shank = leg.thigh, leg.shank
    square = 0.0
    for i in range(3):
        down[i] = work.target[i] - joint[i]
        square += down[i] * down[i]
    length = math.sqrt(square)
    reach = min(max(length, _FOLDED * (thigh + shank)), leg.longest)
    for i in range(3):
        down[i] /= length
    # Knees point between where the hips and where the toes point.
    aim[0], aim[1], aim[2] = sole[0, 1], sole[1, 1], 0.0
    normalise(aim)
    for i in range(3):
        aim[i] = 0.8 * aim[i] + root[i, 1] + leg.sign * _OUT * root[i, 0]
    orthonormal_frame(down, aim, frame)
    along = (thigh**2 - shank**2 + reach**2) / (2 * reach)
    across = math.sqrt(max(thigh**2 - along**2, 0.0))
    for i in range(3):
        aim[i] = frame[i, 1]
        upper[i] = along * down[i] + across * aim[i]
        lower[i] = reach * down[i] - upper[i]
    cross(down, aim, work.hinge)
    orthonormal_frame(upper, work.hinge, frame)
    mat_mul_transposed(frame, leg.aligned[0], work.thigh)
    orthonormal_frame(lower, work.hinge, frame)
    mat_mul_transposed(frame, leg.aligned[1], work.shank)
    # The shank keeps its bend against the thigh when the hip joint limits the thigh.
    transposed_mat_mul(work.thigh, work.shank, work.bend)
    copy_vec(leg.rest[0], work.rest)
    normalise(work.rest)
    _limit_hip(root, leg, work)
    mat_mul(work.thigh, work.bend, work.shank)
    mat_vec(work.thigh, leg.rest[0], work.knee)
    mat_vec(work.shank, leg.rest[1], work.ankle)
    add_vec(joint, work.knee, work.knee)
    add_vec(work.knee, work.ankle, work.ankle)


@compiled
def solve_legs(joint: F64, root: F64, foot: FootPath, leg: LegConstants, rounds: int, rotation: F64, position: F64) -> None:
    """Bones of one leg of :func:`shuttle_marl.staging.body.legs` in each of F frames.

    Args:
        joint: ``[F, 3]`` hip joint.
        root: ``[F, 3, 3]`` rotation of the hips.
        foot: path of the foot.
        leg: the leg.
        rounds: maximum number of solutions per frame.
        rotation: ``[4, F, 3, 3]``, written: thigh, shank, foot, toes.
        position: ``[4, F, 3]``, written: where each begins.
    """
    work = _leg_workspace()
    sole, limited, heel, target = work.sole, work.limited, work.heel, work.target
    heel[0], heel[1], heel[2] = 0.0, -leg.rest[2, 1], -leg.rest[2, 2]
    for f in range(len(joint)):
        from_yaw_pitch_roll(foot.yaw[f], foot.pitch[f], 0.0, work.floor)
        copy_mat(work.floor, sole)
        for step in range(rounds):
            mat_vec(sole, heel, target)
            add_vec(foot.ball[f], target, target)
            target[2] += leg.toe_height
            _solve_leg(joint[f], root[f], work.floor if step else sole, leg, work)
            _limit_ankle(leg, work)
            change = 0.0
            for i in range(3):
                for j in range(3):
                    change = max(change, abs(limited[i, j] - sole[i, j]))
            copy_mat(limited, sole)
            # Where the ankle does not let the sole follow the floor, the leg is solved again.
            if change <= (1e-4 if step else 1e-6):
                break
        bend = min(max(-math.asin(min(max(sole[2, 1], -1.0), 1.0)), leg.toe_limits[0]), leg.toe_limits[1])
        from_yaw_pitch_roll(0.0, -bend, 0.0, limited)
        copy_mat(work.thigh, rotation[0, f])
        copy_mat(work.shank, rotation[1, f])
        copy_mat(sole, rotation[2, f])
        mat_mul(sole, limited, rotation[3, f])
        copy_vec(joint[f], position[0, f])
        copy_vec(work.knee, position[1, f])
        copy_vec(work.ankle, position[2, f])
        mat_vec(sole, leg.rest[2], work.toes)
        add_vec(work.ankle, work.toes, position[3, f])


@compiled
def quaternions_of(rotation: F64, out: F64) -> None:
    """``[N, 4]`` quaternions (x, y, z, w) of ``[N, 3, 3]`` rotations, w not negative, by the largest one (Shepperd 1978)."""
    q = np.empty(4)
    for n in range(len(rotation)):
        r = rotation[n]
        trace = r[0, 0] + r[1, 1] + r[2, 2]
        largest, most = 3, trace
        for i in range(3):
            if r[i, i] > most:
                largest, most = i, r[i, i]
        if largest == 3:
            q[3] = 1.0 + trace
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                q[i] = r[k, j] - r[j, k]
        else:
            i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
            q[i] = 1.0 - trace + 2.0 * r[i, i]
            q[j], q[k], q[3] = r[j, i] + r[i, j], r[k, i] + r[i, k], r[k, j] - r[j, k]
        length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        if q[3] < 0:
            length = -length
        for i in range(4):
            out[n, i] = q[i] / length
