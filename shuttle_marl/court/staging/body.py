"""One player over the whole rally: feet, hips, racket on the shuttle, and all bones.

A stroke is a swing about the contact: joints accelerate evenly from the load on, so that the strings then move at a fraction of
the shuttle's launch velocity, less what hips and trunk give, and slow down after it.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64, Intp
from shuttle_marl.court.staging import geometry, limbs
from shuttle_marl.court.staging.feet import Feet, Plants, lifted, move, standing, steps
from shuttle_marl.court.staging.geometry import apply, ease, from_yaw_pitch_roll, smooth, unit
from shuttle_marl.court.staging.limbs import Arm, Goal, arm_of
from shuttle_marl.court.staging.poses import BACKHANDS, FREE_ARM, HELD, N_POSE, RACKET_ARM, TRUNK, in_chest
from shuttle_marl.court.staging.skeleton import (
    BONE,
    FLIP,
    HIPS_HEIGHT,
    HIPS_PITCH,
    HIPS_ROLL,
    HIPS_YAW,
    SPINE_LIMITS,
    SPINE_PITCH,
    SPINE_ROLL,
    SPINE_YAW,
    SWEET_SPOT,
    Skeleton,
    chest_of,
    collar_of,
    trunk,
)
from shuttle_marl.court.staging.timeline import Hit, Keys, Past, Timeline
from shuttle_marl.court.staging.trajectory import Trajectory

NECK_LIMITS: Final[F64] = np.radians([(-72, 72), (-50, 55)])  # of yaw and pitch of the head against the chest [rad]
_JOINT: Final = 9  # frames over which a continued motion blends into the previous one
_TRIES, _SLIP = 3, 3e-3  # most corrections of slipping feet, and tolerated slip [m]
_EVEN: Final = 6  # half width of the moving mean of the height of the hips [frames]
_COST: Final = np.array([0.5, 0.5, 0.13, 0.13, 0.12, 0.12, 0.14, 0.30, 0.34, 50.0])  # of the speed of each joint
_FASTEST: Final = np.array([7.0, 7.0, 24.0, 24.0, 36.0, 32.0, 36.0, 24.0, 14.0, 0.0])  # of each joint [rad/s]
_ROOM: Final = 2.2
_MOST_LEAN: Final = np.radians(18)
_TOLERANCE: Final = 2e-3
_YIELD: Final = 0.35  # by which the shaft yields to the strings; with 1, net shots from a lunge have a hanging racket head
_CLEAR, _COMING = 0.06, 0.20  # time around an own contact without idle movement, and fade-out before it [s]
_IN_PLAY, _CALM = 0.4, 0.5  # amplitude during the rally, as a fraction, and duration of the transition between rest and play [s]
_BREATH: Final = (3.4, 1.7)  # duration of a breath, rested and tired [s]
_MOST_EFFORT: Final = 6  # number of attacks in a rally until full fatigue


@dataclasses.dataclass(frozen=True, eq=False)
class Habits:
    """Idle movement over F frames, in the player's own frame, as a right-hander."""

    pose: F64  # [F, 27] to trunk and arms [rad]
    place: F64  # [F, 3] to the hips [m]


