"""The legs: from hips and feet to bones. Heels rise and hips sink as far as the legs need to reach the planted feet."""

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.staging.feet import LEFT, RIGHT, Feet
from shuttle_marl.staging.rotation import (
    about,
    apply,
    cross,
    exponential,
    frame,
    turned,
    turned_bowed_leant,
    unit,
    yaw_pitch_roll,
)
from shuttle_marl.staging.skeleton import Skeleton

Floats = npt.NDArray[np.float64]

KNEE_LIMITS: Final = tuple(np.radians((2.0, 150.0)))
"""Least and greatest bend of the knee [rad]."""
HIP_LIMITS: Final = np.radians([(-45, 130), (-45, 65), (-65, 65)])
"""``[3, 2]`` thigh forward, outward, turned outward against the hips [rad]."""
ANKLE_LIMITS: Final = np.radians([(-55, 38), (-45, 45), (-50, 50)])
"""``[3, 2]`` toes up, foot tilted, foot turned against the shank [rad] (with the joints of the hindfoot)."""
TOE_LIMITS: Final = tuple(np.radians((-25.0, 70.0)))
"""Toes bent up against the foot [rad]."""
_ROUNDS: Final = 4
_DROP: Final = 8
"""Frames over which the hips sink towards a foot that is far away."""
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


def reach_of(skeleton: Skeleton, height: Floats) -> Floats:
    """``[F]`` how far from the hips the ball of a foot can stand, for heights of the hips, without pulling them down [m]."""
    size = skeleton.scale
    upright = np.maximum(height - 0.17 * size, 0.2 * size)
    return np.sqrt(np.maximum((_STRETCH * sum(skeleton.leg)) ** 2 - upright**2, 0.04)) + 0.09 * size


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
        pitch[foot] = np.where(feet.planted[foot], smooth(_widen(needed, 3), 3), pitch[foot])
        ankle = _ankle(skeleton, feet.ball[foot], yaw[foot], pitch[foot])
        flat = np.minimum(np.hypot(*(ankle - joint)[:, :2].T), 0.97 * limit)
        height = ankle[:, 2] + np.sqrt(limit**2 - flat**2)
        drop = np.where(feet.planted[foot], np.maximum(drop, joint[:, 2] - height), drop)
    # As wide as the mean is, so that it is nowhere less than needed.
    drop = smooth(_widen(drop, _DROP), _DROP)
    lowered = hips.copy()
    lowered[:, 2] -= drop
    return lowered, dataclasses.replace(feet, yaw=yaw, pitch=pitch)


def legs(skeleton: Skeleton, hips: Floats, root: Floats, feet: Feet) -> Legs:
    """Bones of both legs; knees bend forwards, over the toes.

    The sole follows the floor as far as the ankle allows; beyond that it tilts or rises about the ball, which stays.
    """
    rotation, position = np.empty((2, 4, len(hips), 3, 3)), np.empty((2, 4, len(hips), 3))
    for foot, side in ((LEFT, "Left"), (RIGHT, "Right")):
        joint = hips + apply(root, skeleton.at(f"{side}UpLeg") - skeleton.at("Hips"))
        sole = turned(feet.yaw[foot]) @ about(np.array([-1.0, 0.0, 0.0]), feet.pitch[foot])
        wanted, heel = sole, _arm(skeleton)
        toes = feet.ball[foot] + _above(skeleton)
        upper, lower, knee, ankle = _limb(skeleton, side, joint, toes + apply(sole, heel), root, wanted)
        sole = _within(lower, wanted, side)
        # Where the ankle does not let the sole follow the floor, the leg is solved again.
        rows = np.flatnonzero(np.abs(sole - wanted).max(axis=(1, 2)) > 1e-6)
        for _ in range(_ROUNDS - 1 if len(rows) else 0):
            found = _limb(skeleton, side, joint[rows], toes[rows] + apply(sole[rows], heel), root[rows], wanted[rows])
            upper[rows], lower[rows], knee[rows], ankle[rows] = found
            now = _within(lower[rows], wanted[rows], side)
            far = np.abs(now - sole[rows]).max(axis=(1, 2)) > 1e-4
            sole[rows] = now
            rows = rows[far]
            if not len(rows):
                break
        toe_bend = np.clip(_pitch(sole), *TOE_LIMITS)
        rest = [skeleton.at(f"{side}{b}") for b in ("Foot", "ToeBase")]
        rotation[foot] = np.stack([upper, lower, sole, sole @ about(np.array([1.0, 0.0, 0.0]), toe_bend)])
        position[foot] = np.stack([joint, knee, ankle, ankle + apply(sole, rest[1] - rest[0])])
    return Legs(rotation=rotation, position=position)


