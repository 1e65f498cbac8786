"""Legs: heels and hips that settle until the feet are within reach, and the bones from the hips to the toes."""

import functools
import math
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.court.staging.curves import smooth, widen
from shuttle_marl.court.staging.feet import Feet
from shuttle_marl.court.staging.linear import (
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
from shuttle_marl.court.staging.motions import LEFT, RIGHT
from shuttle_marl.court.staging.rotation import apply, frame
from shuttle_marl.court.staging.skeleton import Skeleton

KNEE_LIMITS: Final = tuple(np.radians((2.0, 150.0)))
"""Limits of the bend of the knee [rad]."""
HIP_LIMITS: Final = np.radians([(-45, 130), (-45, 65), (-65, 65)])
"""``[3, 2]`` thigh forward, outward, turned outward against the hips [rad]."""
ANKLE_LIMITS: Final = np.radians([(-55, 38), (-45, 45), (-50, 50)])
"""``[3, 2]`` toes up, foot tilted, foot turned against the shank [rad] (with the joints of the hindfoot)."""
TOE_LIMITS: Final = np.radians((-25.0, 70.0))
"""Toes bent up against the foot [rad]."""
_OUT: Final = 0.10
"""Outward turn of the knees."""
_FOLDED: Final = 0.45
"""Least share of the length of a leg between hip and ankle."""
_ROUNDS: Final = 4
"""Maximum number of solutions of a leg in a frame."""
_LIFTS: Final = 12
"""Maximum number of further solutions for toes under the floor."""
_UNDER: Final = 1e-3
"""Depth of the joint of the toes under its height on the floor above which a leg is drawn up [m]."""
_DROP: Final = 8
"""Half width of the window over which the hips sink towards a distant foot [frames]."""
_STRETCH: Final = 0.985
"""Used fraction of the length of a leg: knees never lock."""
_HEELS: Final = np.linspace(0, np.radians(62), 9)
"""Pitches of a raised heel [rad]."""
_TURN: Final = np.radians(48)


class _Leg(NamedTuple):
    """Geometry of one leg.

    Attributes:
        rest: ``[3, 3]`` from hip to knee, to ankle, to toes at rest [m].
        aligned: ``[2, 3, 3]`` frames of thigh and shank at rest.
        thigh: length of the thigh [m].
        shank: length of the shank [m].
        toe_height: height of the joint of the toes over the floor [m].
        sign: 1 for the right leg, -1 for the left one.
    """

    rest: F64
    aligned: F64
    thigh: float
    shank: float
    toe_height: float
    sign: float


@functools.cache
def _leg_of(skeleton: Skeleton, side: str) -> _Leg:
    rest = np.diff([skeleton.at(f"{side}{bone}") for bone in ("UpLeg", "Leg", "Foot", "ToeBase")], axis=0)
    aligned = frame(rest[:2], np.array([1.0, 0.0, 0.0]))
    return _Leg(rest, aligned, *skeleton.leg, _toe_height(skeleton), 1.0 if side == "Right" else -1.0)


@compiled
def _ankle(ball: F64, sole: Mat, heel: F64 | Vec, above: float) -> Vec:
    """The ankle of a foot that stands on its ball; ``sole`` is the rotation of the foot."""
    x, y, z = add(mat_vec(sole, heel), ball)
    return x, y, z + above


@compiled
def _raised(joint: F64, ball: F64, yaw: F64, heel: F64, above: float, limit: float) -> F64:
    """``[F]`` least pitch by which each heel has to be raised for the leg to reach the foot, the greatest if none does.

    Args:
        joint: ``[F, 3]`` hip joint.
        heel: ``[3]`` from the joint of the toes to the ankle, of a foot that points forward.
        above: height of the joint of the toes over the floor.
        limit: length of the leg that is used.
    """
    out = np.full(len(joint), _HEELS[-1])
    for f in range(len(joint)):
        for angle in _HEELS:
            way = sub(_ankle(ball[f], from_yaw_pitch_roll(yaw[f], angle, 0.0), heel, above), joint[f])
            if dot(way, way) <= limit * limit:
                out[f] = angle
                break
    return out


@compiled
def _ankles(ball: F64, yaw: F64, pitch: F64, heel: F64, above: float) -> F64:
    """``[F, 3]`` ankles of feet that stand on their balls, the heels raised by ``pitch``."""
    out = np.empty_like(ball)
    for f in range(len(ball)):
        put_vec(_ankle(ball[f], from_yaw_pitch_roll(yaw[f], pitch[f], 0.0), heel, above), out[f])
    return out


@compiled
def _shortest_rotation(a: Vec, b: Vec) -> Mat:
    axis = cross(a, b)
    sine = math.sqrt(dot(axis, axis))
    return rotation_about(unit(axis), 0.0 if sine < 1e-12 else math.atan2(sine, dot(a, b)))


@compiled
def _clip(x: float, limits: F64) -> float:
    return min(max(x, limits[0]), limits[1])


@compiled
def _limited_thigh(root: F64, upper: Mat, thigh: Vec, leg: _Leg) -> Mat:
    """The rotation of a thigh within the range of the hip joint; ``thigh`` is its direction at rest."""
    relative = mat_mul(transposed(root), upper)
    way = mat_vec(relative, thigh)
    # The twist is the rotation of an axis across the thigh that remains after the shortest rotation.
    side = unit(sub((1.0, 0.0, 0.0), scaled(thigh[0], thigh)))
    turned, swung = mat_vec(relative, side), mat_vec(_shortest_rotation(thigh, way), side)
    forward, right = math.atan2(way[1], -way[2]), math.asin(min(max(way[0], -1.0), 1.0))
    twist = -math.atan2(dot(cross(swung, turned), way), dot(swung, turned))
    limits, sign = HIP_LIMITS, leg.sign
    new_forward, new_right = _clip(forward, limits[0]), sign * _clip(sign * right, limits[1])
    new_twist = sign * _clip(sign * twist, limits[2])
    if max(abs(new_forward - forward), abs(new_right - right), abs(new_twist - twist)) <= 1e-9:
        return upper
    level = math.cos(new_right)
    way = (math.sin(new_right), level * math.sin(new_forward), -level * math.cos(new_forward))
    return mat_mul(root, mat_mul(rotation_about(way, -new_twist), _shortest_rotation(thigh, way)))


@compiled
def _limited_sole(shank: Mat, wanted: Mat, leg: _Leg) -> Mat:
    up, tilt, outward, sign = ANKLE_LIMITS[0], ANKLE_LIMITS[1], ANKLE_LIMITS[2], leg.sign
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
def _solve_leg(joint: F64, root: F64, sole: Mat, target: Vec, leg: _Leg) -> tuple[Mat, Mat, Vec, Vec]:
    """Thigh, shank, knee and ankle of a leg that reaches for a target with its ankle: inverse kinematics of two bones."""
    thigh, shank = leg.thigh, leg.shank
    down = sub(target, joint)
    length = math.sqrt(dot(down, down))
    reach = min(max(length, _FOLDED * (thigh + shank)), _STRETCH * (thigh + shank))
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
def _solve(joint: F64, root: F64, ball: F64, yaw: F64, pitch: F64, leg: _Leg, rotation: F64, position: F64) -> None:
    """Bones ``[4, F, 3, 3]`` and ``[4, F, 3]`` of one leg of :func:`legs`, from the hip joint ``[F, 3]`` on, written."""
    heel = (0.0, -leg.rest[2, 1], -leg.rest[2, 2])
    for f in range(len(joint)):
        floor = from_yaw_pitch_roll(yaw[f], pitch[f], 0.0)
        sole, raised = floor, 0.0
        for step in range(_ROUNDS + _LIFTS):
            target = add(_ankle(ball[f], sole, heel, leg.toe_height), (0.0, 0.0, raised))
            thigh, shank, knee, ankle = _solve_leg(joint[f], root[f], floor, target, leg)
            limited = _limited_sole(shank, floor, leg)
            change = 0.0
            for i in range(3):
                for j in range(3):
                    change = max(change, abs(limited[i][j] - sole[i][j]))
            sole = limited
            toe = add(ankle, mat_vec(sole, leg.rest[2]))
            # Where the ankle does not let the sole follow the floor, the leg is solved again; where the hip presses the toes
            # under the floor, it is drawn up.
            if change <= (1e-4 if step else 1e-6) or step >= _ROUNDS - 1:
                under = leg.toe_height - toe[2]
                if under <= _UNDER:
                    break
                raised += 1.5 * under
        bend = _clip(-math.asin(min(max(sole[2][1], -1.0), 1.0)), TOE_LIMITS)
        toes = mat_mul(sole, from_yaw_pitch_roll(0.0, -bend, 0.0))
        places = (add(joint[f], (0.0, 0.0, 0.0)), knee, ankle, toe)
        turns = (thigh, shank, sole, toes)
        for k in range(4):
            put_mat(turns[k], rotation[k, f])
            put_vec(places[k], position[k, f])


def reach_of(skeleton: Skeleton, height: F64) -> F64:
    """``[F]`` largest horizontal distance of the ball of a foot from the hips at heights ``[F]`` of the hips [m]."""
    size = skeleton.scale
    upright = np.maximum(height - 0.17 * size, 0.2 * size)
    return np.sqrt(np.maximum((_STRETCH * sum(skeleton.leg)) ** 2 - upright**2, 0.04)) + 0.09 * size


def settle(skeleton: Skeleton, hips: F64, root: F64, feet: Feet) -> tuple[F64, Feet]:
    """Raise heels and lower the hips until every planted foot is within reach.

    Args:
        hips: ``[F, 3]`` position of the hips [m].
        root: ``[F, 3, 3]`` rotation of the hips.

    Returns:
        ``[F, 3]`` the hips, lowered where needed, and the feet.
    """
    limit, heel, above = _STRETCH * sum(skeleton.leg), _heel(skeleton), _toe_height(skeleton)
    yaw = feet.yaw.copy()
    heading = np.arctan2(root[:, 1, 1], root[:, 0, 1]) - np.pi / 2
    pitch = feet.pitch.copy()
    drop = np.zeros(len(hips))
    for foot, side in ((LEFT, "Left"), (RIGHT, "Right")):
        # A planted foot pivots on its ball when the hips turn beyond the range of the hip joint.
        toe_out = 0.25 if foot == LEFT else -0.25
        off = (yaw[foot] - heading - toe_out + np.pi) % (2 * np.pi) - np.pi
        yaw[foot] = heading + toe_out + np.clip(off, -_TURN, _TURN)
        joint = hips + apply(root, skeleton.at(f"{side}UpLeg") - skeleton.at("Hips"))
        needed = _raised(joint, feet.ball[foot], yaw[foot], heel, above, limit) * feet.planted[foot]
        pitch[foot] = np.where(feet.planted[foot], smooth(widen(needed, 3), 3), pitch[foot])
        ankle = _ankles(feet.ball[foot], yaw[foot], pitch[foot], heel, above)
        flat = np.minimum(np.hypot(*(ankle - joint)[:, :2].T), 0.97 * limit)
        height = ankle[:, 2] + np.sqrt(limit**2 - flat**2)
        drop = np.where(feet.planted[foot], np.maximum(drop, joint[:, 2] - height), drop)
    # The maximum filter is as wide as the mean, so that the drop is nowhere too small.
    drop = smooth(widen(drop, _DROP), _DROP)
    lowered = hips.copy()
    lowered[:, 2] -= drop
    return lowered, feet._replace(yaw=yaw, pitch=pitch)


def legs(skeleton: Skeleton, hips: F64, root: F64, feet: Feet) -> tuple[F64, F64]:
    """Bones of both legs; knees bend forward over the toes.

    The sole follows the floor as far as the ankle allows; beyond that it tilts or rises about the ball.

    Returns:
        ``[2, 4, F, 3, 3]`` rotations of UpLeg, Leg, Foot, ToeBase, left and right, and ``[2, 4, F, 3]`` where they begin [m].
    """
    rotation, position = np.empty((2, 4, len(hips), 3, 3)), np.empty((2, 4, len(hips), 3))
    for foot, side in ((LEFT, "Left"), (RIGHT, "Right")):
        joint = hips + apply(root, skeleton.at(f"{side}UpLeg") - skeleton.at("Hips"))
        ball, yaw, pitch = feet.ball[foot], feet.yaw[foot], feet.pitch[foot]
        _solve(joint, root, ball, yaw, pitch, _leg_of(skeleton, side), rotation[foot], position[foot])
    return rotation, position


def strays(skeleton: Skeleton, hips: F64, root: F64, feet: Feet) -> F64:
    """``[2, F]`` distance of the ball of each foot from its place on the floor, because of the limits of the leg [m]."""
    rotation, position = legs(skeleton, hips, root, feet)
    ball = position[:, 2] - apply(rotation[:, 2], _heel(skeleton))
    return np.asarray(np.linalg.norm((ball - feet.ball)[..., :2], axis=-1))


def _toe_height(skeleton: Skeleton) -> float:
    """Height of the joint of the toes above the floor, the pivot of the heel [m]."""
    return float(skeleton.at("RightToeBase")[2])


def _heel(skeleton: Skeleton) -> F64:
    """``[3]`` from the joint of the toes to the ankle, for a foot that points forward [m]."""
    heel = skeleton.at("RightFoot") - skeleton.at("RightToeBase")
    return heel * np.array([0.0, 1.0, 1.0])