def habits(trajectory: Trajectory, seat: int, rhythm: int, frames: int, fps: int) -> Habits:
    """Idle movements of a player; ``rhythm``: random seed of the phases of both players, 0 or more."""
    time = np.arange(frames) / fps
    own = trajectory.time[trajectory.rally.striker == seat]
    late = time[:, None] - own
    free = np.where(late < 0, ease((-late - _CLEAR) / _COMING), ease((late - _CLEAR) / _CALM)).prod(axis=1)
    begun = float(trajectory.time[0]) if len(trajectory.time) else np.inf
    over = np.inf if trajectory.rally.open or not len(trajectory.time) else float(trajectory.end_time[-1])
    resting = np.maximum(1 - ease((time - begun + 0.9) / _CALM), ease((time - over) / _CALM))
    much = free * (_IN_PLAY + (1 - _IN_PLAY) * resting)
    # Attacks so far, from 0 to 1.
    attacks = trajectory.time[(trajectory.rally.striker == seat) & trajectory.rally.catalogue.is_attack[trajectory.rally.stroke]]
    tired = free * np.minimum(ease(time[:, None] - attacks).sum(axis=1) / _MOST_EFFORT, 1.0)
    phase = np.random.default_rng([rhythm & 0xFFFFFFFF, seat]).uniform(0, 2 * np.pi, 8)
    breath = np.sin(phase[0] + np.cumsum(2 * np.pi / (_BREATH[0] + (_BREATH[1] - _BREATH[0]) * tired)) / fps)

    def wave(k: int, seconds: float) -> F64:
        return np.sin(2 * np.pi * time / seconds + phase[k])

    pose = np.zeros((frames, N_POSE))
    pose[:, SPINE_PITCH] = much * (0.014 + 0.035 * tired) * breath + 0.10 * tired
    weight = wave(1, 2.7) + 0.5 * wave(2, 1.7)
    pose[:, HIPS_ROLL], pose[:, SPINE_ROLL] = 0.016 * much * weight, -0.020 * much * weight
    pose[:, HIPS_YAW] = 0.022 * much * wave(3, 3.1)
    for part in (RACKET_ARM, FREE_ARM):
        pose[:, part.start + limbs.RAISE] = much * (0.02 + 0.03 * tired) * breath
    arm = RACKET_ARM.start
    pose[:, arm + limbs.ELBOW] = 0.06 * much * wave(4, 1.9) - 0.10 * tired
    pose[:, arm + limbs.SWING_1] = 0.03 * much * wave(5, 2.3)
    pose[:, arm + limbs.BEND], pose[:, arm + limbs.DEVIATION] = 0.08 * much * wave(6, 1.3), 0.04 * much * wave(7, 1.1)
    # The racket turns in the fingers, periodically.
    since = (time + phase[3]) % 2.6
    turns = resting * free * np.where(since < 0.7, np.sin(np.pi * np.clip(since / 0.7, 0, 1)) ** 2, 0.0)
    pose[:, arm + limbs.ROLL], pose[:, arm + limbs.PRONATION] = 0.9 * turns, 0.35 * turns
    pose[:, FREE_ARM.start + limbs.ELBOW] = 0.04 * much * wave(5, 1.6)
    place = np.stack([0.016 * weight, 0.010 * wave(4, 2.2), 0.006 * wave(6, 0.95) - 0.004], axis=1)
    place *= (free * (0.12 + 0.88 * resting))[:, None]
    return Habits(pose, place)


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """State before the bones are solved: F frames, H hits."""

    hips: F64  # [F, 3] position of the hips [m]
    path: F64  # [F, 2] their path over the floor, without shifts of weight [m]
    feet: Feet
    plants: Plants
    keys: Keys
    miss: F64  # [H, 3] vector from strings to shuttle at each hit [m]
    timeline: Timeline
    added: Habits


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """Inputs of the bones of one player over F frames, in the player's own frame, as a right-hander."""

    hips: F64  # [F, 3] position of the hips [m]
    pose: F64  # [F, 27] trunk and arms
    feet: Feet
    gaze: F64  # [F, 2] yaw and pitch of the head against the chest [rad]

    def part(self, rows: slice) -> "Course":
        """A range of frames."""
        return Course(self.hips[rows], self.pose[rows], self.feet.part(rows), self.gaze[rows])


@dataclasses.dataclass(frozen=True, eq=False)
class PlayerMotion:
    """Motion of a player over F frames: inputs of the bones, and what is needed to continue it."""

    course: Course
    prepared: Prepared
    shift: F64  # [n, 3] of the hips at each stroke, so that the racket reaches the shuttle [m]
    rhythm: int  # random seed of breathing and shifts of weight

    def past(self, frame: int, strokes: int) -> tuple[Past, Plants]:
        """Plan and plants up to a frame, with ``strokes`` strokes struck."""
        keys = self.prepared.keys
        n = int(np.searchsorted(keys.frame, frame))
        if keys.frame[0] < frame < keys.frame[-1]:
            pose, slope = geometry.curve_at(keys.frame, keys.pose, keys.slope, frame)
        else:
            pose = keys.pose[min(n, len(keys.frame) - 1)]
            slope = np.zeros_like(pose)
        stand, plants = standing(self.prepared.plants, self.course.feet.ball[:, frame], frame)
        known = Keys(np.r_[keys.frame[:n], frame], np.vstack([keys.pose[:n], pose]), np.vstack([keys.slope[:n], slope]))
        return Past(frame, strokes, known, stand, self.prepared.timeline), plants


