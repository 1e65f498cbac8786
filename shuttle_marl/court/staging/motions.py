"""Kinds of stroke motions, heights of contacts, and stances.

The matches say whether a contact was above or below the net, not how high. The heights below are choices within that:
clears at full reach, smashes as high as a jump brings them, serves under 1.15 m (BWF Law 9), other strokes at typical heights.

A *stroke frame* has its origin on the floor under the hips; y points where the player strides or faces (the net, but for strides
into a corner), x to the right. All is written for a right-hander of 1.79 m; other athletes scale, and a left-hander is the mirror
image.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES

LEFT, RIGHT = 0, 1
SERVE_BACKHAND, SERVE_FOREHAND, OVERHEAD, AROUND, OVERHEAD_BACKHAND = range(5)
KILL, KILL_BACKHAND, LUNGE, LUNGE_BACKHAND, SIDE, SIDE_BACKHAND, DEFENCE, DEFENCE_BACKHAND = range(5, 13)
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
"""Kinds of motion."""

_HEIGHTS: Final[dict[str, tuple[tuple[float, float], tuple[float, float]]]] = {
    "short-serve": ((0.98, 1.10), (0.98, 1.10)),
    "long-serve": ((0.68, 0.90), (0.68, 0.90)),
    "clear": ((1.05, 1.42), (2.34, 2.60)),
    "lift": ((0.50, 1.20), (1.62, 1.80)),
    "drop": ((1.05, 1.42), (2.30, 2.59)),
    "smash": ((1.30, 1.45), (2.50, 2.84)),
    "half-smash": ((1.30, 1.45), (2.42, 2.68)),
    "drive": ((0.95, 1.42), (1.62, 2.00)),
    "push": ((1.05, 1.45), (1.60, 1.80)),
    "net-kill": ((1.38, 1.48), (1.70, 2.00)),
    "net-shot": ((0.75, 1.42), (1.60, 1.72)),
    "block": ((0.55, 1.20), (1.60, 1.85)),
    "cross-court-net-shot": ((0.75, 1.38), (1.60, 1.72)),
}
"""Range of the contact height [m] below and above the net."""

_FLAT: Final = (1.58, 1.70)
_FLAT_OVERHEAD: Final = (2.12, 2.22)
"""Range of the contact height above the net for flat shuttles, which do not rise far over it [m]: at the shoulder, overhead."""

_LOWER: Final = (0.0, 0.14, 0.05)
"""Contact height of overhead strokes below that of the forehand [m], by technique."""

OVERHEADS: Final = frozenset({OVERHEAD, AROUND, OVERHEAD_BACKHAND})
"""Motions that may be played from a jump."""
BACKHANDS: Final = frozenset(k for k, name in enumerate(MOTIONS) if "backhand" in name)
HELD: Final[dict[int, tuple[tuple[float, float, float], float]]] = {
    SERVE_BACKHAND: ((-0.04, 0.02, 0.04), 0.06),
    SERVE_FOREHAND: ((-0.12, 0.04, 0.32), 0.26),
}
"""Serves: position of the palm relative to the contact [m], and time of release before the contact [s]."""
STRIDES: Final = frozenset({KILL, KILL_BACKHAND, LUNGE, LUNGE_BACKHAND})
"""Motions whose stroke frame turns towards the shuttle."""
_WIDEST_STRIDE: Final = np.radians(55)
OVERHEAD_FROM: Final = 2.1
"""Height of the contact above which a stroke is overhead [m]."""
_NET_ZONE: Final = 2.7
"""Distance from the net below which a low contact is a lunge [m]."""
_ABOVE_FROM: Final = 1.55


@dataclasses.dataclass(frozen=True)
class Stance:
    """Place and motion of the striker.

    Attributes:
        motion: index into :data:`MOTIONS`.
        heading: rotation of the stroke frame to the left against the player's own frame [rad].
        root: ``[2]`` position of the hips over the floor, in the player's own frame [m].
        reach: lateral stretch, 0 to 1.
    """

    motion: int
    heading: float
    root: F64
    reach: float


def height_range(shot: int, height: int, technique: int, *, flat: bool = False) -> tuple[float, float]:
    """Least and greatest contact height of a kind of stroke, in reply to a flat one or not [m]."""
    low, high = _HEIGHTS[SHOTS[shot]][height]
    if flat and height:
        return _FLAT_OVERHEAD if low > OVERHEAD_FROM else _FLAT
    if SHOTS[shot] == "long-serve" and TECHNIQUES[technique] == "backhand":
        low, high = _HEIGHTS["short-serve"][height]
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
    if z > _ABOVE_FROM:
        if from_net < _NET_ZONE:
            return KILL_BACKHAND if backhand else KILL
        return SIDE_BACKHAND if backhand else SIDE
    if from_net < _NET_ZONE:
        return LUNGE_BACKHAND if backhand else LUNGE
    if z > 1.2:
        return SIDE_BACKHAND if backhand else SIDE
    return DEFENCE_BACKHAND if backhand else DEFENCE


def stance_of(motion: int, contact: F64, base: F64, right_handed: bool, natural: F64) -> Stance:
    """Stance of a player who comes from ``base`` at a contact.

    Args:
        motion: index into :data:`MOTIONS`.
        contact: ``[3]`` position of the shuttle, in the player's own frame [m].
        base: ``[2]`` position of the player at the opponent's contact [m].
        natural: ``[3]`` natural contact of this motion, in the stroke frame of a right-hander [m].
    """
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
