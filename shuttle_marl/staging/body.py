"""One player over the whole rally: feet, hips, racket on the shuttle, and all bones.

Heels rise and hips sink so that the legs reach the planted feet.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.staging.arm import arm_of
from shuttle_marl.staging.curves import curve, curve_at, ease, held_ends, smooth
from shuttle_marl.staging.feet import Feet, Plant, lifted, move, standing, steps
from shuttle_marl.staging.idle import Habits
from shuttle_marl.staging.legs import legs, reach_of, settle, strays
from shuttle_marl.staging.library import FREE_ARM, RACKET_ARM, TRUNK
from shuttle_marl.staging.meeting import meet, slopes_of
from shuttle_marl.staging.rotation import apply, from_yaw_pitch_roll, unit
from shuttle_marl.staging.skeleton import (
    BONE,
    FLIP,
    HIPS_HEIGHT,
    HIPS_PITCH,
    HIPS_ROLL,
    HIPS_YAW,
    N_BONES,
    SPINE_LIMITS,
    SPINE_YAW,
    Skeleton,
    collar_of,
    trunk,
)
from shuttle_marl.staging.timeline import Keys, Past, Timeline

NECK_LIMITS: Final[F64] = np.radians([(-72, 72), (-50, 55)])
"""``[2, 2]`` limits of yaw and pitch of the head against the chest [rad]."""
_JOINT: Final = 9
"""Frames over which a continued motion blends into the previous one."""
_TRIES: Final = 3
"""Maximum number of corrections of slipping feet."""
_SLIP: Final = 3e-3
"""Tolerated displacement of the ball of a planted foot [m]."""
_EVEN: Final = 6
"""Half width of the moving mean of the height of the hips [frames]."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Prepared:
    """State before the bones are solved: F frames, H hits.

    Attributes:
        hips: ``[F, 3]`` position of the hips [m].
        path: ``[F, 2]`` their path over the floor, without shifts of weight [m].
        plants: times and places at which the left and the right foot are planted.
        miss: ``[H, 3]`` vector from strings to shuttle at each hit [m].
    """

    hips: F64
    path: F64
    feet: Feet
    plants: tuple[list[Plant], list[Plant]]
    keys: Keys
    miss: F64
    timeline: Timeline
    added: Habits


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Course:
    """Inputs of the bones of one player over F frames, in the player's own frame, as a right-hander.

    Attributes:
        hips: ``[F, 3]`` position of the hips [m].
        pose: ``[F, 27]`` trunk and arms.
        gaze: ``[F, 2]`` yaw and pitch of the head against the chest [rad].
    """

    hips: F64
    pose: F64
    feet: Feet
    gaze: F64

    def part(self, rows: slice) -> "Course":
        """A range of frames."""
        return Course(hips=self.hips[rows], pose=self.pose[rows], feet=self.feet.part(rows), gaze=self.gaze[rows])


@dataclasses.dataclass(frozen=True, eq=False)
class Player:
    """Motion of a player over F frames: inputs of the bones, and the state needed to continue the motion.

    Attributes:
        shift: ``[n, 3]`` shift of the hips at each stroke, so that the racket reaches the shuttle [m].
        rhythm: random seed of breathing and shifts of weight.
    """

    course: Course
    prepared: Prepared
    shift: F64
    rhythm: int

    def past(self, frame: int, strokes: int) -> tuple[Past, tuple[list[Plant], list[Plant]]]:
        """Plan and plants up to a frame, with ``strokes`` strokes struck."""
        keys = self.prepared.keys
        n = int(np.searchsorted(keys.frame, frame))
        if 0 < n < len(keys.frame):
            pose, slope = curve_at(keys.frame, keys.pose, keys.slope, frame)
        else:
            pose = keys.pose[min(n, len(keys.frame) - 1)]
            slope = np.zeros_like(pose)
        stand, plants = standing(self.prepared.plants, self.course.feet.ball[:, frame], frame)
        known = Keys(
            frame=np.r_[keys.frame[:n], frame],
            pose=np.concatenate([keys.pose[:n], pose[None]]),
            slope=np.concatenate([keys.slope[:n], slope[None]]),
        )
        return Past(
            frame=frame,
            strokes=strokes,
            keys=known,
            stand=stand,
            lift=self.prepared.timeline.lift,
            air=self.prepared.timeline.air,
        ), plants


