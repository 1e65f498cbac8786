"""Quality measures of staged rallies: contacts, feet, speeds, joint angles and flights.

Joint angles are computed from the rotation of each bone relative to its parent, independently of the angles of the staging.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.court.staging.body import NECK_LIMITS
from shuttle_marl.court.staging.draw import load_measured
from shuttle_marl.court.staging.flight import net_height
from shuttle_marl.court.staging.geometry import cross, matrix, unit
from shuttle_marl.court.staging.limbs import (
    ANKLE_LIMITS,
    BEND,
    DEVIATION,
    ELBOW,
    FORWARD,
    HIP_LIMITS,
    KNEE_LIMITS,
    LIMITS,
    MIDDLE,
    PRONATION,
    RAISE,
    ROLL,
    SWING_1,
    SWING_LIMIT,
    TOE_LIMITS,
    TWIST,
    Arm,
    arm_of,
)
from shuttle_marl.court.staging.motion import Motion
from shuttle_marl.court.staging.poses import own_frame
from shuttle_marl.court.staging.skeleton import BONE, MIRROR, SPINE_LIMITS, Skeleton
from shuttle_marl.court.staging.trajectory import NET, OPEN, OUT, RETURN, WIN
from shuttle_marl.game.court import HALF_LENGTH, HALF_WIDTH, SHORT_SERVICE, area_of
from shuttle_marl.game.stroke import SHOTS

_FLIP: Final = np.diag([-1.0, 1.0, 1.0])
_FINE: float = 2000.0
"""Sampling rate of flights at the net [Hz]."""


_ROUNDING: float = 2e-6
"""Rounding error of angles from 32-bit rotations [rad]."""


def to_yaw_pitch_roll(m: F64) -> tuple[F64, F64, F64]:
    """Yaw, pitch and roll ``[...]`` [rad] of rotations ``[..., 3, 3]``, as of ``geometry.from_yaw_pitch_roll``."""
    return (
        np.arctan2(-m[..., 0, 1], m[..., 1, 1]),
        -np.arcsin(np.clip(m[..., 2, 1], -1, 1)),
        np.arctan2(-m[..., 2, 0], m[..., 2, 2]),
    )


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
    angle: F64
    low: float
    high: float

    @property
    def excess(self) -> float:
        """Greatest angle beyond the limits [rad], negative inside the limits."""
        return float(np.maximum(self.angle - self.high, self.low - self.angle).max())


def joints(motion: Motion, seat: int) -> list[Joint]:
    """All joint angles of a player."""
    skeleton = motion.skeletons[seat]
    rotation = as_right_hander(motion, seat)
    out: list[Joint] = []

    def add(name: str, angle: F64, limits: F64 | tuple[float, ...]) -> None:
        out.append(Joint(name=name, angle=angle, low=float(limits[0]), high=float(limits[1])))

    def between(parent: str, child: str) -> F64:
        return rotation[:, BONE[parent]].transpose(0, 2, 1) @ rotation[:, BONE[child]]

    for below, above in (("Hips", "Spine"), ("Spine", "Spine1"), ("Spine1", "Spine2")):
        for k, (name, angle) in enumerate(zip(("turn", "bow", "lean"), to_yaw_pitch_roll(between(below, above)), strict=True)):
            add(f"{above} {name}", angle, SPINE_LIMITS[k] / 3)
    neck, head = to_yaw_pitch_roll(between("Spine2", "Neck")), to_yaw_pitch_roll(between("Neck", "Head"))
    for k, name in enumerate(("turn", "bow")):
        add(f"head {name}", neck[k] + head[k], NECK_LIMITS[k])
    arm = arm_of(skeleton)
    for side, turn in (("racket", np.eye(3)), ("free", _FLIP)):
        letter = "Right" if side == "racket" else "Left"
        chain = [turn @ rotation[:, BONE[f"{letter}{b}"]] @ turn for b in ("Shoulder", "Arm", "ForeArm", "Hand")]
        chest = turn @ rotation[:, BONE["Spine2"]] @ turn
        angles = arm_angles(arm, chest, chain, rotation[:, BONE["Racket"]] if side == "racket" else None)
        for k in range(len(LIMITS)):
            if k == SWING_1:
                add(f"{side} shoulder swing", np.linalg.norm(angles[:, k : k + 2], axis=1), (-1.0, SWING_LIMIT))
            elif k != SWING_1 + 1 and not (k == ROLL and side == "free"):
                add(f"{side} angle {k}", angles[:, k], LIMITS[k])
    for side, turn in (("right", np.eye(3)), ("left", _FLIP)):
        names = [f"{side.capitalize()}{b}" for b in ("UpLeg", "Leg", "Foot", "ToeBase")]
        leg = leg_angles(skeleton, *(turn @ rotation[:, BONE[b]] @ turn for b in ("Hips", *names)))
        limits = (*HIP_LIMITS, KNEE_LIMITS, *ANKLE_LIMITS, TOE_LIMITS)
        for (name, angle), limit in zip(leg.items(), limits, strict=True):
            add(f"{side} {name}", angle, limit)
    return out


def as_right_hander(motion: Motion, seat: int) -> F64:
    """``[F, 23, 3, 3]`` rotations of a player in their own frame, a left-hander's mirrored."""
    right = motion.hands[seat] == "right"
    sign = own_frame(motion.trajectory.rally.facing(seat), right)
    rotation = np.diag([sign[1], sign[1], 1.0]) @ matrix(motion.rotation[:, seat])
    return rotation if right else _FLIP @ rotation[:, MIRROR] @ _FLIP


