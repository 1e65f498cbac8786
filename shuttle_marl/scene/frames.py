"""Frames of reference of a scene: which hangs on which, where each lies or how it moves in a rally."""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.arrays import F64, I64, Bools, Floats
from shuttle_marl.staging import BONES, RACKET_LENGTH, Motion
from shuttle_marl.staging.rotation import cross, matrix, quaternion, unit
from shuttle_marl.staging.skeleton import BONE

WORLD: Final = "court"
"""Frame of reference of the court."""
PLAY: Final = "play"
"""Frame of reference of players and shuttle: the court as the player at seat 0 began the match on it."""
SHUTTLE: Final = "shuttle"
"""Moves and turns with the shuttle: its cork lies ahead, along z."""
SHUTTLE_PLACE: Final = "shuttle_place"
"""Moves with the shuttle and never turns."""
SHADOWS: Final = ("shadow_0", "shadow_1", "shadow_shuttle")
"""Frames of reference on the floor below the hips of seats 0 and 1, and below the shuttle."""
_ABOVE_FLOOR: Final = 0.012
_GRID: Final = 2.0**14
"""Numbers are rounded to 1/16384: 0.06 mm and 0.007 degrees, and compress to a third."""
_NAME: Final = 0.42
"""Height of the names over the heads [m]."""
_FLIP: Final = 0.06
"""Time in which a shuttle turns its cork round after it was struck [s]."""
TOLERANCE: Final = 0.008
"""Largest error between two instants that are told, at the far end of all that hangs on a joint [m]."""
_COARSE: Final = 0.02
"""The same for names and shadows [m]."""
_SHUTTLE_REACH: Final = 0.1
_LIMB_END: Final = 0.25
"""From the last joint of a limb to its tip, at most [m]."""


def bone_frame(seat: int, bone: str) -> str:
    """Name of the frame of reference of a bone."""
    return f"{seat}/{bone}"


def name_frame(seat: int) -> str:
    """Name of the frame of reference over the head of a player, which never turns."""
    return f"{seat}/name"


def place_frame(seat: int) -> str:
    """Name of the frame of reference that moves with the hips of a player and never turns."""
    return f"player_{seat}"


def _joint_frame(seat: int, bone: int) -> str:
    """Name of the frame of reference in which a bone turns; it is fixed in that of the bone's parent."""
    return f"{seat}.{bone}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fixed:
    """A frame of reference that is fixed in another and not turned.

    Attributes:
        child: its name.
        parent: name of the other.
        place: where it begins in the other [m].
    """

    child: str
    parent: str
    place: list[float]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Track:
    """A frame of reference that moves or turns in another, at F instants.

    Attributes:
        child: its name.
        parent: name of the other.
        values: ``[F, 3]`` where it begins in the other [m], or ``[F, 4]`` quaternions (x, y, z, w) by which it is turned.
        tolerance: how far it may be off between instants that are told [m] or [rad].
        exact: ``[F]`` instants at which it may not be off.
    """

    child: str
    parent: str
    values: F64
    tolerance: float
    exact: Bools

    def instants(self, packet: int) -> list[int]:
        """Instants from which the others can be interpolated; every ``packet``-th one is among them."""
        from shuttle_marl.scene.instants import choose_instants  # noqa: PLC0415  numba is slow to import

        told = np.empty(len(self.values), dtype=np.bool_)
        choose_instants(self.values, self.tolerance, self.exact, packet, told)
        return [int(i) for i in np.flatnonzero(told)]


def fixed_frames(motion: Motion) -> list[Fixed]:
    """Joints of both players: where each bone begins in the one that it hangs on."""
    out = []
    for seat in (0, 1):
        rest = motion.rest(seat)
        for bone, parent in enumerate(motion.parents(seat)):
            if parent >= 0:
                place: list[float] = _rounded(rest[bone] - rest[parent]).tolist()
                out.append(Fixed(child=_joint_frame(seat, bone), parent=bone_frame(seat, BONES[parent]), place=place))
    return out


def tracks_of(motion: Motion, *, ends_changed: bool = False) -> list[Track]:
    """All that moves: the play on the court, both players with names and shadows, the shuttle.

    Args:
        motion: what is seen.
        ends_changed: whether seat 0 plays from the other end of the court.
    """
    frames = len(motion.time)
    nowhere, struck = np.zeros(frames, dtype=np.bool_), np.zeros(frames, dtype=np.bool_)
    struck[motion.contact_frame] = True
    turned = np.tile([0.0, 0.0, 1.0, 0.0] if ends_changed else [0.0, 0.0, 0.0, 1.0], (frames, 1))
    out = [Track(child=PLAY, parent=WORLD, values=turned, tolerance=TOLERANCE, exact=nowhere)]
    for seat in (0, 1):
        own = nowhere.copy()
        own[motion.contact_frame[motion.trajectory.rally.striker == seat]] = True
        out += _player(motion, seat, own)
    shuttle = _rounded(motion.shuttle)
    out += [
        Track(child=SHUTTLE_PLACE, parent=PLAY, values=shuttle, tolerance=TOLERANCE, exact=struck),
        Track(
            child=SHUTTLE,
            parent=SHUTTLE_PLACE,
            values=_rounded(quaternion(_heading(motion))),
            tolerance=TOLERANCE / _SHUTTLE_REACH,
            exact=nowhere,
        ),
    ]
    above = np.concatenate([motion.position[:, :, 0], shuttle[:, None]], axis=1)
    for k, name in enumerate(SHADOWS):
        below = _rounded(np.column_stack([above[:, k, :2], np.full(frames, _ABOVE_FLOOR)]))
        out.append(Track(child=name, parent=PLAY, values=below, tolerance=_COARSE, exact=nowhere))
    return out


