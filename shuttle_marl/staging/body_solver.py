"""Trunk, legs and quaternions; see :mod:`shuttle_marl.staging.skeleton` and :mod:`shuttle_marl.staging.body`."""

import math
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.staging.linear import (
    Mat,
    Vec,
    add,
    cross,
    dot,
    from_yaw_pitch_roll,
    mat_mul,
    mat_vec,
    orthonormal_frame,
    over,
    put_mat,
    put_vec,
    rotation_about,
    scaled,
    sub,
    transposed,
    unit,
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
    for n in range(len(angles)):
        a = angles[n]
        turn, third = from_yaw_pitch_roll(a[1], a[2], a[3]), from_yaw_pitch_roll(a[4] / 3, a[5] / 3, a[6] / 3)
        place = add(hips[n], (0.0, 0.0, 0.0))
        for k in range(4):
            put_mat(turn, rotation[k, n])
            put_vec(place, position[k, n])
            if k < 3:
                place = add(place, mat_vec(turn, above[k]))
                turn = mat_mul(turn, third)


@compiled
def ankle_of(ball: F64, sole: Mat, heel: F64 | Vec, above: float) -> Vec:
    """The ankle of a foot that stands on its ball; ``sole`` is the rotation of the foot."""
    x, y, z = add(mat_vec(sole, heel), ball)
    return x, y, z + above


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
    for f in range(len(joint)):
        out[f] = angles[-1]
        for angle in angles:
            way = sub(ankle_of(ball[f], from_yaw_pitch_roll(yaw[f], angle, 0.0), heel, above), joint[f])
            if dot(way, way) <= limit * limit:
                out[f] = angle
                break


@compiled
def stand_ankles(ball: F64, yaw: F64, pitch: F64, heel: F64, above: float, out: F64) -> None:
    """``[F, 3]`` ankles of feet that stand on their balls, the heels raised by ``pitch``."""
    for f in range(len(ball)):
        put_vec(ankle_of(ball[f], from_yaw_pitch_roll(yaw[f], pitch[f], 0.0), heel, above), out[f])


@compiled
def _shortest_rotation(a: Vec, b: Vec) -> Mat:
    axis = cross(a, b)
    sine = math.sqrt(dot(axis, axis))
    return rotation_about(unit(axis), 0.0 if sine < 1e-12 else math.atan2(sine, dot(a, b)))


@compiled
def _clip(x: float, limits: F64) -> float:
    return min(max(x, limits[0]), limits[1])


@compiled
def _limited_thigh(root: F64, upper: Mat, thigh: Vec, leg: LegConstants) -> Mat:
    """The rotation of a thigh within the range of the hip joint; ``thigh`` is its direction at rest."""
    relative = mat_mul(transposed(root), upper)
    way = mat_vec(relative, thigh)
    # An axis across the thigh: what is left of its turn after the shortest rotation is the twist.
    side = unit(sub((1.0, 0.0, 0.0), scaled(thigh[0], thigh)))
    turned, swung = mat_vec(relative, side), mat_vec(_shortest_rotation(thigh, way), side)
    forward, right = math.atan2(way[1], -way[2]), math.asin(min(max(way[0], -1.0), 1.0))
    twist = -math.atan2(dot(cross(swung, turned), way), dot(swung, turned))
    limits, sign = leg.hip_limits, leg.sign
    new_forward, new_right = _clip(forward, limits[0]), sign * _clip(sign * right, limits[1])
    new_twist = sign * _clip(sign * twist, limits[2])
    if max(abs(new_forward - forward), abs(new_right - right), abs(new_twist - twist)) <= 1e-9:
        return upper
    level = math.cos(new_right)
    way = (math.sin(new_right), level * math.sin(new_forward), -level * math.cos(new_forward))
    return mat_mul(root, mat_mul(rotation_about(way, -new_twist), _shortest_rotation(thigh, way)))


@compiled
def _limited_sole(shank: Mat, wanted: Mat, leg: LegConstants) -> Mat:
    up, tilt, outward, sign = leg.ankle_limits[0], leg.ankle_limits[1], leg.ankle_limits[2], leg.sign
    back = transposed(shank)
    # Rising about the ball comes first: far outside the range the three angles would not be independent.
    normal = mat_vec(transposed(wanted), back[2])
    bent = math.atan2(normal[1], normal[2])
    joint = mat_mul(back, mat_mul(wanted, from_yaw_pitch_roll(0.0, bent - _clip(bent, up), 0.0)))
    twist = math.atan2(-joint[0][1], joint[1][1])
    bow = -math.asin(min(max(joint[2][1], -1.0), 1.0))
    lean = math.atan2(-joint[2][0], joint[2][2])
    limited = from_yaw_pitch_roll(sign * _clip(sign * twist, outward), -_clip(-bow, up), sign * _clip(sign * lean, tilt))
    return mat_mul(shank, limited)


@compiled
def _solve_leg(joint: F64, root: F64, sole: Mat, target: Vec, leg: LegConstants) -> tuple[Mat, Mat, Vec, Vec]:
    """Thigh, shank, knee and ankle of a leg that reaches for a target with its ankle: inverse kinematics of two bones."""
    thigh, shank = leg.thigh, leg.shank
    down = sub(target, joint)
    length = math.sqrt(dot(down, down))
    reach = min(max(length, _FOLDED * (thigh + shank)), leg.longest)
    down = over(down, length)
    # Knees point between where the hips and where the toes point.
    right, ahead, _ = transposed(root)
    aim = add(add(scaled(0.8, unit((sole[0][1], sole[1][1], 0.0))), ahead), scaled(leg.sign * _OUT, right))
    aim = transposed(orthonormal_frame(down, aim))[1]
    along = (thigh**2 - shank**2 + reach**2) / (2 * reach)
    upper = add(scaled(along, down), scaled(math.sqrt(max(thigh**2 - along**2, 0.0)), aim))
    lower = sub(scaled(reach, down), upper)
    hinge = cross(down, aim)
    first = mat_mul(orthonormal_frame(upper, hinge), transposed(leg.aligned[0]))
    second = mat_mul(orthonormal_frame(lower, hinge), transposed(leg.aligned[1]))
    # The shank keeps its bend against the thigh when the hip joint limits the thigh.
    bend = mat_mul(transposed(first), second)
    first = _limited_thigh(root, first, unit(leg.rest[0]), leg)
    second = mat_mul(first, bend)
    knee = add(joint, mat_vec(first, leg.rest[0]))
    return first, second, knee, add(knee, mat_vec(second, leg.rest[1]))


@compiled
def solve_legs(joint: F64, root: F64, foot: FootPath, leg: LegConstants, rounds: int, rotation: F64, position: F64) -> None:
    """Bones of one leg of :func:`shuttle_marl.staging.body.legs` in each of F frames.

    Args:
        joint: ``[F, 3]`` hip joint.
        root: ``[F, 3, 3]`` rotation of the hips.
        rounds: maximum number of solutions per frame.
        rotation: ``[4, F, 3, 3]``, written: thigh, shank, foot, toes.
        position: ``[4, F, 3]``, written: where each begins.
    """
    heel = (0.0, -leg.rest[2, 1], -leg.rest[2, 2])
    for f in range(len(joint)):
        floor = from_yaw_pitch_roll(foot.yaw[f], foot.pitch[f], 0.0)
        sole = floor
        for step in range(rounds):
            target = ankle_of(foot.ball[f], sole, heel, leg.toe_height)
            thigh, shank, knee, ankle = _solve_leg(joint[f], root[f], floor, target, leg)
            limited = _limited_sole(shank, floor, leg)
            change = 0.0
            for i in range(3):
                for j in range(3):
                    change = max(change, abs(limited[i][j] - sole[i][j]))
            sole = limited
            # Where the ankle does not let the sole follow the floor, the leg is solved again.
            if change <= (1e-4 if step else 1e-6):
                break
        bend = _clip(-math.asin(min(max(sole[2][1], -1.0), 1.0)), leg.toe_limits)
        toes = mat_mul(sole, from_yaw_pitch_roll(0.0, -bend, 0.0))
        places = (add(joint[f], (0.0, 0.0, 0.0)), knee, ankle, add(ankle, mat_vec(sole, leg.rest[2])))
        turns = (thigh, shank, sole, toes)
        for k in range(4):
            put_mat(turns[k], rotation[k, f])
            put_vec(places[k], position[k, f])


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
