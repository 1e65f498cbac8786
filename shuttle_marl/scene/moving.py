"""Messages of all that moves: bones and shuttle, the trail, and the states that plots show."""

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
from shuttle_marl.scene.messages import Timed, at, colour, entities_on, numbers_on, point, stamp
from shuttle_marl.scene.poses import PLAY, poses_of
from shuttle_marl.scene.report import StagedRally

Floats = npt.NDArray[np.float64]

_TRAIL: Final = 0.45
"""Length of the trail of the shuttle [s]."""
_TRAIL_POINTS: Final = 16
_EVERY: Final = 2
"""Trail and states come with every second frame."""
_TRAIL_COLOUR: Final = (1.0, 0.85, 0.25)


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