def arm_angles(arm: Arm, chest: F64, chain: list[F64], racket: F64 | None) -> F64:
    """``[F, 10]`` angles of an arm from the rotations of chest, collar bone, upper arm, forearm, hand, and racket."""
    collar, upper, fore, hand = chain
    out, lower = np.zeros((len(chest), len(LIMITS))), -arm.axes[PRONATION]
    m = _inverse(chest) @ collar
    out[:, RAISE], out[:, FORWARD] = np.arcsin(np.clip(m[:, 2, 0], -1, 1)), np.arctan2(m[:, 1, 0], m[:, 0, 0])
    m = _inverse(collar) @ upper @ arm.to_middle.T
    way = m @ MIDDLE
    angle = np.arccos(np.clip(way @ MIDDLE, -1, 1))
    axis = unit(cross(np.broadcast_to(MIDDLE, way.shape), way))
    out[:, SWING_1 : SWING_1 + 2] = (angle[:, None] * axis) @ arm.axes[SWING_1:TWIST].T
    probe = arm.axes[SWING_1:TWIST][0]
    swung = _about(axis, angle, np.broadcast_to(probe, way.shape))
    out[:, TWIST] = _signed(swung, m @ probe, way)
    m = _inverse(upper) @ fore
    bent = m @ lower
    hinge = np.broadcast_to(arm.axes[ELBOW], bent.shape)
    out[:, ELBOW] = _signed(np.broadcast_to(lower, bent.shape), bent, hinge) + arm.rest_bend
    swung = _about(hinge, out[:, ELBOW] - arm.rest_bend, np.broadcast_to(arm.axes[ELBOW], bent.shape))
    half = -_signed(swung, m @ arm.axes[ELBOW], bent)
    out[:, PRONATION] = 2 * half
    along = np.broadcast_to(lower, bent.shape)
    m = _inverse(fore) @ hand
    palm = _about(along, half, m @ arm.axes[DEVIATION])
    out[:, BEND] = _signed(np.broadcast_to(arm.axes[DEVIATION], palm.shape), palm, np.broadcast_to(arm.axes[BEND], palm.shape))
    across = _about(along, half, m @ arm.axes[BEND])
    out[:, DEVIATION] = _signed(np.broadcast_to(arm.axes[BEND], across.shape), across, palm)
    if racket is not None:
        m = _inverse(hand) @ racket
        out[:, ROLL] = _signed(np.broadcast_to(arm.normal, across.shape), m @ arm.normal, np.broadcast_to(arm.axis, across.shape))
    return out


