"""Trunk and legs, and rotations as quaternions. What the numbers mean stands in :mod:`shuttle_marl.staging.skeleton` and
:mod:`shuttle_marl.staging.legs`.
"""

import math
from typing import Any, Final

import numpy as np

from shuttle_marl.arrays import F64
from shuttle_marl.kernel.compiling import compiled
from shuttle_marl.staging.compiled.linear import (
    add,
    back_times,
    cross,
    dot,
    frame_of,
    normalise,
    on,
    place,
    put,
    times,
    times_back,
    turn,
    turned_bowed_leant_of,
)

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
        turned_bowed_leant_of(a[1], a[2], a[3], rotation[0, n])
        turned_bowed_leant_of(a[4] / 3, a[5] / 3, a[6] / 3, third)
        put(hips[n], position[0, n])
        for k in range(3):
            on(rotation[k, n], above[k], way)
            add(position[k, n], way, position[k + 1, n])
            times(rotation[k, n], third, rotation[k + 1, n])


@compiled
def ankle_of(ball: F64, yaw: float, pitch: float, heel: F64, above: float, m: F64, out: F64) -> None:
    """The ankle of a foot that stands on its ball, the heel raised by ``pitch``; ``m`` is overwritten."""
    turned_bowed_leant_of(yaw, pitch, 0.0, m)
    on(m, heel, out)
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
def _shortest(a: F64, b: F64, axis: F64, out: F64) -> None:
    """The shortest rotation of ``a`` onto ``b``."""
    cross(a, b, axis)
    angle = math.atan2(math.sqrt(dot(axis, axis)), dot(a, b))
    if math.sqrt(dot(axis, axis)) < 1e-12:
        angle = 0.0
    normalise(axis)
    turn(axis, angle, out)


@compiled
def _clip(x: float, limits: F64) -> float:
    return min(max(x, limits[0]), limits[1])


@compiled
def _keep_hip(root: F64, thigh: F64, sign: float, limits: F64, upper: F64, m: F64, v: F64) -> None:
    """Turn a thigh into the range of the hip, in place; ``m [4]`` and ``v [6]`` are overwritten."""
    relative, swing = m[0], m[1]
    way, side, turned, axis = v[0], v[1], v[2], v[3]
    back_times(root, upper, relative)
    on(relative, thigh, way)
    _shortest(thigh, way, axis, swing)
    for i in range(3):
        side[i] = (1.0 if i == 0 else 0.0) - thigh[0] * thigh[i]
    normalise(side)
    on(relative, side, turned)
    on(swing, side, v[4])
    cross(v[4], turned, v[5])
    forward, right = math.atan2(way[1], -way[2]), math.asin(min(max(way[0], -1.0), 1.0))
    twist = -math.atan2(dot(v[5], way), dot(v[4], turned))
    kept_forward, kept_right = _clip(forward, limits[0]), sign * _clip(sign * right, limits[1])
    kept_twist = sign * _clip(sign * twist, limits[2])
    if max(abs(kept_forward - forward), abs(kept_right - right), abs(kept_twist - twist)) <= 1e-9:
        return
    way[0] = math.sin(kept_right)
    way[1], way[2] = math.cos(kept_right) * math.sin(kept_forward), -math.cos(kept_right) * math.cos(kept_forward)
    _shortest(thigh, way, axis, swing)
    turn(way, -kept_twist, m[2])
    times(m[2], swing, m[3])
    times(root, m[3], upper)


@compiled
def _keep_ankle(shank: F64, wanted: F64, sign: float, limits: F64, out: F64, m: F64, v: F64) -> None:
    """Turn a sole into the range of the ankle; ``m [2]`` and ``v [1]`` are overwritten."""
    up, tilt, outward = limits[0], limits[1], limits[2]
    # Rising about the ball comes first: far outside the range the three angles would not be independent.
    for i in range(3):
        v[0, i] = wanted[0, i] * shank[0, 2] + wanted[1, i] * shank[1, 2] + wanted[2, i] * shank[2, 2]
    bent = math.atan2(v[0, 1], v[0, 2])
    turned_bowed_leant_of(0.0, bent - _clip(bent, up), 0.0, m[0])
    times(wanted, m[0], m[1])
    back_times(shank, m[1], m[0])
    twist = math.atan2(-m[0, 0, 1], m[0, 1, 1])
    bow = -math.asin(min(max(m[0, 2, 1], -1.0), 1.0))
    lean = math.atan2(-m[0, 2, 0], m[0, 2, 2])
    turned_bowed_leant_of(sign * _clip(sign * twist, outward), -_clip(-bow, up), sign * _clip(sign * lean, tilt), m[1])
    times(shank, m[1], out)


