"""The legs: from hips and feet to bones. Heels rise and hips sink as far as the legs need to reach the planted feet."""

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.staging.feet import LEFT, RIGHT, Feet
from shuttle_marl.staging.rotation import about, apply, frame, turned
from shuttle_marl.staging.skeleton import Skeleton

Floats = npt.NDArray[np.float64]

KNEE_LIMITS: Final = tuple(np.radians((2.0, 150.0)))
"""Least and greatest bend of the knee [rad]."""
HIP_SWING_LIMIT: Final = np.radians(115)
"""Greatest angle between the thigh and its middle direction, 35 degrees forward of straight down [rad]."""
HIP_TWIST_LIMIT: Final = np.radians(60)
"""Greatest turn of the thigh about itself, either way [rad]."""
ANKLE_LIMITS: Final = np.radians([(-55, 38), (-45, 45), (-50, 50)])
"""``[3, 2]`` toes up, foot tilted, foot turned against the shank [rad] (with the joints of the hindfoot)."""
TOE_LIMITS: Final = tuple(np.radians((-25.0, 70.0)))
"""Toes bent up against the foot [rad]."""
_STRETCH: Final = 0.985
"""Share of the length of a leg that is used: knees never lock."""
_HEEL: Final = np.radians(62)
_TURN: Final = np.radians(48)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Legs:
    """Bones of both legs over F frames; axis 0 is left, right.

    Attributes:
        rotation: ``[2, 4, F, 3, 3]`` of UpLeg, Leg, Foot, ToeBase.
        position: ``[2, 4, F, 3]`` where they begin [m].
    """

    rotation: Floats
    position: Floats


def foot_offset(skeleton: Skeleton) -> Floats:
    """``[3]`` from the point under the ball of the right foot to its ankle, the foot at rest, pointing forward [m]."""
    ball = skeleton.at("RightToeBase")
    return skeleton.at("RightFoot") - np.array([ball[0], ball[1], 0.0])


def settle(skeleton: Skeleton, hips: Floats, root: Floats, feet: Feet) -> tuple[Floats, Feet]:
    """Raise heels and lower the hips until every planted foot is within reach.

    Args:
        skeleton: the athlete.
        hips: ``[F, 3]`` where the hips are [m].
        root: ``[F, 3, 3]`` rotation of the hips.
        feet: the feet, the heels of planted ones down.

    Returns:
        ``[F, 3]`` the hips, lowered where needed, and the feet.
    """
    limit = _STRETCH * sum(skeleton.leg)
    yaw = feet.yaw.copy()
    heading = np.arctan2(root[:, 1, 1], root[:, 0, 1]) - np.pi / 2
    pitch = feet.pitch.copy()
    drop = np.zeros(len(hips))
    angles = np.linspace(0, _HEEL, 9)
    for foot, side in ((LEFT, "Left"), (RIGHT, "Right")):
        # A planted foot turns on its ball when the hips have turned too far for the hip joint.
        toe_out = 0.25 if foot == LEFT else -0.25
        off = (yaw[foot] - heading - toe_out + np.pi) % (2 * np.pi) - np.pi
        yaw[foot] = heading + toe_out + np.clip(off, -_TURN, _TURN)
        joint = hips + apply(root, skeleton.at(f"{side}UpLeg") - skeleton.at("Hips"))
        raised = np.stack([_ankle(skeleton, feet.ball[foot], yaw[foot], np.full(len(hips), a)) for a in angles])
        away = np.linalg.norm(raised - joint, axis=2)
        enough = away <= limit
        first = np.where(enough.any(axis=0), enough.argmax(axis=0), len(angles) - 1)
        needed = np.where(feet.planted[foot], angles[first], 0.0)
        pitch[foot] = np.where(feet.planted[foot], np.maximum(_smooth(_widen(needed, 2), 3), needed), pitch[foot])
        ankle = _ankle(skeleton, feet.ball[foot], yaw[foot], pitch[foot])
        flat = np.minimum(np.hypot(*(ankle - joint)[:, :2].T), 0.97 * limit)
        height = ankle[:, 2] + np.sqrt(limit**2 - flat**2)
        drop = np.where(feet.planted[foot], np.maximum(drop, joint[:, 2] - height), drop)
    drop = np.maximum(_smooth(_widen(drop, 3), 4), drop)
    lowered = hips.copy()
    lowered[:, 2] -= drop
    return lowered, dataclasses.replace(feet, yaw=yaw, pitch=pitch)


