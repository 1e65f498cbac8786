"""Joint angles read back from the bones of a motion, and the limits they must keep.

The reading does not use the angles from which the motion was made: it takes apart the rotation of each bone against its
parent, so that it also judges motions that come from elsewhere.
"""

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.staging.arm import (
    ANGLES,
    BEND,
    DEVIATION,
    ELBOW,
    FORWARD,
    LIMITS,
    MIDDLE,
    PRONATION,
    RAISE,
    ROLL,
    SWING_1,
    SWING_LIMIT,
    TWIST,
    Arm,
    arm_of,
)
from shuttle_marl.staging.body import NECK_LIMITS
from shuttle_marl.staging.legs import ANKLE_LIMITS, HIP_LIMITS, KNEE_LIMITS, TOE_LIMITS, hip_angles
from shuttle_marl.staging.motion import Motion
from shuttle_marl.staging.rotation import cross, matrix, turned_bowed_leant, unit
from shuttle_marl.staging.skeleton import BONE, MIRROR, SPINE_LIMITS, Skeleton
from shuttle_marl.staging.timeline import own_frame

Floats = npt.NDArray[np.float64]

_FLIP: Final = np.diag([-1.0, 1.0, 1.0])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Joint:
    """One angle of one joint over F frames.

    Attributes:
        name: of the angle, racket side and free side rather than right and left.
        angle: ``[F]`` [rad].
        low: least angle allowed [rad].
        high: greatest angle allowed [rad].
    """

    name: str
    angle: Floats
    low: float
    high: float

    @property
    def excess(self) -> float:
        """Greatest angle beyond the limits [rad], negative if it keeps away from them."""
        return float(np.maximum(self.angle - self.high, self.low - self.angle).max())


def joints(motion: Motion, seat: int) -> list[Joint]:
    """All joint angles of a player."""
    skeleton = motion.skeletons[seat]
    rotation = as_right_hander(motion, seat)
    out: list[Joint] = []

    def add(name: str, angle: Floats, limits: Floats | tuple[float, ...]) -> None:
        out.append(Joint(name=name, angle=angle, low=float(limits[0]), high=float(limits[1])))

    def between(parent: str, child: str) -> Floats:
        return rotation[:, BONE[parent]].transpose(0, 2, 1) @ rotation[:, BONE[child]]

    for below, above in (("Hips", "Spine"), ("Spine", "Spine1"), ("Spine1", "Spine2")):
        for k, (name, angle) in enumerate(zip(("turn", "bow", "lean"), turned_bowed_leant(between(below, above)), strict=True)):
            add(f"{above} {name}", angle, SPINE_LIMITS[k] / 3)
    neck, head = turned_bowed_leant(between("Spine2", "Neck")), turned_bowed_leant(between("Neck", "Head"))
    for k, name in enumerate(("turn", "bow")):
        add(f"head {name}", neck[k] + head[k], NECK_LIMITS[k])
    arm = arm_of(skeleton)
    for side, turn in (("racket", np.eye(3)), ("free", _FLIP)):
        letter = "Right" if side == "racket" else "Left"
        chain = [turn @ rotation[:, BONE[f"{letter}{b}"]] @ turn for b in ("Shoulder", "Arm", "ForeArm", "Hand")]
        chest = turn @ rotation[:, BONE["Spine2"]] @ turn
        angles = arm_angles(arm, chest, chain, rotation[:, BONE["Racket"]] if side == "racket" else None)
        for k, name in enumerate(ANGLES):
            if k == SWING_1:
                add(f"{side} shoulder swing", np.linalg.norm(angles[:, k : k + 2], axis=1), (-1.0, SWING_LIMIT))
            elif k != SWING_1 + 1 and not (k == ROLL and side == "free"):
                add(f"{side} {name}", angles[:, k], LIMITS[k])
    for side, turn in (("right", np.eye(3)), ("left", _FLIP)):
        names = [f"{side.capitalize()}{b}" for b in ("UpLeg", "Leg", "Foot", "ToeBase")]
        leg = leg_angles(skeleton, *(turn @ rotation[:, BONE[b]] @ turn for b in ("Hips", *names)))
        limits = (*HIP_LIMITS, KNEE_LIMITS, *ANKLE_LIMITS, TOE_LIMITS)
        for (name, angle), limit in zip(leg.items(), limits, strict=True):
            add(f"{side} {name}", angle, limit)
    return out


def as_right_hander(motion: Motion, seat: int) -> Floats:
    """``[F, 23, 3, 3]`` rotations of a player in their own frame, a left-hander's mirrored."""
    right = motion.handedness[seat] == "right"
    sign = own_frame(seat, right)
    rotation = np.diag([sign[1], sign[1], 1.0]) @ matrix(motion.rotation[:, seat])
    return rotation if right else _FLIP @ rotation[:, MIRROR] @ _FLIP