def leg_angles(skeleton: Skeleton, hips: F64, upper: F64, lower: F64, foot: F64, toe: F64) -> dict[str, F64]:
    """Angles of a right leg by name, from the rotations of hips, thigh, shank, foot and toes."""
    joint, knee, ankle = (skeleton.at(f"Right{b}") for b in ("UpLeg", "Leg", "Foot"))
    thigh, shank = unit(knee - joint), unit(ankle - knee)
    hip = hip_angles(_inverse(hips) @ upper, thigh)
    hinge = unit(cross(thigh, np.array([0.0, 1.0, 0.0])))
    m = _inverse(upper) @ lower
    straight = _signed(shank[None], thigh[None], hinge[None])[0]
    bend = -_signed(np.broadcast_to(shank, hip.shape), m @ shank, np.broadcast_to(hinge, hip.shape)) + straight
    turn, bow, lean = to_yaw_pitch_roll(_inverse(lower) @ foot)
    _, toes, _ = to_yaw_pitch_roll(_inverse(foot) @ toe)
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


def hip_angles(relative: F64, thigh: F64) -> F64:
    """``[F, 3]`` thigh forward, to the right, turned left, from its rotation against the hips and its direction at rest."""
    way = relative @ thigh
    swing = _shortest(thigh, way)
    side = unit(np.array([1.0, 0.0, 0.0]) - thigh[0] * thigh)
    turned_side = relative @ side
    cosine = (swing @ side * turned_side).sum(axis=1)
    sine = (cross(swing @ side, turned_side) * way).sum(axis=1)
    return np.stack([np.arctan2(way[:, 1], -way[:, 2]), np.arcsin(np.clip(way[:, 0], -1, 1)), -np.arctan2(sine, cosine)], axis=1)


def _shortest(a: F64, b: F64) -> F64:
    """``[F, 3, 3]`` the shortest rotation of ``a`` onto each ``b``."""
    axis = cross(np.broadcast_to(a, b.shape), b)
    angle = np.arctan2(np.linalg.norm(axis, axis=1), b @ a)
    return Rotation.from_rotvec(unit(axis) * angle[:, None]).as_matrix()


def _inverse(m: F64) -> F64:
    return np.swapaxes(m, -1, -2)


def _signed(a: F64, b: F64, axis: F64) -> F64:
    """Signed angle from ``a`` to ``b`` about a unit ``axis``, by the right-hand rule."""
    angle: F64 = np.arctan2(
        (cross(a, b) * axis).sum(axis=-1), (a * b).sum(axis=-1) - (a * axis).sum(axis=-1) * (b * axis).sum(axis=-1)
    )
    return angle


