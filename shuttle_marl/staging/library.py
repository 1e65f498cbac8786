"""Key poses of :mod:`shuttle_marl.staging.poses` as joint angles of an athlete; solved once and cached."""

import dataclasses
import functools
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.staging import motions
from shuttle_marl.staging.arm import Arm, Goal, anywhere, arm_of, solve, solve_best
from shuttle_marl.staging.poses import CONTACT, POSES, STROKES, Key
from shuttle_marl.staging.rotation import apply, turned, unit
from shuttle_marl.staging.skeleton import (
    FLIP,
    HIPS_HEIGHT,
    HIPS_PITCH,
    HIPS_YAW,
    N_TRUNK,
    SPINE_PITCH,
    SWEET_SPOT,
    Skeleton,
    chest_of,
)
from shuttle_marl.staging.trajectory import own_frame

N_ARM: Final = 10
TRUNK: Final = slice(0, N_TRUNK)
RACKET_ARM: Final = slice(N_TRUNK, N_TRUNK + N_ARM)
FREE_ARM: Final = slice(N_TRUNK + N_ARM, N_TRUNK + 2 * N_ARM)
N_POSE: Final = N_TRUNK + 2 * N_ARM
"""Size of a pose without legs and head: trunk, racket arm, free arm."""


NEEDS: Final = tuple(np.linspace(-0.5, 0.6, 6).tolist())
"""Contact heights above the natural one at which each motion is solved [m]."""
_UP: Final = (0.0, 0.0, 1.0)
_CROUCH: Final = (
    (motions.OVERHEADS, (0.55, -0.16, 0.0, 0.0)),
    ({motions.LUNGE, motions.LUNGE_BACKHAND}, (0.48, -0.10, 0.21, 40.0)),
    ({motions.DEFENCE, motions.DEFENCE_BACKHAND, motions.SIDE, motions.SIDE_BACKHAND}, (0.40, -0.14, 0.14, 36.0)),
    (range(len(motions.MOTIONS)), (0.35, -0.10, 0.12, 20.0)),
)
"""Adaptation of the trunk to the contact height: fraction taken up by the hips, least and greatest change of their height [m],
and additional pitch per metre [degrees]."""


def bent(trunk_pose: F64, motion: int, need: F64) -> F64:
    """``[N, 7]`` trunks for contacts ``need`` metres above the natural one of a motion."""
    share, low, high, bow = next(numbers for kinds, numbers in _CROUCH if motion in kinds)
    out = np.broadcast_to(trunk_pose, (len(need), N_TRUNK)).copy()
    out[:, HIPS_HEIGHT] += np.clip(share * need, low, high)
    more = np.radians(np.clip(-bow * need, -0.4 * bow, 22.0))
    out[:, HIPS_PITCH] += 0.45 * more
    out[:, SPINE_PITCH] += 0.55 * more
    return out


def pointed(motion: int, need: F64) -> tuple[F64, F64]:
    """``[N, 3]`` directions of shaft and elbow at contacts ``need`` metres above the natural one of a motion.

    A player who meets the shuttle high in front of them holds the racket up, the elbow down: the head of the racket is above
    the hand, and the elbow below the shoulder.
    """
    key = STROKES[motion].keys[CONTACT]
    shaft, elbow = (np.tile(unit(np.array(direction)), (len(need), 1)) for direction in (key.shaft, key.elbow))
    if motion in (motions.LUNGE, motions.LUNGE_BACKHAND):
        up = np.clip(need, 0.0, 0.5)
        shaft[:, 2] += 2.6 * up
        elbow[:, 2] -= 0.9 * up
    return unit(shaft), unit(elbow)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Library:
    """Poses of one athlete.

    Attributes:
        stroke: ``[13, 6, 27]`` key poses by motion and phase.
        ready: ``[27]`` between strokes.
        wait: ``[27]`` before the serve, the receiver.
        rest: ``[27]`` after the rally.
        wins: ``[2, 27]`` reactions of who has won it.
        loses: ``[2, 27]`` reactions of who has lost it.
        contact: ``[13, 7, 3]`` where each motion meets the shuttle best, in the stroke frame [m]: at its own height, and
            at the heights of :data:`NEEDS` above it.
    """

    stroke: F64
    ready: F64
    wait: F64
    rest: F64
    wins: F64
    loses: F64
    contact: F64

    def natural(self, motion: int, z: float) -> F64:
        """``[3]`` natural contact of a motion for a shuttle at height ``z``, in the stroke frame [m]."""
        own = self.contact[motion, 0]
        need = np.clip(z - own[2], NEEDS[0], NEEDS[-1])
        x, y = (float(np.interp(need, NEEDS, self.contact[motion, 1:, k])) for k in (0, 1))
        return np.array([x, y, own[2]])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Athlete:
    """One player of a rally as a body.

    Attributes:
        facing: sign between the frame of the court and that of the seat.
    """

    seat: int
    facing: float
    right_handed: bool
    skeleton: Skeleton

    @property
    def library(self) -> Library:
        """Key poses of the athlete."""
        return library_of(self.skeleton)

    @property
    def signs(self) -> F64:
        """``[3]`` signs between the frame of the court and the player's own frame, mirrored for a left-hander."""
        return own_frame(self.facing, self.right_handed)