def _limb(
    skeleton: Skeleton, side: str, joint: Floats, ankle: Floats, root: Floats, sole: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Rotations of thigh and shank, knee and ankle, of a leg from the hip joint to (if it is long enough) the ankle."""
    thigh, shank = skeleton.leg
    way = ankle - joint
    length = np.linalg.norm(way, axis=1)
    reach = np.clip(length, 0.45 * (thigh + shank), _STRETCH * (thigh + shank))
    down = way / length[:, None]
    # Knees point between where the hips and where the toes point.
    toes = sole[..., 1] * np.array([1.0, 1.0, 0.0])
    out = apply(root, np.array([-0.10 if side == "Left" else 0.10, 0.0, 0.0]))
    bend = frame(down, 0.8 * unit(toes) + root[..., 1] + out)[..., 1]
    along = (thigh**2 - shank**2 + reach**2) / (2 * reach)
    knee = joint + along[:, None] * down + np.sqrt(np.maximum(thigh**2 - along**2, 0))[:, None] * bend
    ankle = joint + reach[:, None] * down
    hinge = cross(down, bend)
    rest = [skeleton.at(f"{side}{b}") for b in ("UpLeg", "Leg", "Foot")]
    upper, lower = _aligned(rest[1] - rest[0], knee - joint, hinge), _aligned(rest[2] - rest[1], ankle - knee, hinge)
    held = _hip_within(root, upper, rest[1] - rest[0], side)
    lower = held @ upper.transpose(0, 2, 1) @ lower
    knee = joint + apply(held, rest[1] - rest[0])
    return held, lower, knee, knee + apply(lower, rest[2] - rest[1])


def hip_angles(relative: Floats, thigh: Floats) -> Floats:
    """``[F, 3]`` thigh forward, to the right, turned left, from its rotation against the hips and its direction at rest."""
    way = relative @ thigh
    swing = _shortest(thigh, way)
    side = unit(np.array([1.0, 0.0, 0.0]) - thigh[0] * thigh)
    turned_side = relative @ side
    cosine = (swing @ side * turned_side).sum(axis=1)
    sine = (cross(swing @ side, turned_side) * way).sum(axis=1)
    return np.stack([np.arctan2(way[:, 1], -way[:, 2]), np.arcsin(np.clip(way[:, 0], -1, 1)), -np.arctan2(sine, cosine)], axis=1)


def _hip_within(root: Floats, upper: Floats, rest: Floats, side: str) -> Floats:
    """Thighs turned into the range of the hip."""
    thigh = unit(rest)
    relative = root.transpose(0, 2, 1) @ upper
    angles = hip_angles(relative, thigh)
    sign = np.array([1.0, 1.0, 1.0] if side == "Right" else [1.0, -1.0, -1.0])
    kept = sign * np.clip(sign * angles, HIP_LIMITS[:, 0], HIP_LIMITS[:, 1])
    bad = np.flatnonzero((np.abs(kept - angles) > 1e-9).any(axis=1))
    if not len(bad):
        return upper
    forward, right, turn = kept[bad].T
    way = np.stack([np.sin(right), np.cos(right) * np.sin(forward), -np.cos(right) * np.cos(forward)], axis=1)
    out = upper.copy()
    out[bad] = root[bad] @ exponential(-turn[:, None] * way) @ _shortest(thigh, way)
    return out


def _shortest(a: Floats, b: Floats) -> Floats:
    """``[F, 3, 3]`` the shortest rotation of ``a`` onto each ``b``."""
    axis = cross(np.broadcast_to(a, b.shape), b)
    angle = np.arctan2(np.linalg.norm(axis, axis=1), b @ a)
    return exponential(unit(axis) * angle[:, None])


def _within(shank: Floats, sole: Floats, side: str) -> Floats:
    """Soles turned into the range of the ankle."""
    up, tilt, out = ANKLE_LIMITS
    # Rising about the ball comes first: far outside the range the three angles would not be independent.
    axis = -(sole.transpose(0, 2, 1) @ shank)[..., 2]
    bent = np.arctan2(-axis[:, 1], -axis[:, 2])
    sole = sole @ about(np.array([-1.0, 0.0, 0.0]), bent - np.clip(bent, *up))
    turn, bow, lean = turned_bowed_leant(shank.transpose(0, 2, 1) @ sole)
    sign = 1.0 if side == "Right" else -1.0
    return shank @ yaw_pitch_roll(sign * np.clip(sign * turn, *out), -np.clip(-bow, *up), sign * np.clip(sign * lean, *tilt))


def _pitch(sole: Floats) -> Floats:
    """Angle by which a sole points down [rad]."""
    return -np.arcsin(np.clip(sole[..., 2, 1], -1, 1))


def _above(skeleton: Skeleton) -> Floats:
    """From the point under the ball to the joint of the toes, about which heels turn."""
    return np.array([0.0, 0.0, skeleton.at("RightToeBase")[2]])


def _arm(skeleton: Skeleton) -> Floats:
    """From the joint of the toes to the ankle, of a foot that points forward."""
    arm = skeleton.at("RightFoot") - skeleton.at("RightToeBase")
    return arm * np.array([0.0, 1.0, 1.0])


def _ankle(skeleton: Skeleton, ball: Floats, yaw: Floats, pitch: Floats) -> Floats:
    """``[F, 3]`` the ankle of a foot that stands on its ball, the heel raised by ``pitch``."""
    return ball + _above(skeleton) + apply(turned(yaw) @ about(np.array([-1.0, 0.0, 0.0]), pitch), _arm(skeleton))


def _aligned(rest: Floats, way: Floats, hinge: Floats) -> Floats:
    """``[F, 3, 3]`` turns the bone at rest along ``way``, with the knee's hinge (to the right at rest) along ``hinge``."""
    return frame(way, hinge) @ frame(rest, np.array([1.0, 0.0, 0.0])).T


def _widen(x: Floats, by: int) -> Floats:
    """The greatest value within ``by`` frames."""
    padded = np.pad(x, by, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * by + 1).max(axis=1)


def smooth(x: Floats, by: int) -> Floats:
    """The mean of ``[F]`` numbers within ``by`` frames, near ones weighing more (a Hann window)."""
    kernel = np.hanning(2 * by + 3)[1:-1]
    padded = np.pad(x, by, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * by + 1) @ (kernel / kernel.sum())