def _player(motion: Motion, seat: int, exact: Bools) -> list[Track]:
    """Place of the hips, rotation of every bone in its joint, and place of the name."""
    above = motion.parents(seat)
    turn = matrix(motion.rotation[:, seat])
    local = quaternion(np.swapaxes(turn[:, np.where(above >= 0, above, 0)], -1, -2) @ turn)
    local[:, above < 0] = quaternion(turn[:, above < 0])
    reach = _reach(motion.rest(seat), above)
    place, name = motion.position[:, seat, 0], motion.position[:, seat, BONE["Head"]] + np.array([0.0, 0.0, _NAME])
    return [
        Track(child=place_frame(seat), parent=PLAY, values=_rounded(place), tolerance=TOLERANCE, exact=exact),
        *(
            Track(
                child=bone_frame(seat, bone),
                parent=_joint_frame(seat, i) if above[i] >= 0 else place_frame(seat),
                values=_rounded(local[:, i]),
                tolerance=TOLERANCE / reach[i],
                exact=exact,
            )
            for i, bone in enumerate(BONES)
        ),
        Track(child=name_frame(seat), parent=PLAY, values=_rounded(name), tolerance=_COARSE, exact=np.zeros_like(exact)),
    ]


def _reach(rest: F64, parents: I64) -> F64:
    """``[23]`` from each joint to the farthest tip of all that hangs on it, limbs stretched [m]."""
    reach = np.full(len(BONES), _LIMB_END)
    reach[BONE["Racket"]] = RACKET_LENGTH
    order = sorted(range(len(BONES)), key=lambda i: _depth(i, parents), reverse=True)
    for i in order:
        if parents[i] >= 0:
            reach[parents[i]] = max(reach[parents[i]], np.linalg.norm(rest[i] - rest[parents[i]]) + reach[i])
    return reach


def _depth(bone: int, parents: I64) -> int:
    return 0 if parents[bone] < 0 else 1 + _depth(int(parents[bone]), parents)


def _rounded(values: Floats) -> F64:
    return np.rint(values.astype(np.float64) * _GRID) / _GRID


def _heading(motion: Motion) -> F64:
    """``[F, 3, 3]`` rotation of the shuttle: its cork flies ahead, but for a moment after it was struck."""
    velocity = motion.shuttle_velocity.astype(np.float64)
    speed = np.linalg.norm(velocity, axis=1)
    way = np.zeros_like(velocity)
    last = np.array([0.0, 0.0, -1.0])
    for i in range(len(velocity)):
        # In the hand the cork points down; on the floor it lies as it came.
        if i >= motion.contact_frame[0] and speed[i] > 0.3:
            last = velocity[i] / speed[i]
        way[i] = last
    flip = round(_FLIP * motion.fps)
    for contact in motion.contact_frame:
        before, after = way[max(contact - 1, 0)], way[min(contact + flip, len(way) - 1)]
        for k in range(flip):
            if contact + k < len(way):
                way[contact + k] = _between(before, after, (k + 0.5) / flip)
    ended = round(float(motion.trajectory.end_time[-1]) * motion.fps)
    # A shuttle at rest lies on its side.
    flat = way[ended:] * np.array([1.0, 1.0, 0.0])
    share = np.clip(np.arange(len(flat)) / (0.2 * motion.fps), 0, 1)[:, None]
    way[ended:] = unit((1 - share) * way[ended:] + share * unit(flat + np.array([1e-6, 0, 0])))
    up = np.where(np.abs(way[:, 2:]) < 0.95, np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]]))
    x = unit(cross(up, way))
    return np.stack([x, cross(way, x), way], axis=-1)


def _between(a: F64, b: F64, share: float) -> F64:
    """Direction between two, on the shorter way round; any way if they are opposite."""
    angle = float(np.arccos(np.clip(a @ b, -1, 1)))
    aside = b - (a @ b) * a
    if np.linalg.norm(aside) < 1e-6:
        aside = np.cross(a, [0.0, 0.0, 1.0] if abs(a[2]) < 0.9 else [1.0, 0.0, 0.0])
    aside = aside / np.linalg.norm(aside)
    out: F64 = np.cos(share * angle) * a + np.sin(share * angle) * aside
    return out