def prepare(
    skeleton: Skeleton,
    timeline: Timeline,
    hips: F64,
    fps: int,
    added: Habits,
    known: Plants | None = None,
    before: Course | None = None,
) -> Prepared:
    """Place feet and hips ``[F, 2]`` [m], and solve the contacts; ``known`` plants and frames ``before`` a branch stay."""
    body = geometry.curve(timeline.frame, timeline.pose, slopes_of(timeline, timeline.pose), len(hips))[:, TRUNK]
    place = np.column_stack([hips, smooth(body[:, HIPS_HEIGHT], _EVEN) + timeline.lift]) + added.place
    reach = limbs.reach_of(skeleton, body[:, HIPS_HEIGHT])
    plants = steps(timeline.stands, hips, body[:, HIPS_YAW], reach, fps, known)
    body[:, HIPS_YAW : HIPS_ROLL + 1] += added.pose[:, HIPS_YAW : HIPS_ROLL + 1]
    root = from_yaw_pitch_roll(body[:, HIPS_YAW], body[:, HIPS_PITCH], body[:, HIPS_ROLL])
    done = len(before.hips) if before else 0
    for _ in range(_TRIES):
        feet = move(plants, timeline.air, len(hips), fps, done)
        settled, feet = _settled(skeleton, place, root, feet, before)
        slips = limbs.strays(skeleton, settled[done:], root[done:], feet.part(slice(done, None))) > _SLIP
        if not lifted(plants, slips & feet.planted[:, done:], done):
            break
    keys, miss = meet(skeleton, timeline, settled, fps)
    return Prepared(settled, hips, feet, plants, keys, miss, timeline, added)


def _settled(skeleton: Skeleton, place: F64, root: F64, feet: Feet, before: Course | None) -> tuple[F64, Feet]:
    """Hips and feet within reach of the legs in all frames, unchanged frames first."""
    if not before:
        return limbs.settle(skeleton, place, root, feet)
    # Frames before the branch count as far as the moving means reach.
    done = len(before.hips)
    rows = slice(max(done - _JOINT, 0), None)
    place, root, at = place[rows], root[rows], min(done, _JOINT)
    place, feet = limbs.settle(skeleton, place, root, feet.part(rows))
    # Only the height is blended: the path over the floor is continuous already. Then the legs have to reach the feet again.
    place[at:, 2:] = _joined(before.hips[:, 2:], place[at - 1 :, 2:])
    later, after = limbs.settle(skeleton, place[at:], root[at:], before.feet.joined(feet.part(slice(at - 1, None))))
    return np.concatenate([before.hips, later]), before.feet.concatenated(after)


def course(skeleton: Skeleton, prepared: Prepared, shuttle: F64, before: Course | None = None) -> Course:
    """Inputs of the bones in all frames; the head follows the shuttle ``[F, 3]`` [m], and frames ``before`` a branch stay."""
    keys, done = prepared.keys, len(before.hips) if before else 0
    pose = geometry.curve(keys.frame, keys.pose, keys.slope, len(prepared.hips)) + prepared.added.pose
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
    return Course(prepared.hips, pose, prepared.feet, gaze)


def _joined(before: F64, after: F64) -> F64:
    """Blend ``[1 + N, k]``, whose first row is the last one of ``[B, k]``, into it: value and slope change over a few frames."""
    n = len(after) - 1
    u = np.clip(np.arange(1, n + 1) / _JOINT, 0, 1)[:, None]
    off = before[-1] - after[0]
    drift = (before[-1] - before[-2] if len(before) > 1 else 0.0) - (after[1] - after[0] if n else 0.0)
    return after[1:] + (1 - ease(u)) * off + _JOINT * u * (1 - u) ** 2 * drift


