"""Legs: bones from hips and feet. Heels rise and hips sink so that the legs reach the planted feet."""

import dataclasses
import functools
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.staging.body_solver import FootPath, LegConstants, raise_heels, solve_legs, stand_ankles
from shuttle_marl.staging.curves import smooth, widen
from shuttle_marl.staging.feet import Feet
from shuttle_marl.staging.keys import LEFT, RIGHT
from shuttle_marl.staging.rotation import apply, frame
from shuttle_marl.staging.skeleton import Skeleton

KNEE_LIMITS: Final = tuple(np.radians((2.0, 150.0)))
"""Limits of the bend of the knee [rad]."""
HIP_LIMITS: Final = np.radians([(-45, 130), (-45, 65), (-65, 65)])
"""``[3, 2]`` thigh forward, outward, turned outward against the hips [rad]."""
ANKLE_LIMITS: Final = np.radians([(-55, 38), (-45, 45), (-50, 50)])
"""``[3, 2]`` toes up, foot tilted, foot turned against the shank [rad] (with the joints of the hindfoot)."""
TOE_LIMITS: Final = np.radians((-25.0, 70.0))
"""Toes bent up against the foot [rad]."""
_ROUNDS: Final = 4
_DROP: Final = 8
"""Half width of the window over which the hips sink towards a distant foot [frames]."""
_STRETCH: Final = 0.985
"""Used fraction of the length of a leg: knees never lock."""
_HEEL: Final = np.radians(62)
_TURN: Final = np.radians(48)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Legs:
    """Bones of both legs over F frames; axis 0 is left, right.

    Attributes:
        rotation: ``[2, 4, F, 3, 3]`` of UpLeg, Leg, Foot, ToeBase.
        position: ``[2, 4, F, 3]`` where they begin [m].
    """

    rotation: F64
    position: F64


def reach_of(skeleton: Skeleton, height: F64) -> F64:
    """``[F]`` largest horizontal distance of the ball of a foot from the hips at heights ``[F]`` of the hips [m]."""
    size = skeleton.scale
    upright = np.maximum(height - 0.17 * size, 0.2 * size)
    return np.sqrt(np.maximum((_STRETCH * sum(skeleton.leg)) ** 2 - upright**2, 0.04)) + 0.09 * size


def settle(skeleton: Skeleton, hips: F64, root: F64, feet: Feet) -> tuple[F64, Feet]:
    """Raise heels and lower the hips until every planted foot is within reach.

    Args:
        skeleton: the athlete.
        hips: ``[F, 3]`` position of the hips [m].
        root: ``[F, 3, 3]`` rotation of the hips.
        feet: the feet, the heels of planted ones down.

    Returns:
        ``[F, 3]`` the hips, lowered where needed, and the feet.
    """
    limit, heel, above = _STRETCH * sum(skeleton.leg), _heel(skeleton), _toe_height(skeleton)
    needed, ankle = np.empty(len(hips)), np.empty((len(hips), 3))
    yaw = feet.yaw.copy()
    heading = np.arctan2(root[:, 1, 1], root[:, 0, 1]) - np.pi / 2
    pitch = feet.pitch.copy()
    drop = np.zeros(len(hips))
    angles = np.linspace(0, _HEEL, 9)
    for foot, side in ((LEFT, "Left"), (RIGHT, "Right")):
        # A planted foot pivots on its ball when the hips turn beyond the range of the hip joint.
        toe_out = 0.25 if foot == LEFT else -0.25
        off = (yaw[foot] - heading - toe_out + np.pi) % (2 * np.pi) - np.pi
        yaw[foot] = heading + toe_out + np.clip(off, -_TURN, _TURN)
        joint = hips + apply(root, skeleton.at(f"{side}UpLeg") - skeleton.at("Hips"))
        raise_heels(joint, feet.ball[foot], yaw[foot], heel, above, limit, angles, needed)
        needed *= feet.planted[foot]
        pitch[foot] = np.where(feet.planted[foot], smooth(widen(needed, 3), 3), pitch[foot])
        stand_ankles(feet.ball[foot], yaw[foot], pitch[foot], heel, above, ankle)
        flat = np.minimum(np.hypot(*(ankle - joint)[:, :2].T), 0.97 * limit)
        height = ankle[:, 2] + np.sqrt(limit**2 - flat**2)
        drop = np.where(feet.planted[foot], np.maximum(drop, joint[:, 2] - height), drop)
    # The maximum filter is as wide as the mean, so that the drop is nowhere too small.
    drop = smooth(widen(drop, _DROP), _DROP)
    lowered = hips.copy()
    lowered[:, 2] -= drop
    return lowered, dataclasses.replace(feet, yaw=yaw, pitch=pitch)


def legs(skeleton: Skeleton, hips: F64, root: F64, feet: Feet) -> Legs:
    """Bones of both legs; knees bend forward over the toes.

    The sole follows the floor as far as the ankle allows; beyond that it tilts or rises about the ball.
    """
    rotation, position = np.empty((2, 4, len(hips), 3, 3)), np.empty((2, 4, len(hips), 3))
    for foot, side in ((LEFT, "Left"), (RIGHT, "Right")):
        joint = hips + apply(root, skeleton.at(f"{side}UpLeg") - skeleton.at("Hips"))
        path = FootPath(feet.ball[foot], feet.yaw[foot], feet.pitch[foot])
        solve_legs(joint, root, path, _leg_constants(skeleton, side), _ROUNDS, rotation[foot], position[foot])
    return Legs(rotation=rotation, position=position)


def strays(skeleton: Skeleton, hips: F64, root: F64, feet: Feet) -> F64:
    """``[2, F]`` distance of the ball of each foot from its place on the floor, because of the limits of the leg [m]."""
    solved = legs(skeleton, hips, root, feet)
    ball = solved.position[:, 2] - apply(solved.rotation[:, 2], _heel(skeleton))
    return np.asarray(np.linalg.norm((ball - feet.ball)[..., :2], axis=-1))


@functools.cache
def _leg_constants(skeleton: Skeleton, side: str) -> LegConstants:
    rest = np.diff([skeleton.at(f"{side}{bone}") for bone in ("UpLeg", "Leg", "Foot", "ToeBase")], axis=0)
    thigh, shank = skeleton.leg
    return LegConstants(
        rest=rest,
        aligned=frame(rest[:2], np.array([1.0, 0.0, 0.0])),
        thigh=thigh,
        shank=shank,
        longest=_STRETCH * (thigh + shank),
        toe_height=_toe_height(skeleton),
        sign=1.0 if side == "Right" else -1.0,
        hip_limits=HIP_LIMITS,
        ankle_limits=ANKLE_LIMITS,
        toe_limits=TOE_LIMITS,
    )


def _toe_height(skeleton: Skeleton) -> float:
    """Height of the joint of the toes above the floor, the pivot of the heel [m]."""
    return float(skeleton.at("RightToeBase")[2])


def _heel(skeleton: Skeleton) -> F64:
    """``[3]`` from the joint of the toes to the ankle, for a foot that points forward [m]."""
    heel = skeleton.at("RightFoot") - skeleton.at("RightToeBase")
    return heel * np.array([0.0, 1.0, 1.0])
