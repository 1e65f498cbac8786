"""Plan of a player: key poses, contacts, jumps, and stands of the feet at strokes, in the split step and while waiting."""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.staging import motions
from shuttle_marl.staging.motions import LEFT, RIGHT
from shuttle_marl.staging.poses import STROKES

LANDING: Final = np.array([(-0.16, -0.26, 22), (0.14, 0.26, -6)])
"""After a jump: the legs have scissored, the racket foot lands in front."""
SPLIT: Final = np.array([(-0.29, 0.03, 14), (0.29, 0.00, -14)])
"""In the split step."""
WAIT: Final = np.array([(-0.10, 0.24, 0), (0.12, -0.22, -28)])
"""The receiver before the serve, the free foot in front."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Stand:
    """Both feet on the floor.

    Attributes:
        begin: frame from which both are planted.
        end: last frame at which both are.
        place: ``[2, 2]`` left and right, the ball of each foot [m].
        yaw: ``[2]`` headings [rad].
        last: the foot that lands last.
        hop: whether the feet come here together, through the air.
        stride: longest step of a pair of steps on the way here [m].
        stays: distance below which a foot does not step here [m].
    """

    begin: int
    end: int
    place: F64
    yaw: F64
    last: int = RIGHT
    hop: bool = False
    stride: float = 1.25
    stays: float = 0.14


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Hit:
    """One contact of this player.

    Attributes:
        point: ``[3]`` position of the shuttle [m].
        normal: ``[3]`` direction that the strings face.
        shaft: ``[3]`` preferred direction of the shaft.
        elbow: ``[3]`` preferred direction from shoulder to elbow.
        swing: ``[3]`` target velocity of the strings [m/s].
        soft: fraction of the way from take-back to contact completed at the load; 0 for full swings.
    """

    frame: int
    stroke: int
    stance: motions.Stance
    point: F64
    normal: F64
    shaft: F64
    elbow: F64
    swing: F64
    soft: float


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Keys:
    """K solved key poses of a player.

    Attributes:
        frame: ``[K]`` frame of each pose, ascending.
        pose: ``[K, 27]`` the poses.
        slope: ``[K, 27]`` slopes per frame.
    """

    frame: I64
    pose: F64
    slope: F64


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Past:
    """Unchanged part of the plan of a player.

    Attributes:
        frame: last unchanged frame.
        strokes: number of strokes struck by then.
        keys: key poses up to that frame, the last one in it.
        lift: ``[F]`` height of the hips in the jumps that were planned, relative to standing [m].
        air: ``[F]`` height of the feet over the floor in those jumps [m].
    """

    frame: int
    strokes: int
    keys: Keys
    stand: Stand
    lift: F64
    air: F64


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Timeline:
    """Movements of a player over F frames.

    Attributes:
        frame: ``[K]`` frame of each key pose, ascending.
        pose: ``[K, 27]`` the key poses; racket arm and spine at contacts are still to be solved.
        known: the first of them, already solved.
        lift: ``[F]`` height of the hips in jumps, relative to standing [m].
        air: ``[F]`` height of the feet over the floor in jumps [m].
    """

    frame: I64
    pose: F64
    known: Keys
    hits: tuple[Hit, ...]
    lift: F64
    air: F64
    stands: list[Stand]


def feet_at(motion: int, root: F64, heading: float, reach: float, high: float = 0.0) -> tuple[F64, F64, int]:
    """Places ``[2, 2]`` and headings ``[2]`` of the feet at a contact, and the foot that lands last.

    Args:
        root: ``[2]`` the hips over the floor [m].
        heading: rotation of the stroke frame to the left [rad].
        reach: lateral stretch, 0 to 1.
        high: height of the contact above the natural one, which shortens a lunge [m].
    """
    left, right, last = STROKES[motion].feet
    spots = np.array([left, right])
    if motion in (motions.DEFENCE, motions.SIDE):
        spots[RIGHT, 0] += 0.16 * reach
    elif motion == motions.DEFENCE_BACKHAND:
        spots[LEFT, 0] -= 0.16 * reach
    elif motion in (motions.LUNGE, motions.LUNGE_BACKHAND):
        spots[RIGHT, 1] += 0.05 * reach
        spots[:, 1] *= 1 - 0.9 * float(np.clip(high, 0.0, 0.5))
    place, yaw = placed(spots, root, heading)
    return place, yaw, last


def placed(spots: F64, root: F64, heading: float) -> tuple[F64, F64]:
    """Places ``[2, 2]`` and headings ``[2]`` of feet given in a frame at ``root`` that is turned left by ``heading``."""
    c, s = np.cos(heading), np.sin(heading)
    x, y = spots[:, 0], spots[:, 1]
    return root + np.stack([c * x - s * y, s * x + c * y], axis=1), np.radians(spots[:, 2]) + heading