def bones(skeleton: Skeleton, course: Course) -> tuple[F64, F64]:
    """Bones of one player: ``[F, 23, 3, 3]`` rotation of each from rest, and ``[F, 23, 3]`` where it begins [m]."""
    pose, arm, flip = course.pose, arm_of(skeleton), np.diag(FLIP)
    spine, spines = trunk(skeleton, course.hips, pose[:, TRUNK])
    chest, middle = spine[-1], spines[-1]
    racket, free = arm.pose(pose[:, RACKET_ARM]), arm.pose(pose[:, FREE_ARM])
    right, rights = chest @ racket.rotation, collar_of(skeleton, chest, middle) + apply(chest, racket.position)
    left = (chest @ (flip @ free.rotation @ flip))[:4]
    lefts = (collar_of(skeleton, chest, middle, "Left") + apply(chest, free.position * FLIP))[:4]
    legs, starts = limbs.legs(skeleton, course.hips, spine[0], course.feet)
    (yaw, nod), zero = course.gaze.T, np.zeros(len(pose))
    turn = chest @ from_yaw_pitch_roll(0.45 * yaw, 0.4 * nod, zero)
    head = turn @ from_yaw_pitch_roll(0.55 * yaw, 0.6 * nod, zero)
    neck = middle + apply(chest, skeleton.at("Neck") - skeleton.at("Spine2"))
    top = neck + apply(turn, skeleton.at("Head") - skeleton.at("Neck"))
    rotation = np.stack([*spine, turn, head, *left, *right[:4], *legs[0], *legs[1], right[4]], axis=1)
    return rotation, np.stack([*spines, neck, top, *lefts, *rights[:4], *starts[0], *starts[1], rights[4]], axis=1)


def free_palm(skeleton: Skeleton, rotation: F64, position: F64) -> F64:
    """``[F, 3]`` palm of the hand without the racket, from what :func:`bones` returns [m]."""
    hand = BONE["LeftHand"]
    return position[:, hand] + rotation[:, hand] @ (arm_of(skeleton).offset[3] * FLIP)


def _gaze(skeleton: Skeleton, chest: F64, middle: F64, shuttle: F64) -> F64:
    neck = middle + apply(chest, skeleton.at("Neck") - skeleton.at("Spine2"))
    eyes = neck + np.array([0.0, 0.0, 0.15])
    way = apply(chest.transpose(0, 2, 1), unit(shuttle - eyes))
    yaw = np.arctan2(-way[:, 0], np.maximum(way[:, 1], 0.05))
    pitch = -np.arcsin(np.clip(way[:, 2], -1, 1))
    aim = np.stack([np.clip(yaw, *(0.95 * NECK_LIMITS[0])), np.clip(pitch, *(0.95 * NECK_LIMITS[1]))], axis=1)
    # A moving mean over a fifth of a second stays within the limits.
    return np.stack([smooth(aim[:, k], 5) for k in range(2)], axis=1)


def swing(arm: Arm, angles: F64, wanted: F64, before: F64, after: F64) -> F64:
    """``[N, 10]`` speeds of the joints at the contacts [rad/s]; ``wanted``: ``[N, 3]`` target velocity of the strings relative to
    the chest, in its frame [m/s]; ``before``, ``after``: ``[N]`` seconds from the load to the contact, and from there to the
    follow-through."""
    jacobian = limbs.sweet_spot_jacobian(arm, angles)
    back, ahead = angles - limbs.LIMITS[:, 0], limbs.LIMITS[:, 1] - angles
    most = np.minimum(_FASTEST, _ROOM * np.minimum(back / before[:, None], ahead / after[:, None]))
    least = -np.minimum(_FASTEST, _ROOM * np.minimum(ahead / before[:, None], back / after[:, None]))
    speed, held = np.zeros_like(angles), np.zeros(angles.shape, dtype=bool)
    for _ in range(5):
        free = np.where(held[:, None], 0.0, jacobian)
        rest = wanted - np.einsum("nij,nj->ni", jacobian, np.where(held, speed, 0.0))
        square = np.einsum("nij,j,nkj->nik", free, _COST**-2, free) + 0.02 * np.eye(3)
        push = np.linalg.solve(square, rest[..., None])[..., 0]
        found = np.einsum("nij,ni->nj", free, push) * _COST**-2
        speed = np.where(held, speed, np.clip(found, least, most))
        beyond = ~held & ((found < least) | (found > most))
        if not beyond.any():
            break
        held |= beyond
    return speed


