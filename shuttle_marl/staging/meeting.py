"""Contacts: key poses bent so that the strings meet the shuttle at the speed and in the direction of the stroke.

At a contact the joints of the arm turn so fast that the middle of the strings moves at a fraction of the shuttle's launch
velocity, less the velocity that hips and trunk give it already. A stroke is a swing about that instant: from the load to the
contact the joints accelerate evenly, after it they slow down, so that the racket is fastest when it strikes.
"""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64, Intp
from shuttle_marl.staging import motions
from shuttle_marl.staging.arm import LIMITS, Arm, Goal, anywhere, arm_of, solve, solve_best, sweet_spot, sweet_spot_jacobian
from shuttle_marl.staging.curves import slopes_through
from shuttle_marl.staging.library import FREE_ARM, RACKET_ARM, in_chest
from shuttle_marl.staging.rotation import apply, turned, unit
from shuttle_marl.staging.skeleton import (
    FLIP,
    SPINE_LIMITS,
    SPINE_YAW,
    SWEET_SPOT,
    Skeleton,
    chest_of,
)
from shuttle_marl.staging.timeline import Hit, Keys, Timeline

_COST: Final = np.array([0.5, 0.5, 0.13, 0.13, 0.12, 0.12, 0.14, 0.30, 0.34, 50.0])
"""Cost of the speed of each joint; shoulder, elbow and forearm turn most, the grip does not turn."""
_FASTEST: Final = np.array([7.0, 7.0, 24.0, 24.0, 36.0, 32.0, 36.0, 24.0, 14.0, 0.0])
"""Greatest speed of each joint [rad/s]; internal rotation of the shoulder and pronation are the fastest in smashes."""
_ROOM: Final = 2.2

_MOST_LEAN: Final = np.radians(18)
_TOLERANCE: Final = 2e-3
_YIELD: Final = 0.35
"""Fraction by which the shaft yields to the direction that the strings face. With 1, a net shot from a lunge would be played with
a hanging racket head and a high hand."""


def swing(arm: Arm, angles: F64, wanted: F64, before: F64, after: F64) -> F64:
    """``[N, 10]`` speeds of the joints at the contacts [rad/s].

    Args:
        angles: ``[N, 10]`` at the contact.
        wanted: ``[N, 3]`` target velocity of the strings relative to the chest, in its frame [m/s].
        before: ``[N]`` seconds from the load to the contact.
        after: ``[N]`` seconds from the contact to the follow-through.
    """
    jacobian = sweet_spot_jacobian(arm, angles)
    back, ahead = angles - LIMITS[:, 0], LIMITS[:, 1] - angles
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
    out = slopes_through(timeline.frame, poses)
    out[: len(timeline.known.slope)] = timeline.known.slope
    return out


def meet(skeleton: Skeleton, timeline: Timeline, place: F64, fps: int) -> tuple[Keys, F64]:
    """Key poses with solved contacts, and the remaining ``[H, 3]`` vectors from strings to shuttle [m]."""
    poses = timeline.pose.copy()
    if not timeline.hits:
        return Keys(frame=timeline.frame, pose=poses, slope=slopes_of(timeline, poses)), np.zeros((0, 3))
    arm = arm_of(skeleton)
    frames = np.array([hit.frame for hit in timeline.hits])
    rows = np.searchsorted(timeline.frame, frames)
    hips = place[frames]
    point = np.array([hit.point for hit in timeline.hits])
    back = np.array([hit.stance.motion in motions.BACKHANDS for hit in timeline.hits])
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
        angles = solve(arm, goal((8.0, 0.4, 0.4, 0.3)), angles, rounds=10 if not step else 4)
        poses[rows] = _leant(skeleton, hips, poses[rows], lean0, _strings(arm, angles), point)
    exact = goal((60.0, 0.15, 0.15, 0.1))
    angles = solve(arm, exact, angles, rounds=14)
    short = _strings(arm, angles) - exact.point
    far = np.flatnonzero(np.linalg.norm(short, axis=1) > _TOLERANCE)
    if len(far):
        # Local minimum at the limits: restart from other poses of the same stroke.
        starts = np.stack([timeline.pose[rows[far] + k, RACKET_ARM] for k in (0, -1, 1)])
        starts = np.concatenate([angles[far][None], starts, anywhere(len(far))])
        again = solve_best(arm, goal((60.0, 0.1, 0.05, 0.05), far), starts, rounds=24)
        better = np.linalg.norm(_strings(arm, again) - exact.point[far], axis=1) < np.linalg.norm(short[far], axis=1)
        angles[far[better]] = again[better]
    poses[rows, RACKET_ARM] = angles
    for hit in timeline.hits:
        if hit.stance.motion in motions.HELD:
            _hold(skeleton, timeline, hit, place, poses, fps)
    chest, _ = chest_of(skeleton, hips, poses[rows])
    return _struck(skeleton, timeline, place, poses, fps), apply(chest, exact.point - _strings(arm, angles))


def _struck(skeleton: Skeleton, timeline: Timeline, place: F64, poses: F64, fps: int) -> Keys:
    """Key poses with the speed of the arm at the contacts, and matching loads and follow-throughs."""
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
    return Keys(frame=frame, pose=poses, slope=slopes)


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
    """Bring the free hand of the server to the shuttle in the key poses before the contact."""
    keys = np.arange(len(timeline.known.frame), np.searchsorted(timeline.frame, hit.frame))
    if not len(keys):
        return
    chest, collar = chest_of(skeleton, place[timeline.frame[keys]], poses[keys], free=True)
    above = timeline.frame[keys] <= hit.frame - round(motions.HELD[hit.stance.motion][1] * fps)
    spot = (hit.point + turned(np.array(hit.stance.heading)) @ np.array(motions.HELD[hit.stance.motion][0])) * FLIP
    goal = Goal(
        point=np.tile(spot, (len(keys), 1)),
        elbow=unit(np.array([0.62, 0.2, -0.75])),
        weight=(10.0, 0.0, 0.0, 0.2),
    )
    found = solve(arm_of(skeleton), in_chest(chest, collar, goal), poses[keys, FREE_ARM], rounds=14)
    poses[keys[above], FREE_ARM] = found[above]


def _strings(arm: Arm, angles: F64) -> F64:
    """``[N, 3]`` the middle of the strings, in the frame of the chest."""
    return sweet_spot(arm, arm.pose(angles))


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