def legs(skeleton: Skeleton, hips: Floats, root: Floats, feet: Feet) -> Legs:
    """Bones of both legs; knees bend forwards, over the toes."""
    rotation, position = np.empty((2, 4, len(hips), 3, 3)), np.empty((2, 4, len(hips), 3))
    thigh, shank = skeleton.leg
    for foot, side in ((LEFT, "Left"), (RIGHT, "Right")):
        joint = hips + apply(root, skeleton.at(f"{side}UpLeg") - skeleton.at("Hips"))
        ankle = _ankle(skeleton, feet.ball[foot], feet.yaw[foot], feet.pitch[foot])
        way = ankle - joint
        length = np.linalg.norm(way, axis=1)
        reach = np.clip(length, 0.45 * (thigh + shank), _STRETCH * (thigh + shank))
        down = way / length[:, None]
        ankle = joint + reach[:, None] * down
        toes = turned(feet.yaw[foot]) @ np.array([0.0, 1.0, 0.0])
        forward = apply(root, np.array([0.0, 1.0, 0.0]))
        out = apply(root, np.array([-0.12 if foot == LEFT else 0.12, 0.0, 0.0]))
        bend = frame(down, toes + forward + out)[..., :, 1]
        along = (thigh**2 - shank**2 + reach**2) / (2 * reach)
        knee = joint + along[:, None] * down + np.sqrt(np.maximum(thigh**2 - along**2, 0))[:, None] * bend
        rest = [skeleton.at(f"{side}{b}") for b in ("UpLeg", "Leg", "Foot", "ToeBase")]
        hinge = np.cross(down, bend)
        upper = _aligned(rest[1] - rest[0], knee - joint, hinge)
        lower = _aligned(rest[2] - rest[1], ankle - knee, hinge)
        sole = turned(feet.yaw[foot]) @ about(np.array([-1.0, 0.0, 0.0]), feet.pitch[foot])
        toe = sole @ about(np.array([1.0, 0.0, 0.0]), np.clip(feet.pitch[foot], *TOE_LIMITS))
        rotation[foot] = np.stack([upper, lower, sole, toe])
        position[foot] = np.stack([joint, knee, ankle, ankle + apply(sole, rest[3] - rest[2])])
    return Legs(rotation=rotation, position=position)


def _ankle(skeleton: Skeleton, ball: Floats, yaw: Floats, pitch: Floats) -> Floats:
    """``[F, 3]`` the ankle of a foot that stands on its ball, the heel raised by ``pitch``."""
    # Heels turn about the joint of the toes, which lies a little above the floor.
    joint = np.array([0.0, 0.0, skeleton.at("RightToeBase")[2]])
    arm = foot_offset(skeleton) - joint
    arm[0] = 0.0
    return ball + joint + apply(turned(yaw) @ about(np.array([-1.0, 0.0, 0.0]), pitch), arm)


def _aligned(rest: Floats, way: Floats, hinge: Floats) -> Floats:
    """``[F, 3, 3]`` turns the bone at rest along ``way``, with the knee's hinge (to the right at rest) along ``hinge``."""
    return frame(way, hinge) @ frame(rest, np.array([1.0, 0.0, 0.0])).T


def _widen(x: Floats, by: int) -> Floats:
    """The greatest value within ``by`` frames."""
    padded = np.pad(x, by, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * by + 1).max(axis=1)


def _smooth(x: Floats, by: int) -> Floats:
    """The mean within ``by`` frames."""
    padded = np.pad(x, by, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * by + 1).mean(axis=1)