def slopes_of(timeline: Timeline, poses: F64) -> F64:
    """``[K, 27]`` slopes at key poses: the known ones, and those of monotone cubics."""
    out = geometry.slopes_through(timeline.frame, poses)
    out[: len(timeline.known.slope)] = timeline.known.slope
    return out


def meet(skeleton: Skeleton, timeline: Timeline, place: F64, fps: int) -> tuple[Keys, F64]:
    """Key poses with solved contacts, and the remaining ``[H, 3]`` vectors from strings to shuttle [m]."""
    poses = timeline.pose.copy()
    if not timeline.hits:
        return Keys(timeline.frame, poses, slopes_of(timeline, poses)), np.zeros((0, 3))
    arm = arm_of(skeleton)
    frames = np.array([hit.frame for hit in timeline.hits])
    rows = np.searchsorted(timeline.frame, frames)
    hips = place[frames]
    point = np.array([hit.point for hit in timeline.hits])
    back = np.array([hit.stance.motion in BACKHANDS for hit in timeline.hits])
    normal = np.array([hit.normal for hit in timeline.hits]) * np.where(back, -1.0, 1.0)[:, None]
    shaft, elbow = (np.array([getattr(hit, name) for hit in timeline.hits]) for name in ("shaft", "elbow"))
    # The motion prefers a direction of the shaft, the flight one of the strings; both yield until they are orthogonal.
    shaft = unit(shaft - _YIELD * (shaft * normal).sum(axis=1, keepdims=True) * normal)
    normal = unit(normal - (shaft * normal).sum(axis=1, keepdims=True) * shaft)
    angles = poses[rows, RACKET_ARM]
    lean0 = poses[rows, SPINE_YAW : SPINE_YAW + 3].copy()

    def goal(weight: tuple[float, float, float, float], some: Intp | slice = slice(None)) -> Goal:
        """Goals of some hits in the frame of the chest."""
        chest, collar = chest_of(skeleton, hips[some], poses[rows[some]])
        return in_chest(chest, collar, Goal(point[some], elbow[some], weight, SWEET_SPOT, shaft[some], normal[some]))

    for step in range(4):
        angles = limbs.solve(arm, goal((8.0, 0.4, 0.4, 0.3)), angles, rounds=10 if not step else 4)
        poses[rows] = _leant(skeleton, hips, poses[rows], lean0, _strings(arm, angles), point)
    exact = goal((60.0, 0.15, 0.15, 0.1))
    angles = limbs.solve(arm, exact, angles, rounds=14)
    short = _strings(arm, angles) - exact.point
    far = np.flatnonzero(np.linalg.norm(short, axis=1) > _TOLERANCE)
    if len(far):
        # Local minimum at the limits: restart from other poses of the same stroke.
        starts = np.stack([timeline.pose[rows[far] + k, RACKET_ARM] for k in (0, -1, 1)])
        starts = np.concatenate([angles[far][None], starts, limbs.anywhere(len(far))])
        again = limbs.solve_best(arm, goal((60.0, 0.1, 0.05, 0.05), far), starts, rounds=24)
        better = np.linalg.norm(_strings(arm, again) - exact.point[far], axis=1) < np.linalg.norm(short[far], axis=1)
        angles[far[better]] = again[better]
    poses[rows, RACKET_ARM] = angles
    for hit in timeline.hits:
        if hit.stance.motion in HELD:
            _hold(skeleton, timeline, hit, place, poses, fps)
    chest, _ = chest_of(skeleton, hips, poses[rows])
    return _struck(skeleton, timeline, place, poses, fps), apply(chest, exact.point - _strings(arm, angles))


