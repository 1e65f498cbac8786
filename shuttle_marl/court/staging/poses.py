"""Kinds of stroke motions, contact heights, stances, and key poses (``poses.json``) as joint angles of an athlete.

A *stroke frame* has its origin on the floor under the hips, y where the player strides or faces, x to the right; hands are
given in the *facing frame* (y where the hips face). All is written for a right-hander of 1.79 m: others scale, left-handers are
mirrored.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.court.staging.geometry import apply, turned, unit
from shuttle_marl.court.staging.limbs import Arm, Goal, anywhere, arm_of, solve, solve_best
from shuttle_marl.court.staging.skeleton import (
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
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES

SERVE_BACKHAND, SERVE_FOREHAND, OVERHEAD, AROUND, OVERHEAD_BACKHAND = range(5)
KILL, KILL_BACKHAND, LUNGE, LUNGE_BACKHAND, SIDE, SIDE_BACKHAND, DEFENCE, DEFENCE_BACKHAND = range(5, 13)
# Kinds of motion.
MOTIONS: Final = (
    "backhand serve",
    "forehand serve",
    "overhead",
    "around the head",
    "backhand overhead",
    "net kill",
    "backhand net kill",
    "lunge",
    "backhand lunge",
    "side arm",
    "backhand side arm",
    "defence",
    "backhand defence",
)
OVERHEADS: Final = frozenset({OVERHEAD, AROUND, OVERHEAD_BACKHAND})  # motions that may be played from a jump
LUNGES: Final = frozenset({LUNGE, LUNGE_BACKHAND})
STRIDES: Final = LUNGES | {KILL, KILL_BACKHAND}  # motions whose stroke frame turns towards the shuttle
BACKHANDS: Final = frozenset(k for k, name in enumerate(MOTIONS) if "backhand" in name)
HELD: Final[dict[int, tuple[tuple[float, float, float], float]]] = {  # serves: palm against contact [m], release before it [s]
    SERVE_BACKHAND: ((-0.04, 0.02, 0.04), 0.06),
    SERVE_FOREHAND: ((-0.12, 0.04, 0.32), 0.26),
}


class Manner(NamedTuple):
    """Contact heights and racket speed of a shot type."""

    below: tuple[float, float]  # range of the contact height below the net [m]
    above: tuple[float, float]  # the same above the net [m]
    ratio: float  # speed of the strings relative to the launch speed; in soft strokes the incoming shuttle adds speed
    soft: float = 0.0  # fraction of the way to the contact that the racket has completed at the take-back; 0: full swing


MANNERS: Final = {
    "short-serve": Manner((0.98, 1.10), (0.98, 1.10), 0.60, 0.3),
    "long-serve": Manner((0.68, 0.90), (0.68, 0.90), 0.62),
    "clear": Manner((1.05, 1.42), (2.34, 2.60), 0.72),
    "lift": Manner((0.50, 1.20), (1.62, 1.80), 0.68),
    "drop": Manner((1.05, 1.42), (2.30, 2.59), 0.45, 0.25),
    "smash": Manner((1.30, 1.45), (2.50, 2.84), 0.72),
    "half-smash": Manner((1.30, 1.45), (2.42, 2.68), 0.70),
    "drive": Manner((0.95, 1.42), (1.62, 2.00), 0.68),
    "push": Manner((1.05, 1.45), (1.60, 1.80), 0.60, 0.35),
    "net-kill": Manner((1.38, 1.48), (1.70, 2.00), 0.80),
    "net-shot": Manner((0.75, 1.42), (1.60, 1.72), 0.32, 0.75),
    "block": Manner((0.55, 1.20), (1.60, 1.85), 0.30, 0.75),
    "cross-court-net-shot": Manner((0.75, 1.38), (1.60, 1.72), 0.36, 0.7),
}
_FLAT, _FLAT_OVERHEAD = (1.58, 1.70), (2.12, 2.22)  # contact heights of flat shuttles above the net [m]: shoulder, overhead
_LOWER: Final = (0.0, 0.14, 0.05)  # contact height of overhead strokes below that of the forehand [m], by technique
OVERHEAD_FROM: Final = 2.1  # height of the contact above which a stroke is overhead [m]
_NET_ZONE: Final = 2.7  # distance from the net below which a low contact is a lunge [m]
_ABOVE_FROM: Final = 1.55
_WIDEST_STRIDE: Final = np.radians(55)


def height_range(shot: int, height: int, technique: int, *, flat: bool = False) -> tuple[float, float]:
    """Least and greatest contact height of a kind of stroke, in reply to a flat one or not [m]."""
    backhand_serve = SHOTS[shot] == "long-serve" and TECHNIQUES[technique] == "backhand"
    manner = MANNERS["short-serve" if backhand_serve else SHOTS[shot]]
    low, high = manner.above if height else manner.below
    if flat and height:
        return _FLAT_OVERHEAD if low > OVERHEAD_FROM else _FLAT
    if low > OVERHEAD_FROM:
        return low - _LOWER[technique], high - _LOWER[technique]
    if height and TECHNIQUES[technique] == "around-the-head":
        return 2.12, 2.3
    return low, high


def motion_of(shot: int, technique: int, z: float, from_net: float) -> int:
    """Kind of motion for a contact at height ``z`` [m], ``from_net`` metres from the net."""
    backhand = TECHNIQUES[technique] == "backhand"
    if shot < 2:
        return SERVE_BACKHAND if backhand else SERVE_FOREHAND
    if z > OVERHEAD_FROM:
        return (OVERHEAD, OVERHEAD_BACKHAND, AROUND)[technique]
    if from_net < _NET_ZONE:
        return (KILL if z > _ABOVE_FROM else LUNGE) + backhand
    return (SIDE if z > 1.2 else DEFENCE) + backhand


@dataclasses.dataclass(frozen=True)
class Stance:
    """Place and motion of the striker."""

    motion: int  # index into MOTIONS
    heading: float  # rotation of the stroke frame to the left against the player's own frame [rad]
    root: F64  # [2] position of the hips over the floor, in the player's own frame [m]
    reach: float  # lateral stretch, 0 to 1


def stance_of(motion: int, contact: F64, base: F64, right_handed: bool, natural: F64) -> Stance:
    """Stance of a player who comes from ``base`` at a contact; ``contact``: ``[3]`` position of the shuttle, in the player's own
    frame [m]; ``base``: ``[2]`` position of the player at the opponent's contact [m]; ``natural``: ``[3]`` natural contact of
    this motion, in the stroke frame of a right-hander [m]."""
    way = contact[:2] - base
    far = float(np.clip((np.hypot(*way) - 0.9) / 1.3, 0, 1))
    heading = 0.0
    if motion in STRIDES:
        heading = float(np.clip(np.arctan2(-way[0], max(way[1], 0.2)), -_WIDEST_STRIDE, _WIDEST_STRIDE))
    x, y = natural[:2]
    x = x if right_handed else -x
    c, s = np.cos(heading), np.sin(heading)
    root = contact[:2] - np.array([c * x - s * y, s * x + c * y])
    # Hips stay behind the net.
    root[1] = min(root[1], -0.45)
    return Stance(motion=motion, heading=heading, root=root, reach=far)


Triple = tuple[float, float, float]
CONTACT: Final = 3  # among the key poses: prepare, take back, load, contact, follow through, finish


class Key(msgspec.Struct, frozen=True, kw_only=True):
    """One key pose."""

    hips: tuple[
        float, float, float, float
    ]  # height of the hips [m], and how far they turn left, bow forward, lean right [degrees]
    spine: Triple  # how far the chest turns left, bows forward, leans right against the hips [degrees]
    grip: Triple = (0.0, 0.0, 0.0)  # middle of the grip [m]
    shaft: Triple
    elbow: Triple  # direction from the shoulder to the elbow of the racket arm
    free: Triple  # the free hand [m]
    free_elbow: Triple = (-0.6, -0.3, -0.75)  # direction from the shoulder to the elbow of the free arm


class Stroke(msgspec.Struct, frozen=True, kw_only=True):
    """A kind of motion."""

    aim: Triple  # approximate contact in the stroke frame [m]; the solver moves it within the comfort of the arm
    feet: tuple[Triple, Triple, int]  # left and right at the contact (x, y, heading in degrees), and which lands last
    keys: tuple[Key, Key, Key, Key, Key, Key]


class _Poses(msgspec.Struct, frozen=True):
    ready: Key
    wait: Key
    rest: Key
    wins: tuple[Key, Key]
    loses: tuple[Key, Key]
    strokes: dict[str, Stroke]


_POSES: Final = msgspec.json.decode(Path(__file__).with_name("poses.json").read_bytes(), type=_Poses)
STROKES: Final = tuple(_POSES.strokes[name] for name in MOTIONS)  # strokes by the number of their motion

_N_ARM: Final = 10
TRUNK, RACKET_ARM = slice(0, N_TRUNK), slice(N_TRUNK, N_TRUNK + _N_ARM)
FREE_ARM: Final = slice(N_TRUNK + _N_ARM, N_TRUNK + 2 * _N_ARM)
N_POSE: Final = N_TRUNK + 2 * _N_ARM  # size of a pose without legs and head: trunk, racket arm, free arm
_NEEDS: Final = tuple(np.linspace(-0.5, 0.6, 6).tolist())  # heights above the natural one at which motions are solved [m]
_UP: Final = (0.0, 0.0, 1.0)
_CROUCH: Final = (  # by contact height: share of the hips, their least and greatest change [m], pitch [°/m]
    (OVERHEADS, (0.55, -0.16, 0.0, 0.0)),
    (LUNGES, (0.48, -0.10, 0.21, 40.0)),
    ({DEFENCE, DEFENCE_BACKHAND, SIDE, SIDE_BACKHAND}, (0.40, -0.14, 0.14, 36.0)),
    (range(len(MOTIONS)), (0.35, -0.10, 0.12, 20.0)),
)


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
    """``[N, 3]`` directions of shaft and elbow at contacts ``need`` metres above the natural one of a motion. In front of the
    body, a high shuttle is met with the racket up and the elbow down."""
    key = STROKES[motion].keys[CONTACT]
    shaft, elbow = (np.tile(unit(np.array(direction)), (len(need), 1)) for direction in (key.shaft, key.elbow))
    if motion in LUNGES:
        up = np.clip(need, 0.0, 0.5)
        shaft[:, 2] += 2.6 * up
        elbow[:, 2] -= 0.9 * up
    return unit(shaft), unit(elbow)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Library:
    """Poses of one athlete."""

    stroke: F64  # [13, 6, 27] key poses by motion and phase
    ready: F64  # [27] between strokes
    wait: F64  # [27] before the serve, the receiver
    rest: F64  # [27] after the rally
    wins: F64  # [2, 27] reactions of who has won it
    loses: F64  # [2, 27] reactions of who has lost it
    contact: F64  # [13, 7, 3] best contact in the stroke frame [m]: at its own height, and 0.5 m below to 0.6 m above it

    def natural(self, motion: int, z: float) -> F64:
        """``[3]`` natural contact of a motion for a shuttle at height ``z``, in the stroke frame [m]."""
        own = self.contact[motion, 0]
        need = np.clip(z - own[2], _NEEDS[0], _NEEDS[-1])
        x, y = (float(np.interp(need, _NEEDS, self.contact[motion, 1:, k])) for k in (0, 1))
        return np.array([x, y, own[2]])


def own_frame(facing: float, right_handed: bool = True) -> F64:
    """``[3]`` signs between the frame of the court and the player's own frame, mirrored for a left-hander; ``facing``: sign
    between both frames, see :meth:`~shuttle_marl.game.rally.Rally.facing`."""
    return np.array([facing if right_handed else -facing, facing, 1.0])


@dataclasses.dataclass(frozen=True, eq=False)
class Athlete:
    """One player of a rally as a body; ``facing`` is the sign between the frame of the court and that of the seat."""

    seat: int
    facing: float
    right_handed: bool
    skeleton: Skeleton

    @property
    def library(self) -> Library:
        """Key poses."""
        return library_of(self.skeleton)

    @property
    def signs(self) -> F64:
        """``[3]`` of :func:`own_frame`."""
        return own_frame(self.facing, self.right_handed)


@functools.cache
def library_of(skeleton: Skeleton) -> Library:
    """Key poses of an athlete, scaled to their size."""
    others = (_POSES.ready, _POSES.wait, _POSES.rest, *_POSES.wins, *_POSES.loses)
    keys = [*(key for stroke in STROKES for key in stroke.keys), *others]
    aim, hit, n = np.zeros((len(keys), 3)), np.zeros(len(keys), dtype=bool), 6 * len(MOTIONS)
    hit[CONTACT:n:6] = True
    # Contacts are written in the stroke frame, key poses in the facing frame.
    back = turned(np.array([-np.radians(stroke.keys[CONTACT].hips[1]) for stroke in STROKES]))
    aim[hit] = apply(back, np.array([stroke.aim for stroke in STROKES]))
    poses, reached = _solve(skeleton, keys, aim, hit)
    ready, wait, rest = poses[n : n + 3]
    strokes = poses[:n].reshape(-1, 6, N_POSE)
    contact = _contacts(skeleton, strokes[:, CONTACT], reached[hit], back)
    wins, loses = poses[n + 3 : n + 5], poses[n + 5 :]
    return Library(stroke=strokes, ready=ready, wait=wait, rest=rest, wins=wins, loses=loses, contact=contact)


def _contacts(skeleton: Skeleton, pose: F64, own: F64, back: F64) -> F64:
    """``[13, 7, 3]`` of :class:`Library`, from the contact poses and their reach in the facing frame."""
    arm, m, k = arm_of(skeleton), len(MOTIONS), len(_NEEDS)
    need = np.array(_NEEDS)
    needs = [np.minimum(need, 0.0) if motion in OVERHEADS else need for motion in range(m)]
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
    """``[N, 27]`` poses, and ``[N, 3]`` where they reach with the strings; ``hit``: whether the strings aim, not the grip."""
    arm, size, n = arm_of(skeleton), skeleton.scale, len(keys)
    poses = np.zeros((n, N_POSE))
    poses[:, HIPS_HEIGHT] = [size * key.hips[0] for key in keys]
    poses[:, HIPS_YAW:N_TRUNK] = np.radians([(*key.hips[1:], *key.spine) for key in keys])
    facing = poses[:, TRUNK].copy()
    facing[:, HIPS_YAW] = 0
    hips = np.outer(poses[:, HIPS_HEIGHT], _UP)
    chest, collar = chest_of(skeleton, hips, facing)
    goal = Goal(
        point=np.where(hit[:, None], aim, np.array([key.grip for key in keys])) * size,
        reach=np.where(hit, SWEET_SPOT, 0.0),
        shaft=unit(np.array([key.shaft for key in keys])),
        elbow=unit(np.array([key.elbow for key in keys])),
        weight=np.where(hit[:, None], (2.0, 0.7, 0.0, 0.45), (6.0, 0.8, 0.0, 0.35)),
    )
    poses[:, RACKET_ARM] = solve_best(arm, in_chest(chest, collar, goal), anywhere(n), rounds=60)
    reached = apply(chest, _strings(arm, poses[:, RACKET_ARM])) + collar
    # The free hand holds nothing, so the point is the palm.
    free = Goal(
        point=np.array([key.free for key in keys]) * FLIP * size,
        elbow=unit(np.array([key.free_elbow for key in keys]) * FLIP),
        weight=(6.0, 0.0, 0.0, 0.35),
    )
    free = in_chest(*chest_of(skeleton, hips, facing, free=True), free)
    poses[:, FREE_ARM] = solve_best(arm, free, anywhere(n), rounds=60)
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
