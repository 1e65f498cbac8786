"""Key poses of a player, contacts, stands of the feet and jumps: what a timeline holds, and what of it stays."""

import dataclasses

import numpy as np

from shuttle_marl.arrays import F64, I64
from shuttle_marl.staging.motions import Stance
from shuttle_marl.staging.stands import Stand
from shuttle_marl.staging.trajectory import facing


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Hit:
    """One contact of this player.

    Attributes:
        key: which key pose it is.
        frame: when.
        stroke: which stroke of the rally.
        stance: how it is met, mirrored for a left-hander.
        point: ``[3]`` where the shuttle is [m].
        normal: ``[3]`` where the strings face.
        shaft: ``[3]`` direction of the shaft that suits the motion.
        elbow: ``[3]`` direction from the shoulder to the elbow that does.
        swing: ``[3]`` velocity that the strings shall have [m/s].
        soft: share of the way from the take-back to the contact that the racket has made when it is loaded: 0 for full swings.
    """

    key: int
    frame: int
    stroke: int
    stance: Stance
    point: F64
    normal: F64
    shaft: F64
    elbow: F64
    swing: F64
    soft: float


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Keys:
    """Key poses of a player, solved: K of them.

    Attributes:
        frame: ``[K]`` when each is taken, ascending.
        pose: ``[K, 27]`` the poses.
        slope: ``[K, 27]`` how fast they change there, for each frame.
    """

    frame: I64
    pose: F64
    slope: F64


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Past:
    """Part of the movements of a player that stays as it is.

    Attributes:
        frame: the last frame that does.
        strokes: how many strokes of the rally have been struck by then.
        keys: key poses up to that frame, the last one in it.
        stand: where the feet stand then, or land next.
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
        frame: ``[K]`` when each key pose is taken, ascending.
        pose: ``[K, 27]`` the key poses; racket arm and spine at contacts are still to be solved.
        known: the first of them, which are solved already.
        hits: the contacts.
        lift: ``[F]`` height of the hips in jumps, relative to standing [m].
        air: ``[F]`` height of the feet over the floor in jumps [m].
        stands: stands of the feet.
    """

    frame: I64
    pose: F64
    known: Keys
    hits: tuple[Hit, ...]
    lift: F64
    air: F64
    stands: list[Stand]


def own_frame(seat: int, right_handed: bool) -> F64:
    """``[3]`` signs that turn the frame of the court into the player's own, mirrored for a left-hander, and back."""
    sign = facing(seat)
    return np.array([sign if right_handed else -sign, sign, 1.0])
