"""Places of all that moves, as transforms from frame to frame of reference."""

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.staging import BONES, Motion
from shuttle_marl.staging.rotation import cross, matrix, quaternion, unit
from shuttle_marl.staging.skeleton import BONE

Floats = npt.NDArray[np.float64]

WORLD: Final = "court"
"""Frame of reference of the court."""
PLAY: Final = "play"
"""Frame of reference of players and shuttle: the court as the player at seat 0 began the match on it."""
SHUTTLE: Final = "shuttle"
_GRID: Final = 2.0**14
"""Numbers are rounded to 1/16384: 0.06 mm and 0.007 degrees, and compress to a third."""
_NAME: Final = 0.42
"""Height of the names over the heads [m]."""
_FLIP: Final = 0.06
"""Time in which a shuttle turns its cork round after it was struck [s]."""


def bone_frame(seat: int, bone: str) -> str:
    """Name of the frame of reference of a bone."""
    return f"player_{seat}/{bone}"


def name_frame(seat: int) -> str:
    """Name of the frame of reference over the head of a player, which never turns."""
    return f"player_{seat}/name"


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Poses:
    """T frames of reference over F instants.

    Attributes:
        child: T names.
        parent: T names.
        translation: ``[F, T, 3]`` where each begins in its parent [m].
        rotation: ``[F, T, 4]`` quaternions (x, y, z, w) against the parent.
    """

    child: tuple[str, ...]
    parent: tuple[str, ...]
    translation: Floats
    rotation: Floats


def poses_of(motion: Motion, *, ends_changed: bool = False) -> Poses:
    """Every bone against the one it hangs on, names, the shuttle, and the play on the court.

    Args:
        motion: what is seen.
        ends_changed: whether seat 0 plays from the other end of the court.
    """
    frames = len(motion.time)
    child, parent = [PLAY], [WORLD]
    translation = [np.zeros((frames, 1, 3))]
    rotation = [np.tile([0.0, 0.0, 1.0, 0.0] if ends_changed else [0.0, 0.0, 0.0, 1.0], (frames, 1, 1))]
    for seat in (0, 1):
        above = motion.parents(seat)
        turn = matrix(motion.rotation[:, seat])
        place = motion.position[:, seat].astype(np.float64)
        base = np.where(above >= 0, above, 0)
        against = np.swapaxes(turn[:, base], -1, -2)
        offset = (against @ (place - place[:, base])[..., None])[..., 0]
        turned = against @ turn
        offset[:, above < 0], turned[:, above < 0] = place[:, above < 0], turn[:, above < 0]
        name = place[:, [BONE["Head"]]] + np.array([0.0, 0.0, _NAME])
        translation += [offset, name]
        rotation += [quaternion(turned), np.tile([0.0, 0.0, 0.0, 1.0], (frames, 1, 1))]
        child += [*(bone_frame(seat, bone) for bone in BONES), name_frame(seat)]
        parent += [*(bone_frame(seat, BONES[i]) if i >= 0 else PLAY for i in above), PLAY]
    found = (
        np.concatenate([*translation, motion.shuttle.astype(np.float64)[:, None]], axis=1),
        np.concatenate([*rotation, quaternion(_heading(motion))[:, None]], axis=1),
    )
    return Poses(
        child=(*child, SHUTTLE),
        parent=(*parent, PLAY),
        translation=np.rint(found[0] * _GRID) / _GRID,
        rotation=np.rint(found[1] * _GRID) / _GRID,
    )


def _heading(motion: Motion) -> Floats:
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


def _between(a: Floats, b: Floats, share: float) -> Floats:
    """Direction between two, on the shorter way round; any way if they are opposite."""
    angle = float(np.arccos(np.clip(a @ b, -1, 1)))
    aside = b - (a @ b) * a
    if np.linalg.norm(aside) < 1e-6:
        aside = np.cross(a, [0.0, 0.0, 1.0] if abs(a[2]) < 0.9 else [1.0, 0.0, 0.0])
    aside = aside / np.linalg.norm(aside)
    out: Floats = np.cos(share * angle) * a + np.sin(share * angle) * aside
    return out