def prepare(
    skeleton: Skeleton,
    timeline: Timeline,
    hips: F64,
    fps: int,
    added: Habits,
    known: tuple[list[Plant], list[Plant]] | None = None,
    before: Course | None = None,
) -> Prepared:
    """Place feet and hips, and solve the contacts.

    Args:
        hips: ``[F, 2]`` the hips over the floor [m].
        known: plants up to the branch.
        before: B unchanged frames.
    """
    body = curve(timeline.frame, timeline.pose, slopes_of(timeline, timeline.pose), len(hips))[:, TRUNK]
    place = np.column_stack([hips, smooth(body[:, HIPS_HEIGHT], _EVEN) + timeline.lift]) + added.place
    reach = reach_of(skeleton, body[:, HIPS_HEIGHT])
    plants = steps(timeline.stands, hips, body[:, HIPS_YAW], reach, fps, known)
    body[:, HIPS_YAW : HIPS_ROLL + 1] += added.pose[:, HIPS_YAW : HIPS_ROLL + 1]
    root = from_yaw_pitch_roll(body[:, HIPS_YAW], body[:, HIPS_PITCH], body[:, HIPS_ROLL])
    done = len(before.hips) if before else 0
    for _ in range(_TRIES):
        feet = move(plants, timeline.air, len(hips), fps, done)
        settled, feet = _settled(skeleton, place, root, feet, before)
        slips = strays(skeleton, settled[done:], root[done:], feet.part(slice(done, None))) > _SLIP
        if not lifted(plants, slips & feet.planted[:, done:], done):
            break
    place = settled
    keys, miss = meet(skeleton, timeline, place, fps)
    return Prepared(hips=place, path=hips, feet=feet, plants=plants, keys=keys, miss=miss, timeline=timeline, added=added)


def _settled(skeleton: Skeleton, place: F64, root: F64, feet: Feet, before: Course | None) -> tuple[F64, Feet]:
    """Hips and feet within reach of the legs in all frames, unchanged frames first."""
    if not before:
        return settle(skeleton, place, root, feet)
    # Frames before the branch count as far as the moving means reach.
    done = len(before.hips)
    rows = slice(max(done - _JOINT, 0), None)
    place, root, at = place[rows], root[rows], min(done, _JOINT)
    place, feet = settle(skeleton, place, root, feet.part(rows))
    # Only the height is blended: the path over the floor is continuous already. Then the legs have to reach the feet again.
    place[at:, 2:] = _joined(before.hips[:, 2:], place[at - 1 :, 2:])
    later, after = settle(skeleton, place[at:], root[at:], before.feet.joined(feet.part(slice(at - 1, None))))
    return np.concatenate([before.hips, later]), before.feet.concatenated(after)


def course(skeleton: Skeleton, prepared: Prepared, shuttle: F64, before: Course | None = None) -> Course:
    """Inputs of the bones in all frames.

    Args:
        shuttle: ``[F, 3]`` position of the shuttle, which the head follows [m].
        before: B unchanged frames.
    """
    keys, done = prepared.keys, len(before.hips) if before else 0
    pose = curve(keys.frame, keys.pose, keys.slope, len(prepared.hips)) + prepared.added.pose
    arm = arm_of(skeleton)
    for part in (RACKET_ARM, FREE_ARM):
        pose[:, part] = arm.clipped(pose[:, part])
    spine = slice(SPINE_YAW, SPINE_YAW + 3)
    pose[:, spine] = np.clip(pose[:, spine], SPINE_LIMITS[:, 0], SPINE_LIMITS[:, 1])
    rows = slice(max(done - 1, 0), None)
    rotation, position = trunk(skeleton, prepared.hips[rows], pose[rows, TRUNK])
    gaze = _gaze(skeleton, rotation[-1], position[-1], shuttle[rows])
    if before:
        pose[:done] = before.pose
        gaze = np.clip(_joined(before.gaze, gaze), NECK_LIMITS[:, 0], NECK_LIMITS[:, 1])
        gaze = np.concatenate([before.gaze, gaze])
    return Course(hips=prepared.hips, pose=pose, feet=prepared.feet, gaze=gaze)


def _joined(before: F64, after: F64) -> F64:
    """Blend ``[1 + N, k]``, whose first row is the last one of ``[B, k]``, into it: value and slope change over a few frames."""
    n = len(after) - 1
    u = np.clip(np.arange(1, n + 1) / _JOINT, 0, 1)[:, None]
    off = before[-1] - after[0]
    drift = (before[-1] - before[-2] if len(before) > 1 else 0.0) - (after[1] - after[0] if n else 0.0)
    return after[1:] + (1 - ease(u)) * off + _JOINT * u * (1 - u) ** 2 * drift