@functools.cache
def library_of(skeleton: Skeleton) -> Library:
    """Key poses of an athlete, scaled to their size."""
    others = (POSES.ready, POSES.wait, POSES.rest, *POSES.wins, *POSES.loses)
    keys = [*(key for stroke in STROKES for key in stroke.keys), *others]
    aim = np.zeros((len(keys), 3))
    hit = np.zeros(len(keys), dtype=bool)
    hit[CONTACT : 6 * len(motions.MOTIONS) : 6] = True
    # Contacts are written in the stroke frame, key poses in the facing frame.
    back = turned(np.array([-np.radians(stroke.keys[CONTACT].hips[1]) for stroke in STROKES]))
    aim[hit] = apply(back, np.array([stroke.aim for stroke in STROKES]))
    poses, reached = _solve(skeleton, keys, aim, hit)
    n = len(motions.MOTIONS) * 6
    return Library(
        stroke=poses[:n].reshape(-1, 6, N_POSE),
        ready=poses[n],
        wait=poses[n + 1],
        rest=poses[n + 2],
        wins=poses[n + 3 : n + 5],
        loses=poses[n + 5 : n + 7],
        contact=_contacts(skeleton, poses[:n].reshape(-1, 6, N_POSE)[:, CONTACT], reached[hit], back),
    )


def _contacts(skeleton: Skeleton, pose: F64, own: F64, back: F64) -> F64:
    """``[13, 7, 3]`` of :class:`Library`, from the contact poses and their reach in the facing frame."""
    arm, m, k = arm_of(skeleton), len(motions.MOTIONS), len(NEEDS)
    need = np.array(NEEDS)
    needs = [np.minimum(need, 0.0) if motion in motions.OVERHEADS else need for motion in range(m)]
    body = np.concatenate([bent(pose[motion, TRUNK], motion, needs[motion]) for motion in range(m)])
    body[:, HIPS_YAW] = 0
    chest, collar = chest_of(skeleton, np.outer(body[:, HIPS_HEIGHT], _UP), body)
    angles = np.repeat(pose[:, RACKET_ARM], k, axis=0)
    point = np.repeat(own, k, axis=0)
    height = point[:, 2] + np.concatenate(needs)
    both = [pointed(motion, needs[motion]) for motion in range(m)]
    shaft, elbow = (np.concatenate([directions[which] for directions in both]) for which in (0, 1))
    for weight in (3.0, 5.0, 8.0):
        # The height is wanted; along the floor the arm goes where it likes, and the goal follows it.
        point[:, 2] = height
        goal = Goal(point=point, reach=SWEET_SPOT, shaft=shaft, elbow=elbow, weight=(weight, 0.7, 0.0, 0.45))
        angles = solve(arm, in_chest(chest, collar, goal), angles, rounds=20)
        point = apply(chest, _strings(arm, angles)) + collar
    out = np.concatenate([own[:, None], point.reshape(m, k, 3)], axis=1)
    return apply(back.transpose(0, 2, 1)[:, None], out)


def _solve(skeleton: Skeleton, keys: list[Key], aim: F64, hit: Bools) -> tuple[F64, F64]:
    arm, size, n = arm_of(skeleton), skeleton.scale, len(keys)
    poses = np.zeros((n, N_POSE))
    poses[:, HIPS_HEIGHT] = [size * key.hips[0] for key in keys]
    poses[:, HIPS_YAW:N_TRUNK] = np.radians([(*key.hips[1:], *key.spine) for key in keys])
    facing = poses[:, TRUNK].copy()
    facing[:, HIPS_YAW] = 0
    hips = np.outer(poses[:, HIPS_HEIGHT], _UP)
    chest, collar = chest_of(skeleton, hips, facing)
    point = np.where(hit[:, None], aim, np.array([key.grip for key in keys])) * size
    goal = in_chest(
        chest,
        collar,
        Goal(
            point=point,
            reach=np.where(hit, SWEET_SPOT, 0.0),
            shaft=unit(np.array([key.shaft for key in keys])),
            elbow=unit(np.array([key.elbow for key in keys])),
            weight=np.where(hit[:, None], (2.0, 0.7, 0.0, 0.45), (6.0, 0.8, 0.0, 0.35)),
        ),
    )
    poses[:, RACKET_ARM] = solve_best(arm, goal, anywhere(len(keys)), rounds=60)
    reached = apply(chest, _strings(arm, poses[:, RACKET_ARM])) + collar
    # The free hand holds nothing, so the point is the palm.
    free = in_chest(
        *chest_of(skeleton, hips, facing, free=True),
        Goal(
            point=np.array([key.free for key in keys]) * FLIP * size,
            elbow=unit(np.array([key.free_elbow for key in keys]) * FLIP),
            weight=(6.0, 0.0, 0.0, 0.35),
        ),
    )
    poses[:, FREE_ARM] = solve_best(arm, free, anywhere(len(keys)), rounds=60)
    return poses, reached


def in_chest(chest: F64, collar: F64, goal: Goal) -> Goal:
    """Transform goals to the frame of the chest, of rotation ``[N, 3, 3]`` and origin ``[N, 3]`` at the collar bone."""
    n, back = len(chest), chest.transpose(0, 2, 1)
    shaft, normal, elbow = (apply(back, direction) for direction in (goal.shaft, goal.normal, goal.elbow))
    reach, weight = np.broadcast_to(goal.reach, n), np.broadcast_to(goal.weight, (n, 4))
    return Goal(point=apply(back, goal.point - collar), reach=reach, shaft=shaft, normal=normal, elbow=elbow, weight=weight)


def _strings(arm: Arm, angles: F64) -> F64:
    pose = arm.pose(angles)
    return pose.position[4] + SWEET_SPOT * apply(pose.rotation[4], arm.axis)