def _struck(skeleton: Skeleton, timeline: Timeline, place: F64, poses: F64, fps: int) -> Keys:
    arm, frame = arm_of(skeleton), timeline.frame
    rows = np.searchsorted(frame, [hit.frame for hit in timeline.hits])
    before, after = (np.abs(frame[rows + side] - frame[rows]) / fps for side in (-1, 1))
    slopes = slopes_of(timeline, poses)
    still = _carried(skeleton, timeline, place, poses, slopes, rows, fps)
    chest, _ = chest_of(skeleton, place[frame[rows]], poses[rows])
    wanted = np.array([hit.swing for hit in timeline.hits]) - still
    speed = swing(arm, poses[rows, RACKET_ARM], apply(chest.transpose(0, 2, 1), wanted), before, after)
    for side, seconds in ((-1, before), (1, after)):
        swung = arm.clipped(poses[rows, RACKET_ARM] + side * 0.5 * seconds[:, None] * speed)
        new = rows + side >= len(timeline.known.frame)
        poses[rows[new] + side, RACKET_ARM] = swung[new]
    soft = np.array([hit.soft for hit in timeline.hits])[:, None]
    early = (rows - 2 >= len(timeline.known.frame))[:, None] & (soft > 0)
    poses[rows - 2, RACKET_ARM] += np.where(early, soft, 0.0) * (poses[rows - 1, RACKET_ARM] - poses[rows - 2, RACKET_ARM])
    slopes = slopes_of(timeline, poses)
    slopes[rows, RACKET_ARM] = speed / fps
    return Keys(frame, poses, slopes)


def _carried(skeleton: Skeleton, timeline: Timeline, place: F64, poses: F64, slopes: F64, rows: I64, fps: int) -> F64:
    """``[H, 3]`` velocity of the strings at the contacts due to hips and trunk [m/s]."""
    arm, frame, d = arm_of(skeleton), timeline.frame[rows], 0.05
    strings = _strings(arm, poses[rows, RACKET_ARM])
    drift = (place[np.minimum(frame + 1, len(place) - 1)] - place[frame - 1]) / 2
    ends = []
    for side in (-d, d):
        chest, collar = chest_of(skeleton, place[frame] + side * drift, poses[rows] + side * slopes[rows])
        ends.append(collar + apply(chest, strings))
    return (ends[1] - ends[0]) * (fps / (2 * d))


def _hold(skeleton: Skeleton, timeline: Timeline, hit: Hit, place: F64, poses: F64, fps: int) -> None:
    keys = np.arange(len(timeline.known.frame), np.searchsorted(timeline.frame, hit.frame))
    if not len(keys):
        return
    chest, collar = chest_of(skeleton, place[timeline.frame[keys]], poses[keys], free=True)
    above = timeline.frame[keys] <= hit.frame - round(HELD[hit.stance.motion][1] * fps)
    spot = (hit.point + geometry.turned(np.array(hit.stance.heading)) @ np.array(HELD[hit.stance.motion][0])) * FLIP
    goal = Goal(np.tile(spot, (len(keys), 1)), elbow=unit(np.array([0.62, 0.2, -0.75])), weight=(10.0, 0.0, 0.0, 0.2))
    found = limbs.solve(arm_of(skeleton), in_chest(chest, collar, goal), poses[keys, FREE_ARM], rounds=14)
    poses[keys[above], FREE_ARM] = found[above]


def _strings(arm: Arm, angles: F64) -> F64:
    return limbs.sweet_spot(arm, arm.pose(angles))


def _leant(skeleton: Skeleton, hips: F64, poses: F64, lean0: F64, seen: F64, point: F64) -> F64:
    """Bend the spine to reduce the distance to ``point``; ``seen``: the strings in the frame of the chest."""
    # Finite differences: the pose itself and three with one perturbed angle of the spine, evaluated together.
    many = np.tile(poses, (4, 1, 1))
    for k in range(3):
        many[1 + k, :, SPINE_YAW + k] += 1e-4
    chest, collar = chest_of(skeleton, np.tile(hips, (4, 1)), many.reshape(-1, poses.shape[1]))
    place = (collar + apply(chest, np.tile(seen, (4, 1)))).reshape(4, -1, 3)
    here, jacobian = place[0], ((place[1:] - place[0]) / 1e-4).transpose(1, 2, 0)
    square = jacobian.transpose(0, 2, 1) @ jacobian + 0.02 * np.eye(3)
    change = np.linalg.solve(square, jacobian.transpose(0, 2, 1) @ (point - here)[..., None])[..., 0]
    out = poses.copy()
    spine = out[:, SPINE_YAW : SPINE_YAW + 3] + change
    spine = np.clip(spine, lean0 - _MOST_LEAN, lean0 + _MOST_LEAN)
    out[:, SPINE_YAW : SPINE_YAW + 3] = np.clip(spine, SPINE_LIMITS[:, 0], SPINE_LIMITS[:, 1])
    return out
