"""All that moves in a scene: the messages of bones, shuttle, trail and states."""

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from foxglove.messages import Color, FrameTransform, FrameTransforms, LinePrimitive, LinePrimitiveLineType, SceneEntity, Timestamp

from shuttle_marl.arrays import F64
from shuttle_marl.scene import topics
from shuttle_marl.scene.frames import PLAY, SHUTTLE_PLACE, Track, fixed_frames, tracks_of
from shuttle_marl.scene.report import StagedRally
from shuttle_marl.scene.topics import Timed, at, colour, entities_on, numbers_on, point, stamp, transform
from shuttle_marl.staging import Motion

_PACKET: Final = 1.0
"""Time that a message of transforms covers: all that moves until the next one [s]."""
_TRAIL: Final = 0.48
"""Length of the trail of the shuttle [s]."""
_TRAIL_STEP: Final = 0.08
"""From one point of the trail to the next [s]."""
_EVERY: Final = 2
"""Trail and states come with every second frame; the trail with every one just after a contact."""
_TRAIL_COLOUR: Final = (1.0, 0.85, 0.25)


def joint_message(time: int, motion: Motion) -> FrameTransforms:
    """Places of the joints of both players on the bones that they hang on; they stay there in the whole scene."""
    joints = [transform(stamp(time), joint.child, joint.parent, joint.place) for joint in fixed_frames(motion)]
    return FrameTransforms(transforms=joints)


def motion_messages(staged: StagedRally) -> Iterator[Timed]:
    """Messages of all that moves in a rally; each kind in the order of time."""
    yield from _transforms(staged)
    yield from _trail(staged)
    yield from _states(staged)


def _transforms(staged: StagedRally) -> Iterator[Timed]:
    """Packets of all frames of reference over time to come: viewers interpolate, and one packet is enough after a seek."""
    motion = staged.motion
    last, length = len(motion.time) - 1, round(_PACKET * motion.fps)
    when = [stamp(staged.at(seconds)) for seconds in motion.time.tolist()]
    told = [_Told.of(track, length) for track in tracks_of(motion, ends_changed=staged.report.ends_changed)]
    for first in range(0, last, length):
        yield staged.at(float(motion.time[first])), _Packet(told, when, first, min(first + length, last), last)


@dataclasses.dataclass(frozen=True, eq=False)
class _Told:
    """A frame of reference at the instants that are told of it."""

    track: Track
    values: dict[int, list[float]]

    @classmethod
    def of(cls, track: Track, packet: int) -> "_Told":
        instants = track.instants(packet)
        return cls(track, dict(zip(instants, track.values[instants].tolist(), strict=True)))

    def within(self, first: int, until: int, last: int) -> list[int]:
        """Instants that are told in a packet; the first is enough for what rests, unless the rally ends here."""
        instants = [i for i in range(first, until + 1) if i in self.values]
        rests = until < last and all(self.values[i] == self.values[first] for i in instants)
        return instants[:1] if rests else instants


@dataclasses.dataclass(frozen=True, eq=False)
class _Packet:
    told: list[_Told]
    when: list[Timestamp]
    first: int
    until: int
    last: int

    def __call__(self, to: topics.Topics, time: int) -> None:
        moved: list[FrameTransform] = [
            transform(self.when[i], told.track.child, told.track.parent, told.values[i])
            for told in self.told
            for i in told.within(self.first, self.until, self.last)
        ]
        to.tf.log(FrameTransforms(transforms=moved), log_time=time)


def _trail(staged: StagedRally) -> Iterator[Timed]:
    motion, contacts = staged.motion, staged.motion.contact_frame
    step, length = max(1, round(_TRAIL_STEP * motion.fps)), round(_TRAIL * motion.fps)
    just_struck = (contacts[:, None] + np.arange(_EVERY + 1)).ravel()
    frames = np.union1d(np.arange(0, len(motion.time), _EVERY), just_struck[just_struck < len(motion.time)])
    was_shown = True
    for frame in frames.tolist():
        first = max(frame - length, int(contacts[0]))
        rows = np.union1d(np.arange(frame, first - 1, -step), contacts[(contacts >= first) & (contacts <= frame)])
        path = motion.shuttle[rows].astype(np.float64)
        # What no longer moves leaves no trail.
        shown = len(path) > 1 and float(np.ptp(path, axis=0).max()) > 0.05
        if shown or was_shown:
            fade = 0.95 * np.clip(1 - (frame - rows) / length, 0, 1)
            earlier = max(frame - _EVERY, int(contacts[contacts <= frame][-1])) if shown else frame
            gap = (motion.shuttle[earlier] - motion.shuttle[frame]).astype(np.float64)
            trail = _Trail(path, fade, gap) if shown else _Trail(path[:0], fade[:0], gap)
            yield staged.at(float(motion.time[frame])), entities_on(topics.SHUTTLE, trail)
        was_shown = shown


@dataclasses.dataclass(frozen=True, eq=False)
class _Trail:
    """Way of the shuttle so far, and a line behind it that fills the gap which opens until the next message."""

    path: F64
    fade: F64
    gap: F64

    def __call__(self, time: int) -> list[SceneEntity]:
        if not len(self.path):
            return []
        faded = [colour(*_TRAIL_COLOUR, round(float(alpha), 2)) for alpha in self.fade]
        out = [SceneEntity(id="trail", timestamp=stamp(time), frame_id=PLAY, lines=[_strip(self.path, faded)])]
        if self.gap.any():
            line = _strip(np.stack([self.gap, np.zeros(3)]), faded[-1:])
            out.append(SceneEntity(id="gap", timestamp=stamp(time), frame_id=SHUTTLE_PLACE, frame_locked=True, lines=[line]))
        return out


def _strip(path: F64, colours: list[Color]) -> LinePrimitive:
    """A line, in one colour or in one for each point."""
    return LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        pose=at((0, 0, 0)),
        thickness=3.0,
        scale_invariant=True,
        points=[point(p) for p in np.round(path, 3)],
        color=colours[-1],
        colors=colours if len(colours) > 1 else [],
    )


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
