"""The key poses of :mod:`shuttle_marl.staging.motions` as joint angles of one athlete; solved once, then kept."""

import dataclasses
import functools
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.staging.arm import Arm, Goal, arm_of, solve
from shuttle_marl.staging.contact import MOTIONS
from shuttle_marl.staging.motions import AIM, CONTACT, KEYS, READY, REST, WAIT, Key
from shuttle_marl.staging.rotation import apply, turned, unit
from shuttle_marl.staging.skeleton import SWEET_SPOT, Skeleton
from shuttle_marl.staging.spine import HIPS_HEIGHT, HIPS_YAW, N_TRUNK, collar_of, trunk

Floats = npt.NDArray[np.float64]

N_ARM: Final = 10
TRUNK: Final = slice(0, N_TRUNK)
RACKET_ARM: Final = slice(N_TRUNK, N_TRUNK + N_ARM)
FREE_ARM: Final = slice(N_TRUNK + N_ARM, N_TRUNK + 2 * N_ARM)
N_POSE: Final = N_TRUNK + 2 * N_ARM
"""Numbers of a pose without legs and head: trunk, racket arm, free arm."""
FLIP: Final = np.array([-1.0, 1.0, 1.0])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Library:
    """Poses of one athlete.

    Attributes:
        stroke: ``[13, 6, 27]`` key poses by motion and phase.
        ready: ``[27]`` between strokes.
        wait: ``[27]`` before the serve, the receiver.
        rest: ``[27]`` after the rally.
        contact: ``[13, 3]`` where each motion meets the shuttle best, in the stroke frame [m].
        miss: ``[13, 6]`` how far the racket is from where the motions want it [m].
    """

    stroke: Floats
    ready: Floats
    wait: Floats
    rest: Floats
    contact: Floats
    miss: Floats


@functools.cache
def library_of(skeleton: Skeleton) -> Library:
    """All poses of an athlete, scaled to their size."""
    keys = [*(key for motion in range(len(MOTIONS)) for key in KEYS[motion]), READY, WAIT, REST]
    aim = np.zeros((len(keys), 3))
    hit = np.zeros(len(keys), dtype=bool)
    hit[CONTACT : 6 * len(MOTIONS) : 6] = True
    # Contacts are written in the stroke frame, key poses in the facing frame.
    back = turned(np.array([-np.radians(KEYS[motion][CONTACT].hips[1]) for motion in range(len(MOTIONS))]))
    aim[hit] = apply(back, np.array([AIM[motion] for motion in range(len(MOTIONS))]))
    poses, reached, miss = _solve(skeleton, keys, aim, hit)
    n = len(MOTIONS) * 6
    return Library(
        stroke=poses[:n].reshape(-1, 6, N_POSE),
        ready=poses[n],
        wait=poses[n + 1],
        rest=poses[n + 2],
        contact=apply(back.transpose(0, 2, 1), reached[hit]),
        miss=miss[:n].reshape(-1, 6),
    )


def _solve(skeleton: Skeleton, keys: list[Key], aim: Floats, hit: npt.NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
    arm, size, n = arm_of(skeleton), skeleton.scale, len(keys)
    poses = np.zeros((n, N_POSE))
    poses[:, HIPS_HEIGHT] = [size * key.hips[0] for key in keys]
    poses[:, HIPS_YAW:N_TRUNK] = np.radians([(*key.hips[1:], *key.spine) for key in keys])
    facing = poses[:, TRUNK].copy()
    facing[:, HIPS_YAW] = 0
    hips = np.zeros((n, 3))
    hips[:, 2] = poses[:, HIPS_HEIGHT]
    rotation, position = trunk(skeleton, hips, facing)
    chest, collar = rotation[-1], collar_of(skeleton, rotation[-1], position[-1])
    point = np.where(hit[:, None], aim, np.array([key.grip for key in keys])) * size
    goal = in_chest(
        chest,
        collar,
        Goal(
            point=point,
            reach=np.where(hit, SWEET_SPOT, 0.0),
            shaft=unit(np.array([key.shaft for key in keys])),
            normal=np.zeros((n, 3)),
            elbow=unit(np.array([key.elbow for key in keys])),
            weight=np.where(hit[:, None], (2.0, 0.7, 0.0, 0.45), (6.0, 0.8, 0.0, 0.35)),
        ),
    )
    poses[:, RACKET_ARM] = solve_from_anywhere(arm, goal)
    seen = _reached(arm, poses[:, RACKET_ARM], goal.reach)
    miss = np.linalg.norm(seen - goal.point, axis=1)
    reached = apply(chest, seen) + collar
    # The free arm is solved as a right arm in a mirror; its hand holds nothing, so the point is the palm.
    mirrored = np.diag(FLIP) @ chest @ np.diag(FLIP)
    other = collar_of(skeleton, chest, position[-1], "Left") * FLIP
    free = in_chest(
        mirrored,
        other,
        Goal(
            point=np.array([key.free for key in keys]) * FLIP * size,
            reach=np.zeros(n),
            shaft=np.zeros((n, 3)),
            normal=np.zeros((n, 3)),
            elbow=unit(np.array([key.free_elbow for key in keys]) * FLIP),
            weight=np.tile((6.0, 0.0, 0.0, 0.35), (n, 1)),
        ),
    )
    poses[:, FREE_ARM] = solve_from_anywhere(arm, free)
    return poses, reached, miss


def in_chest(chest: Floats, collar: Floats, goal: Goal) -> Goal:
    """A goal given in the frame around, seen from the chest: ``[N, 3, 3]`` its rotation, ``[N, 3]`` where the collar bone begins."""
    back = chest.transpose(0, 2, 1)
    return dataclasses.replace(
        goal,
        point=apply(back, goal.point - collar),
        shaft=apply(back, goal.shaft),
        normal=apply(back, goal.normal),
        elbow=apply(back, goal.elbow),
    )


def solve_from_anywhere(arm: Arm, goal: Goal) -> Floats:
    """The best of the solutions found from several starting poses."""
    n = len(goal.point)
    starts = np.radians(
        [
            (5, 5, 0, 0, 0, 60, 0, 0, 10, 0),
            (10, 10, -40, 60, 40, 60, 0, 0, 10, 0),
            (10, 10, 40, -40, -40, 80, 40, 0, 10, 0),
            (15, 5, 0, 70, -60, 90, -40, 0, 20, 0),
            (5, 10, 60, 0, 60, 100, 60, 0, 10, 40),
            (5, 10, -60, -30, 0, 40, -30, 0, 10, -40),
        ]
    )
    found, cost = np.empty((len(starts), n, N_ARM)), np.empty((len(starts), n))
    for k, start in enumerate(starts):
        found[k] = solve(arm, goal, np.tile(start, (n, 1)), rounds=60)
        pose = arm.pose(found[k])
        shaft = apply(pose.rotation[4], arm.axis)
        error = np.linalg.norm(pose.position[4] + goal.reach[:, None] * shaft - goal.point, axis=1) * goal.weight[:, 0]
        turn = np.linalg.norm(shaft - goal.shaft, axis=1) * goal.weight[:, 1]
        upper = unit(pose.position[2] - pose.position[1])
        cost[k] = error**2 + turn**2 + (np.linalg.norm(upper - goal.elbow, axis=1) * goal.weight[:, 3]) ** 2
    return np.take_along_axis(found, cost.argmin(axis=0)[None, :, None], axis=0)[0]


def _reached(arm: Arm, angles: Floats, reach: Floats) -> Floats:
    pose = arm.pose(angles)
    return pose.position[4] + reach[:, None] * apply(pose.rotation[4], arm.axis)