@compiled
def _limb(
    joint: F64,
    target: F64,
    root: F64,
    sole: F64,
    sign: float,
    limb: tuple[Any, ...],
    limits: F64,
    m: F64,
    v: F64,
) -> None:
    """Thigh ``m[0]`` and shank ``m[1]``, knee ``v[0]`` and ankle ``v[1]`` of a leg that reaches for a target with its ankle.

    ``m[2:8]`` and ``v[2:15]`` are overwritten.
    """
    rest, aligned, thigh, shank, most, _ = limb
    down, aim, bend, knee, ankle = v[2], v[3], v[4], v[0], v[1]
    square = 0.0
    for i in range(3):
        down[i] = target[i] - joint[i]
        square += down[i] * down[i]
    length = math.sqrt(square)
    reach = min(max(length, _FOLDED * (thigh + shank)), most)
    for i in range(3):
        down[i] /= length
    # Knees point between where the hips and where the toes point.
    aim[0], aim[1], aim[2] = sole[0, 1], sole[1, 1], 0.0
    normalise(aim)
    for i in range(3):
        aim[i] = 0.8 * aim[i] + root[i, 1] + sign * _OUT * root[i, 0]
    frame_of(down, aim, m[2])
    along = (thigh**2 - shank**2 + reach**2) / (2 * reach)
    across = math.sqrt(max(thigh**2 - along**2, 0.0))
    for i in range(3):
        bend[i] = m[2, i, 1]
        v[5, i] = along * down[i] + across * bend[i]
        v[6, i] = reach * down[i] - v[5, i]
    cross(down, bend, v[7])
    frame_of(v[5], v[7], m[2])
    times_back(m[2], aligned[0], m[0])
    frame_of(v[6], v[7], m[2])
    times_back(m[2], aligned[1], m[1])
    # The shank keeps its bend against the thigh when the hip holds that back.
    back_times(m[0], m[1], m[3])
    put(rest[0], v[8])
    normalise(v[8])
    _keep_hip(root, v[8], sign, limits, m[0], m[4:8], v[9:15])
    times(m[0], m[3], m[1])
    on(m[0], rest[0], knee)
    on(m[1], rest[1], ankle)
    add(joint, knee, knee)
    add(knee, ankle, ankle)


@compiled
def solve_legs(
    joint: F64,
    root: F64,
    ball: F64,
    yaw: F64,
    pitch: F64,
    sign: float,
    limb: tuple[Any, ...],
    hip: F64,
    foot: F64,
    toe: F64,
    rounds: int,
    rotation: F64,
    position: F64,
) -> None:
    """Bones of one leg of :func:`shuttle_marl.staging.legs.legs` in each of F frames.

    Args:
        joint: ``[F, 3]`` hip joint.
        root: ``[F, 3, 3]`` rotation of the hips.
        ball: ``[F, 3]`` ball of the foot.
        yaw: ``[F]`` heading of the foot.
        pitch: ``[F]`` heel raised about the ball.
        sign: 1 for the right leg, -1 for the left one.
        limb: ``[3, 3]`` from hip to knee, to ankle, to toes; ``[2, 3, 3]`` frames of thigh and shank at rest; lengths of thigh,
            of shank, and of the leg as far as it is used; height of the joint of the toes.
        hip: ``[3, 2]`` limits of the hip.
        foot: ``[3, 2]`` limits of the ankle.
        toe: ``[2]`` limits of the toes.
        rounds: how often a leg is solved at most.
        rotation: ``[4, F, 3, 3]``, written: thigh, shank, foot, toes.
        position: ``[4, F, 3]``, written: where they begin.
    """
    rest, above = limb[0], limb[5]
    m, v = np.empty((14, 3, 3)), np.empty((19, 3))
    wanted, sole, now = m[8], m[9], m[10]
    heel, target = v[15], v[16]
    heel[0], heel[1], heel[2] = 0.0, -rest[2, 1], -rest[2, 2]
    for f in range(len(joint)):
        turned_bowed_leant_of(yaw[f], pitch[f], 0.0, wanted)
        place(wanted, sole)
        for step in range(rounds):
            on(sole, heel, target)
            add(ball[f], target, target)
            target[2] += above
            _limb(joint[f], target, root[f], wanted if step else sole, sign, limb, hip, m, v)
            _keep_ankle(m[1], wanted, sign, foot, now, m[11:13], v[17:18])
            change = 0.0
            for i in range(3):
                for j in range(3):
                    change = max(change, abs(now[i, j] - sole[i, j]))
            place(now, sole)
            # Where the ankle does not let the sole follow the floor, the leg is solved again.
            if change <= (1e-4 if step else 1e-6):
                break
        bend = min(max(-math.asin(min(max(sole[2, 1], -1.0), 1.0)), toe[0]), toe[1])
        turned_bowed_leant_of(0.0, -bend, 0.0, now)
        place(m[0], rotation[0, f])
        place(m[1], rotation[1, f])
        place(sole, rotation[2, f])
        times(sole, now, rotation[3, f])
        put(joint[f], position[0, f])
        put(v[0], position[1, f])
        put(v[1], position[2, f])
        on(sole, rest[2], v[18])
        add(v[1], v[18], position[3, f])


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
