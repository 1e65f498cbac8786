"""All that moves in a scene: its frames of reference, and the messages of bones, shuttle, trail and states."""

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from foxglove.messages import (
    FrameTransform,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Quaternion,
    SceneEntity,
    Vector3,
)

from shuttle_marl.scene import topics
from shuttle_marl.scene.report import StagedRally
from shuttle_marl.scene.topics import Timed, at, colour, entities_on, numbers_on, point, stamp
from shuttle_marl.staging import BONES, Motion
from shuttle_marl.staging.rotation import cross, matrix, quaternion, unit
from shuttle_marl.staging.skeleton import BONE

Floats = npt.NDArray[np.float64]

WORLD: Final = "court"
"""Frame of reference of the court."""
PLAY: Final = "play"
"""Frame of reference of players and shuttle: the court as the player at seat 0 began the match on it."""
SHUTTLE: Final = "shuttle"
SHADOWS: Final = ("shadow_0", "shadow_1", "shadow_shuttle")
"""Frames of reference on the floor below the hips of seats 0 and 1, and below the shuttle."""
_ABOVE_FLOOR: Final = 0.012
_GRID: Final = 2.0**14
"""Numbers are rounded to 1/16384: 0.06 mm and 0.007 degrees, and compress to a third."""
_NAME: Final = 0.42
"""Height of the names over the heads [m]."""
_FLIP: Final = 0.06
"""Time in which a shuttle turns its cork round after it was struck [s]."""
_TRAIL: Final = 0.45
"""Length of the trail of the shuttle [s]."""
_TRAIL_POINTS: Final = 16
_EVERY: Final = 2
"""Trail and states come with every second frame."""
_TRAIL_COLOUR: Final = (1.0, 0.85, 0.25)


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
    shuttle = motion.shuttle.astype(np.float64)[:, None]
    below = np.concatenate([motion.position[:, :, 0].astype(np.float64), shuttle], axis=1)
    below[..., 2] = _ABOVE_FLOOR
    upright = np.tile([0.0, 0.0, 0.0, 1.0], (frames, len(SHADOWS), 1))
    found = (
        np.concatenate([*translation, below, shuttle], axis=1),
        np.concatenate([*rotation, upright, quaternion(_heading(motion))[:, None]], axis=1),
    )
    return Poses(
        child=(*child, *SHADOWS, SHUTTLE),
        parent=(*parent, *([PLAY] * len(SHADOWS)), PLAY),
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


def motion_messages(staged: StagedRally) -> Iterator[Timed]:
    """Messages of all that moves in a rally; each kind in the order of time."""
    yield from _transforms(staged)
    yield from _trail(staged)
    yield from _states(staged)


def _transforms(staged: StagedRally) -> Iterator[Timed]:
    poses = poses_of(staged.motion, ends_changed=staged.report.ends_changed)
    place, turn = poses.translation.tolist(), poses.rotation.tolist()
    for frame, seconds in enumerate(staged.motion.time.tolist()):
        yield staged.at(seconds), _Transforms(poses.child, poses.parent, place[frame], turn[frame])


@dataclasses.dataclass(frozen=True)
class _Transforms:
    child: tuple[str, ...]
    parent: tuple[str, ...]
    place: list[list[float]]
    turn: list[list[float]]

    def __call__(self, to: topics.Topics, time: int) -> None:
        when = stamp(time)
        rows = zip(self.child, self.parent, self.place, self.turn, strict=True)
        moved = [
            FrameTransform(
                timestamp=when,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=Vector3(x=x, y=y, z=z),
                rotation=Quaternion(x=i, y=j, z=k, w=w),
            )
            for child, parent, (x, y, z), (i, j, k, w) in rows
        ]
        to.tf.log(FrameTransforms(transforms=moved), log_time=time)


def _trail(staged: StagedRally) -> Iterator[Timed]:
    motion = staged.motion
    back = max(1, round(_TRAIL * motion.fps / _TRAIL_POINTS))
    for frame in range(0, len(motion.time), _EVERY):
        rows = np.arange(max(frame - _TRAIL_POINTS * back, motion.contact_frame[0]), frame + 1)[::-1][::back][::-1]
        path = np.round(np.asarray(motion.shuttle[rows], dtype=np.float64), 3).astype(np.float64)
        # What no longer moves leaves no trail.
        shown = len(path) > 1 and float(np.ptp(path, axis=0).max()) > 0.05
        yield staged.at(float(motion.time[frame])), entities_on(topics.SHUTTLE, _Trail(path if shown else path[:0]))


@dataclasses.dataclass(frozen=True, eq=False)
class _Trail:
    path: Floats

    def __call__(self, time: int) -> list[SceneEntity]:
        if not len(self.path):
            return []
        fade = np.linspace(0.0, 0.95, len(self.path))
        line = LinePrimitive(
            type=LinePrimitiveLineType.LineStrip,
            pose=at((0, 0, 0)),
            thickness=3.0,
            scale_invariant=True,
            points=[point(p) for p in self.path],
            color=colour(*_TRAIL_COLOUR),
            colors=[colour(*_TRAIL_COLOUR, round(float(alpha), 2)) for alpha in fade],
        )
        return [SceneEntity(id="trail", timestamp=stamp(time), frame_id=PLAY, lines=[line])]


def _states(staged: StagedRally) -> Iterator[Timed]:
    motion, trajectory = staged.motion, staged.motion.trajectory
    side = -1.0 if staged.report.ends_changed else 1.0
    hips = side * motion.position[:, :, 0, :2].astype(np.float64)
    shuttle = motion.shuttle * np.array([side, side, 1.0])
    speed = np.linalg.norm(np.gradient(hips, 1 / motion.fps, axis=0), axis=2)
    fast = np.linalg.norm(motion.shuttle_velocity, axis=1)
    flying = np.searchsorted(motion.contact_frame, np.arange(len(motion.time)), side="right") - 1
    for frame in range(0, len(motion.time), _EVERY):
        seconds, stroke = float(motion.time[frame]), int(flying[frame])
        over = seconds > float(trajectory.end_time[-1])
        phase = (
            "before the serve"
            if stroke < 0
            else "over"
            if over
            else f"{staged.report.names[trajectory.rally.striker[stroke]]} struck"
        )
        x, y, z = (round(float(v), 3) for v in shuttle[frame])
        content: dict[str, Any] = {"phase": phase, "shuttle": {"x": x, "y": y, "z": z, "speed": round(float(fast[frame]), 2)}}
        for seat in (0, 1):
            px, py = (round(float(v), 3) for v in hips[frame, seat])
            content[f"player_{seat}"] = {"x": px, "y": py, "speed": round(float(speed[frame, seat]), 2)}
        yield staged.at(seconds), numbers_on(topics.STATE, content)