def _about(axis: F64, angle: F64, v: F64) -> F64:
    """Rotate vectors ``[F, 3]`` about unit axes ``[F, 3]`` by angles ``[F]``."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    out: F64 = c * v + s * cross(axis, v) + (1 - c) * (axis * v).sum(axis=1, keepdims=True) * axis
    return out


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Metrics:
    """Measures of one motion; n strokes.

    Attributes:
        contact: ``[n]`` middle of the strings to the shuttle when each stroke is struck [m].
        slide: ``[P]`` how far the ball of a planted foot strays from where it was put down, for each of P plants [m].
        sunk: how far the ball of a foot is below the height it has on the floor at most [m].
        speed: ``[2]`` greatest speed of the hips of each player over the floor [m/s].
        acceleration: ``[2]`` greatest acceleration of the hips over the floor [m/s²].
        joint_excess: greatest angle by which a joint passes its limits [degrees]; 0 if none does.
        joint: name of the joint that comes closest to or furthest beyond its limits.
        clearance: height of the shuttle over the net where strokes that cross it do [m].
        landing: ``[n]`` end of each flight to the point that was drawn for it [m].
        timely: for each returned stroke, whether its flight time lies in the data's interquartile range of its shot type.
        true_end: ``[n]`` whether each stroke ends as it must: in the area it was meant for, out of court, or in the net.
        seconds: length [s].
    """

    contact: F64
    slide: F64
    sunk: float
    speed: F64
    acceleration: F64
    joint_excess: float
    joint: str
    clearance: F64
    landing: F64
    timely: Bools
    true_end: Bools
    seconds: float


def measure(motion: Motion) -> Metrics:
    """Measure a motion."""
    trajectory, frames = motion.trajectory, motion.contact_frame
    striker = trajectory.rally.striker
    hips = motion.position[:, :, 0, :2].astype(np.float64)
    velocity = np.diff(hips, axis=0) * motion.fps
    ends = np.rint(trajectory.end_time * motion.fps).astype(np.int64)
    worst = max((joint for seat in (0, 1) for joint in joints(motion, seat)), key=lambda joint: joint.excess)
    shot = trajectory.rally.catalogue.shot[trajectory.rally.stroke]
    low, _, high = load_measured().flight_time[shot].T
    duration = trajectory.end_time - trajectory.time
    returned = trajectory.end == RETURN
    slide, sunk = _feet(motion)
    return Metrics(
        contact=np.linalg.norm(motion.sweet_spot[frames, striker] - motion.shuttle[frames], axis=1),
        slide=slide,
        sunk=sunk,
        speed=np.linalg.norm(velocity, axis=2).max(axis=0),
        acceleration=np.linalg.norm(np.diff(velocity, axis=0), axis=2).max(axis=0) * motion.fps,
        joint_excess=float(np.degrees(worst.excess)) if worst.excess > _ROUNDING else 0.0,
        joint=worst.name,
        clearance=np.array([clearance(motion, int(i)) for i in np.flatnonzero(trajectory.end != NET)]),
        landing=np.linalg.norm(motion.shuttle[ends] - trajectory.chosen_point, axis=1),
        timely=((duration >= low - 1e-6) & (duration <= high + 1e-6))[returned],
        true_end=np.array([_ends_truly(motion, i, int(ends[i])) for i in range(len(frames))]),
        seconds=float(motion.time[-1]),
    )


def _feet(motion: Motion) -> tuple[F64, float]:
    """Slide of planted feet, and depth to which feet sink into the floor."""
    slides, sunk = [], 0.0
    for seat in (0, 1):
        for foot, side in enumerate(("Left", "Right")):
            ball = motion.position[:, seat, BONE[f"{side}ToeBase"]].astype(np.float64)
            sunk = max(sunk, float(motion.skeletons[seat].at("RightToeBase")[2] - ball[:, 2].min()))
            edges = np.flatnonzero(np.diff(np.r_[0, motion.planted[:, seat, foot].astype(np.int8), 0])).reshape(-1, 2)
            slides += [float(np.linalg.norm(ball[a:b, :2] - ball[a, :2], axis=1).max()) for a, b in edges]
    return np.array(slides), sunk


def clearance(motion: Motion, i: int) -> float:
    """Height over the net of a stroke that crosses it [m]."""
    trajectory = motion.trajectory
    since = np.arange(0, trajectory.end_time[i] - trajectory.time[i], 1 / _FINE)
    path, _ = trajectory.flight.at(i, since)
    over = np.flatnonzero(np.diff(np.sign(path[:, 1])) != 0)
    return float((path[over, 2] - net_height(path[over, 0])).min()) if len(over) else -np.inf


def _ends_truly(motion: Motion, i: int, frame: int) -> bool:
    """Whether a stroke ends according to its outcome."""
    trajectory, rally = motion.trajectory, motion.trajectory.rally
    stroke, seat = rally.stroke[i], int(rally.striker[i])
    sign = rally.facing(seat)
    x, y, z = motion.shuttle[frame].astype(np.float64) * np.array([sign, sign, 1.0])
    meant = int(area_of(np.array(x), np.array(y))) == rally.aim[seat, stroke]
    serve = bool(rally.catalogue.is_serve[stroke])
    in_box = abs(x) <= HALF_WIDTH and (SHORT_SERVICE if serve else 0.0) <= y <= HALF_LENGTH
    if trajectory.end[i] in (RETURN, OPEN):
        # A serve is met within the service court, a net kill is struck before the shuttle is where it was meant for.
        killed = i + 1 < len(rally) and SHOTS[rally.catalogue.shot[rally.stroke[i + 1]]] == "net-kill"
        return meant or serve or killed
    if trajectory.end[i] == WIN:
        return bool((meant or serve) and in_box and z < 0.05)
    if trajectory.end[i] == OUT:
        return bool(not in_box and z < 0.05)
    after = motion.shuttle[frame:].astype(np.float64)
    touched = abs(y) < 0.05 and z < float(net_height(x))
    stays = (after[:, 1] * sign < 0.05).all()
    return bool(touched and stays and after[-1, 2] < 0.05)