def bones(skeleton: Skeleton, course: Course) -> tuple[F64, F64]:
    """Bones of one player, in the player's own frame, as a right-hander.

    Returns:
        ``[F, 23, 3, 3]`` rotation of each bone from rest, and ``[F, 23, 3]`` where it begins [m].
    """
    place, pose = course.hips, course.pose
    rotation, position = np.empty((len(place), N_BONES, 3, 3)), np.empty((len(place), N_BONES, 3))
    spine_rotation, spine_position = trunk(skeleton, place, pose[:, TRUNK])
    _set_bones(rotation, position, ("Hips", "Spine", "Spine1", "Spine2"), spine_rotation, spine_position)
    chest, middle = spine_rotation[-1], spine_position[-1]
    arm = arm_of(skeleton)
    racket = arm.pose(pose[:, RACKET_ARM])
    collar = collar_of(skeleton, chest, middle)
    names: tuple[str, ...] = ("RightShoulder", "RightArm", "RightForeArm", "RightHand", "Racket")
    _set_bones(rotation, position, names, chest @ racket.rotation, collar + apply(chest, racket.position))
    free = arm.pose(pose[:, FREE_ARM])
    flip = np.diag(FLIP)
    collar = collar_of(skeleton, chest, middle, "Left")
    names = ("LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand")
    turn, begin = chest @ (flip @ free.rotation @ flip), collar + apply(chest, free.position * FLIP)
    _set_bones(rotation, position, names, turn[:4], begin[:4])
    turns, places = legs(skeleton, place, spine_rotation[0], course.feet)
    for k, side in enumerate(("Left", "Right")):
        names = tuple(f"{side}{bone}" for bone in ("UpLeg", "Leg", "Foot", "ToeBase"))
        _set_bones(rotation, position, names, turns[k], places[k])
    zero = np.zeros(len(place))
    half = from_yaw_pitch_roll(0.45 * course.gaze[:, 0], 0.4 * course.gaze[:, 1], zero)
    rest = from_yaw_pitch_roll(0.55 * course.gaze[:, 0], 0.6 * course.gaze[:, 1], zero)
    neck = middle + apply(chest, skeleton.at("Neck") - skeleton.at("Spine2"))
    turn = chest @ half
    head = neck + apply(turn, skeleton.at("Head") - skeleton.at("Neck"))
    _set_bones(rotation, position, ("Neck", "Head"), np.stack([turn, turn @ rest]), np.stack([neck, head]))
    return rotation, position


def free_palm(skeleton: Skeleton, rotation: F64, position: F64) -> F64:
    """``[F, 3]`` palm of the hand without the racket, in the player's own frame [m], from what :func:`bones` returns."""
    hand = BONE["LeftHand"]
    return position[:, hand] + rotation[:, hand] @ (arm_of(skeleton).offset[3] * FLIP)


def _set_bones(rotation: F64, position: F64, names: tuple[str, ...], turn: F64, place: F64) -> None:
    rows = [BONE[name] for name in names]
    rotation[:, rows], position[:, rows] = turn.swapaxes(0, 1), place.swapaxes(0, 1)


def _gaze(skeleton: Skeleton, chest: F64, middle: F64, shuttle: F64) -> F64:
    neck = middle + apply(chest, skeleton.at("Neck") - skeleton.at("Spine2"))
    eyes = neck + np.array([0.0, 0.0, 0.15])
    way = apply(chest.transpose(0, 2, 1), unit(shuttle - eyes))
    yaw = np.arctan2(-way[:, 0], np.maximum(way[:, 1], 0.05))
    pitch = -np.arcsin(np.clip(way[:, 2], -1, 1))
    aim = np.stack([np.clip(yaw, *(0.95 * NECK_LIMITS[0])), np.clip(pitch, *(0.95 * NECK_LIMITS[1]))], axis=1)
    # A moving mean over a fifth of a second stays within the limits.
    kernel = np.hanning(13)[1:-1]
    kernel /= kernel.sum()
    return np.stack([np.convolve(held_ends(aim[:, k], 5), kernel, mode="valid") for k in range(2)], axis=1)
