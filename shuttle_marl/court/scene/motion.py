"""Everything that moves in a scene: frames of reference of bones and shuttle, the shuttle's trail, and states."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from foxglove.messages import FrameTransform, FrameTransforms, Quaternion

from shuttle_marl.base.arrays import F64, I64, Floats, Intp
from shuttle_marl.court.scene import topics
from shuttle_marl.court.scene.rally_report import StagedRally
from shuttle_marl.court.scene.topics import SHUTTLE_FLOOR, SHUTTLE_FRAME, Timed, bone_frame, entities_on, numbers_on, place_frame
from shuttle_marl.court.staging import Motion
from shuttle_marl.court.staging.geometry import cross, quaternion, unit
from shuttle_marl.court.staging.skeleton import BONE

_GRID: Final = 2.0**13  # numbers are rounded to 1/8192: 0.12 mm and 0.014 degrees, and compress to a third
_TOLERANCE: Final = 0.006
"""Largest distance from a transform that viewers interpolate to one that is left out [m or half radians]."""
_PACKET: Final = 1.0  # time covered by one message of transforms [s]
_TRAIL, _TRAIL_STEP = 0.48, 0.08  # length of the trail of the shuttle, and time between its points [s]


def motion_messages(staged: StagedRally) -> Iterator[Timed]:
    """Messages of everything that moves in a rally, each topic in the order of time."""
    yield from _transforms(staged)
    yield from _trail(staged)
    yield from _states(staged)


def _transforms(staged: StagedRally) -> Iterator[Timed]:
    """Transforms of all frames of reference, one message for each :data:`_PACKET`: one message is enough after a seek."""
    motion = staged.motion
    last, length = len(motion.time) - 1, round(_PACKET * motion.fps)
    when = [topics.stamp(staged.at(seconds)) for seconds in motion.time.tolist()]
    frames = {name: (values, _needed(values, motion.contact_frame, length)) for name, values in frames_of(motion).items()}
    for first in range(0, last, length):
        until, transforms = min(first + length, last), []
        for name, (values, needed) in frames.items():
            chosen = needed[(needed >= first) & (needed <= until)]
            if until < last and (values[chosen] == values[first]).all():
                chosen = chosen[:1]  # enough for a frame at rest, unless the rally ends here
            for i, (x, y, z, *q) in zip(chosen.tolist(), values[chosen].tolist(), strict=True):
                about: dict[str, Any] = {"timestamp": when[i], "parent_frame_id": topics.WORLD, "child_frame_id": name}
                turn = Quaternion(x=q[0], y=q[1], z=q[2], w=q[3])
                transforms.append(FrameTransform(**about, translation=topics.vector((x, y, z)), rotation=turn))
        yield staged.at(float(motion.time[first])), topics.TF, FrameTransforms(transforms=transforms)


def _needed(values: F64, exact: I64, packet: int) -> Intp:
    """Instants that are written: viewers interpolate between them. Halves of eighths of the frames, where they are needed."""
    chosen = np.zeros(len(values), dtype=np.bool_)
    chosen[::8] = chosen[::packet] = chosen[exact] = chosen[-1] = True
    for half in (4, 2, 1):
        between = np.arange(half, len(values) - half, 2 * half)
        off = np.abs(values[between] - (values[between - half] + values[between + half]) / 2).max(axis=1)
        chosen[between] |= off > _TOLERANCE
    return np.flatnonzero(chosen)


def frames_of(motion: Motion) -> dict[str, F64]:
    """Frames of reference on the court by name: ``[F, 7]`` place [m] and quaternion (x, y, z, w) at each instant."""
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    half_turn = np.array([0.0, 0.0, 1.0, 0.0]) if motion.trajectory.rally.ends_changed else upright
    out = {SHUTTLE_FRAME: _joined(motion.shuttle, _heading(motion)), SHUTTLE_FLOOR: _joined(motion.shuttle * [1, 1, 0], upright)}
    for seat in (0, 1):
        out[place_frame(seat)] = _joined(motion.position[:, seat, 0] * [1, 1, 0], half_turn)
        for bone in topics.DRAWN:
            out[bone_frame(seat, bone)] = _joined(*(part[:, seat, BONE[bone]] for part in (motion.position, motion.rotation)))
    return out


def _joined(place: Floats, turn: Floats) -> F64:
    joined = np.concatenate([place, np.broadcast_to(turn, (len(place), 4))], axis=1, dtype=np.float64)
    return np.rint(joined * _GRID) / _GRID


def _heading(motion: Motion) -> F64:
    """``[F, 4]`` rotation of the shuttle: the cork points forward, in the hand down; on the floor it lies."""
    velocity = motion.shuttle_velocity.astype(np.float64)
    flies = np.linalg.norm(velocity, axis=1) > 0.3
    flies[: motion.contact_frame[0]] = False
    # A shuttle that stops keeps its last direction.
    last = np.maximum.accumulate(np.where(flies, np.arange(len(flies)), -1))
    heading = np.where(last[:, None] < 0, np.array([0.0, 0.0, -1.0]), unit(velocity[last]))
    ended = round(float(motion.trajectory.end_time[-1]) * motion.fps)
    heading[ended:] = unit(heading[ended:] * [1, 1, 0] + [1e-6, 0, 0])
    up = np.where(np.abs(heading[:, 2:]) < 0.95, np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]]))
    x = unit(cross(up, heading))
    return quaternion(np.stack([x, cross(heading, x), heading], axis=-1))


def _trail(staged: StagedRally) -> Iterator[Timed]:
    motion, contacts = staged.motion, staged.motion.contact_frame
    step, length = max(1, round(_TRAIL_STEP * motion.fps)), round(_TRAIL * motion.fps)
    was_visible = True
    for frame in range(len(motion.time)):
        time = staged.at(float(motion.time[frame]))
        first = max(frame - length, int(contacts[0]))
        rows = np.union1d(np.arange(frame, first - 1, -step), contacts[(contacts >= first) & (contacts <= frame)])
        path = motion.shuttle[rows].astype(np.float64)
        # A shuttle at rest has no trail.
        visible = len(path) > 1 and float(np.ptp(path, axis=0).max()) > 0.05
        if visible:
            fade = np.round(0.95 * np.clip(1 - (frame - rows) / length, 0, 1), 2)
            line = topics.strip(path, [topics.colour(1.0, 0.85, 0.25, alpha) for alpha in fade.tolist()], 3.0)
            yield entities_on(topics.SHUTTLE, time, [topics.entity("trail", time, lines=[line])])
        elif was_visible:
            yield entities_on(topics.SHUTTLE, time, [])
        was_visible = visible


def _states(staged: StagedRally) -> Iterator[Timed]:
    report, motion, trajectory = staged.report, staged.motion, staged.motion.trajectory
    hips = motion.position[:, :, 0, :2].astype(np.float64)
    speed = np.linalg.norm(np.gradient(hips, 1 / motion.fps, axis=0), axis=2)
    shuttle_speed = np.linalg.norm(motion.shuttle_velocity, axis=1)
    last_stroke = np.searchsorted(motion.contact_frame, np.arange(len(motion.time)), side="right") - 1
    # Every second frame, and the last one, so that the recording is as long as the motion.
    for frame in [*range(0, len(motion.time) - 1, 2), len(motion.time) - 1]:
        seconds, stroke = float(motion.time[frame]), int(last_stroke[frame])
        if stroke < 0:
            phase = "before the serve"
        elif seconds > float(trajectory.end_time[-1]):
            phase = "over"
        else:
            phase = f"{report.names[report.played.striker[stroke]]} struck"
        x, y, z = (round(float(v), 3) for v in motion.shuttle[frame])
        shuttle_state = {"x": x, "y": y, "z": z, "speed": round(float(shuttle_speed[frame]), 2)}
        content: dict[str, Any] = {"phase": phase, "shuttle": shuttle_state}
        for seat in (0, 1):
            px, py = (round(float(v), 3) for v in hips[frame, seat])
            content[f"player_{seat}"] = {"x": px, "y": py, "speed": round(float(speed[frame, seat]), 2)}
        yield numbers_on(topics.STATE, staged.at(seconds), content)