def arm_angles(arm: Arm, chest: Floats, chain: list[Floats], racket: Floats | None) -> Floats:
    """``[F, 10]`` angles of an arm from the rotations of chest, collar bone, upper arm, forearm, hand, and racket."""
    collar, upper, fore, hand = chain
    out = np.zeros((len(chest), len(ANGLES)))
    m = _inverse(chest) @ collar
    out[:, RAISE], out[:, FORWARD] = np.arcsin(np.clip(m[:, 2, 0], -1, 1)), np.arctan2(m[:, 1, 0], m[:, 0, 0])
    m = _inverse(collar) @ upper @ arm.to_middle.T
    way = m @ MIDDLE
    angle = np.arccos(np.clip(way @ MIDDLE, -1, 1))
    axis = unit(cross(np.broadcast_to(MIDDLE, way.shape), way))
    out[:, SWING_1 : SWING_1 + 2] = (angle[:, None] * axis) @ arm.swing.T
    probe = arm.swing[0]
    swung = _about(axis, angle, np.broadcast_to(probe, way.shape))
    out[:, TWIST] = _signed(swung, m @ probe, way)
    m = _inverse(upper) @ fore
    bent = m @ arm.lower
    hinge = np.broadcast_to(arm.hinge, bent.shape)
    out[:, ELBOW] = _signed(np.broadcast_to(arm.lower, bent.shape), bent, hinge) + arm.rest_bend
    swung = _about(hinge, out[:, ELBOW] - arm.rest_bend, np.broadcast_to(arm.hinge, bent.shape))
    half = -_signed(swung, m @ arm.hinge, bent)
    out[:, PRONATION] = 2 * half
    along = np.broadcast_to(arm.lower, bent.shape)
    m = _inverse(fore) @ hand
    palm = _about(along, half, m @ arm.palm)
    out[:, BEND] = _signed(np.broadcast_to(arm.palm, palm.shape), palm, np.broadcast_to(arm.across, palm.shape))
    across = _about(along, half, m @ arm.across)
    out[:, DEVIATION] = _signed(np.broadcast_to(arm.across, across.shape), across, palm)
    if racket is not None:
        m = _inverse(hand) @ racket
        out[:, ROLL] = _signed(np.broadcast_to(arm.normal, across.shape), m @ arm.normal, np.broadcast_to(arm.axis, across.shape))
    return out


def leg_angles(skeleton: Skeleton, hips: Floats, upper: Floats, lower: Floats, foot: Floats, toe: Floats) -> dict[str, Floats]:
    """Angles of a right leg by name, from the rotations of hips, thigh, shank, foot and toes."""
    joint, knee, ankle = (skeleton.at(f"Right{b}") for b in ("UpLeg", "Leg", "Foot"))
    thigh, shank = unit(knee - joint), unit(ankle - knee)
    hip = hip_angles(_inverse(hips) @ upper, thigh)
    hinge = unit(cross(thigh, np.array([0.0, 1.0, 0.0])))
    m = _inverse(upper) @ lower
    straight = _signed(shank[None], thigh[None], hinge[None])[0]
    bend = -_signed(np.broadcast_to(shank, hip.shape), m @ shank, np.broadcast_to(hinge, hip.shape)) + straight
    turn, bow, lean = turned_bowed_leant(_inverse(lower) @ foot)
    _, toes, _ = turned_bowed_leant(_inverse(foot) @ toe)
    return {
        "hip flexion": hip[:, 0],
        "hip abduction": hip[:, 1],
        "hip rotation": hip[:, 2],
        "knee bend": bend,
        "ankle up": -bow,
        "ankle tilt": lean,
        "ankle turn": turn,
        "toes up": -toes,
    }


def _inverse(m: Floats) -> Floats:
    return np.swapaxes(m, -1, -2)


def _signed(a: Floats, b: Floats, axis: Floats) -> Floats:
    """Angle that turns ``a`` into ``b`` about a unit ``axis``, positive by the right hand."""
    angle: Floats = np.arctan2(
        (cross(a, b) * axis).sum(axis=-1), (a * b).sum(axis=-1) - (a * axis).sum(axis=-1) * (b * axis).sum(axis=-1)
    )
    return angle


def _about(axis: Floats, angle: Floats, v: Floats) -> Floats:
    """Vectors turned about unit axes, each ``[F, 3]``, by ``[F]`` angles."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out: Floats = c * v + s * cross(axis, v) + (1 - c) * (axis * v).sum(axis=1, keepdims=True) * axis
    return out
