"""Everything that moves in a scene: frames of reference of bones and shuttle, the shuttle's trail, and states.

Viewers interpolate between transforms, so a transform is written only at the instants between which interpolation keeps the far
end of every limb within :data:`TOLERANCE`.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from foxglove.messages import FrameTransforms, SceneEntity

from shuttle_marl.base.arrays import F64, I64, Bools, Floats, Intp
from shuttle_marl.base.compiling import compiled
from shuttle_marl.scene import topics
from shuttle_marl.scene.rally_report import StagedRally
from shuttle_marl.scene.topics import (
    PLAY,
    SHADOWS,
    SHUTTLE_FRAME,
    SHUTTLE_PLACE,
    WORLD,
    Timed,
    bone_frame,
    colour,
    entities_on,
    joint_frame,
    name_frame,
    numbers_on,
    place_frame,
    stamp,
    strip,
    transform,
)
from shuttle_marl.staging import BONES, RACKET_LENGTH, Motion
from shuttle_marl.staging.rotation import cross, matrix, quaternion, unit
from shuttle_marl.staging.skeleton import BONE

TOLERANCE: Final = 0.008
"""Largest error of an interpolated position, at the far end of everything attached to a joint [m]."""
_COARSE: Final = 0.02
"""The same for names and shadows [m]."""
_ABOVE_FLOOR: Final = 0.012
"""Height of shadows [m]."""
_GRID: Final = 2.0**14
"""Numbers are rounded to 1/16384: 0.06 mm and 0.007 degrees, and compress to a third."""
_NAME: Final = 0.42
"""Height of the names over the heads [m]."""
_FLIP: Final = 0.06
"""Time in which the cork turns forward after a contact [s]."""
_SHUTTLE_REACH: Final = 0.1
_LIMB_END: Final = 0.25
"""Upper bound of the distance from the last joint of a limb to its tip [m]."""
_PACKET: Final = 1.0
"""Time covered by one message of transforms [s]."""
_TRAIL: Final = 0.48
"""Length of the trail of the shuttle [s]."""
_TRAIL_STEP: Final = 0.08
"""Time between points of the trail [s]."""
_EVERY: Final = 2
"""Trail and states are written every second frame, the trail also at every frame just after a contact."""
_TRAIL_COLOUR: Final = (1.0, 0.85, 0.25)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Track:
    """A frame of reference that moves or rotates relative to its parent, at F instants.

    Attributes:
        values: ``[F, 3]`` translations [m], or ``[F, 4]`` rotations as quaternions (x, y, z, w).
        tolerance: largest error of an interpolated value [m] or [rad].
        exact: ``[F]`` instants without error.
    """

    child: str
    parent: str
    values: F64
    tolerance: float
    exact: Bools

    def instants(self, packet: int) -> Intp:
        """Instants from which the others can be interpolated; every ``packet``-th instant is included."""
        chosen = np.empty(len(self.values), dtype=np.bool_)
        choose_instants(self.values, self.tolerance, self.exact, packet, chosen)
        return np.flatnonzero(chosen)


def joint_message(time: int, motion: Motion) -> Timed:
    """Positions of the joints of both players on their parent bones, which are constant while the players stay."""
    joints = []
    for seat in (0, 1):
        rest = motion.rest(seat)
        for bone, parent in enumerate(motion.parents(seat)):
            if parent >= 0:
                place: list[float] = _rounded(rest[bone] - rest[parent]).tolist()
                joints.append(transform(stamp(time), joint_frame(seat, bone), bone_frame(seat, BONES[parent]), place))
    return time, topics.TF_STATIC, FrameTransforms(transforms=joints)


def motion_messages(staged: StagedRally) -> Iterator[Timed]:
    """Messages of everything that moves in a rally, each topic in the order of time."""
    yield from _transforms(staged)
    yield from _trail(staged)
    yield from _states(staged)


def _transforms(staged: StagedRally) -> Iterator[Timed]:
    """Transforms of all frames of reference, one message for each :data:`_PACKET`: one message is enough after a seek."""
    motion = staged.motion
    last, length = len(motion.time) - 1, round(_PACKET * motion.fps)
    when = [stamp(staged.at(seconds)) for seconds in motion.time.tolist()]
    tracks = [(track, track.instants(length)) for track in tracks_of(motion)]
    for first in range(0, last, length):
        until, transforms = min(first + length, last), []
        for track, instants in tracks:
            chosen = instants[(instants >= first) & (instants <= until)]
            values = track.values[chosen]
            if until < last and (values == values[0]).all():
                # The first is enough for a frame at rest, unless the rally ends here.
                chosen = chosen[:1]
            moves = zip(chosen.tolist(), values.tolist(), strict=False)
            transforms += [transform(when[i], track.child, track.parent, value) for i, value in moves]
        yield staged.at(float(motion.time[first])), topics.TF, FrameTransforms(transforms=transforms)


def _trail(staged: StagedRally) -> Iterator[Timed]:
    motion, contacts = staged.motion, staged.motion.contact_frame
    step, length = max(1, round(_TRAIL_STEP * motion.fps)), round(_TRAIL * motion.fps)
    just_struck = (contacts[:, None] + np.arange(_EVERY + 1)).ravel()
    frames = np.union1d(np.arange(0, len(motion.time), _EVERY), just_struck[just_struck < len(motion.time)])
    was_visible = True
    for frame in frames.tolist():
        time = staged.at(float(motion.time[frame]))
        first = max(frame - length, int(contacts[0]))
        rows = np.union1d(np.arange(frame, first - 1, -step), contacts[(contacts >= first) & (contacts <= frame)])
        path = motion.shuttle[rows].astype(np.float64)
        # A shuttle at rest has no trail.
        visible = len(path) > 1 and float(np.ptp(path, axis=0).max()) > 0.05
        if visible:
            fade = 0.95 * np.clip(1 - (frame - rows) / length, 0, 1)
            earlier = max(frame - _EVERY, int(contacts[contacts <= frame][-1]))
            gap = (motion.shuttle[earlier] - motion.shuttle[frame]).astype(np.float64)
            yield entities_on(topics.SHUTTLE, time, _trail_entities(time, path, fade, gap))
        elif was_visible:
            yield entities_on(topics.SHUTTLE, time, [])
        was_visible = visible


def _trail_entities(time: int, path: F64, fade: F64, gap: F64) -> list[SceneEntity]:
    """Path of the shuttle so far, and a line behind the shuttle that fills the gap until the next message."""
    faded = [colour(*_TRAIL_COLOUR, round(float(alpha), 2)) for alpha in fade]
    out = [SceneEntity(id="trail", timestamp=stamp(time), frame_id=WORLD, lines=[strip(path, faded, 3.0)])]
    if gap.any():
        line = strip(np.stack([gap, np.zeros(3)]), faded[-1:], 3.0)
        out.append(SceneEntity(id="gap", timestamp=stamp(time), frame_id=SHUTTLE_PLACE, frame_locked=True, lines=[line]))
    return out


def _states(staged: StagedRally) -> Iterator[Timed]:
    report, motion, trajectory = staged.report, staged.motion, staged.motion.trajectory
    hips = motion.position[:, :, 0, :2].astype(np.float64)
    speed = np.linalg.norm(np.gradient(hips, 1 / motion.fps, axis=0), axis=2)
    shuttle_speed = np.linalg.norm(motion.shuttle_velocity, axis=1)
    last_stroke = np.searchsorted(motion.contact_frame, np.arange(len(motion.time)), side="right") - 1
    # With the last frame, so that the recording is as long as the motion.
    for frame in [*range(0, len(motion.time) - 1, _EVERY), len(motion.time) - 1]:
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


def tracks_of(motion: Motion) -> list[Track]:
    """Frames of reference that move: both players with names and shadows, the shuttle."""
    frames = len(motion.time)
    never, struck = np.zeros(frames, dtype=np.bool_), np.zeros(frames, dtype=np.bool_)
    struck[motion.contact_frame] = True
    turned = np.tile([0.0, 0.0, 1.0, 0.0] if motion.trajectory.rally.ends_changed else [0.0, 0.0, 0.0, 1.0], (frames, 1))
    out = [Track(child=PLAY, parent=WORLD, values=turned, tolerance=TOLERANCE, exact=never)]
    for seat in (0, 1):
        own = never.copy()
        own[motion.contact_frame[motion.trajectory.rally.striker == seat]] = True
        out += _player(motion, seat, own)
    shuttle = _rounded(motion.shuttle)
    out += [
        Track(child=SHUTTLE_PLACE, parent=WORLD, values=shuttle, tolerance=TOLERANCE, exact=struck),
        Track(
            child=SHUTTLE_FRAME,
            parent=SHUTTLE_PLACE,
            values=_rounded(quaternion(_heading(motion))),
            tolerance=TOLERANCE / _SHUTTLE_REACH,
            exact=never,
        ),
    ]
    above = np.concatenate([motion.position[:, :, 0], shuttle[:, None]], axis=1)
    for k, name in enumerate(SHADOWS):
        below = _rounded(np.column_stack([above[:, k, :2], np.full(frames, _ABOVE_FLOOR)]))
        out.append(Track(child=name, parent=WORLD, values=below, tolerance=_COARSE, exact=never))
    return out


def _player(motion: Motion, seat: int, exact: Bools) -> list[Track]:
    """Position of the hips, rotation of every bone in its joint, and position of the name."""
    above, side = motion.parents(seat), motion.trajectory.rally.facing(0)
    turn = matrix(motion.rotation[:, seat])
    local = quaternion(np.swapaxes(turn[:, np.where(above >= 0, above, 0)], -1, -2) @ turn)
    local[:, above < 0] = quaternion(np.array([[side], [side], [1.0]]) * turn[:, above < 0])
    reach = _reach(motion.rest(seat), above)
    place, name = motion.position[:, seat, 0], motion.position[:, seat, BONE["Head"]] + np.array([0.0, 0.0, _NAME])
    return [
        Track(child=place_frame(seat), parent=PLAY, values=_rounded(place * [side, side, 1.0]), tolerance=TOLERANCE, exact=exact),
        *(
            Track(
                child=bone_frame(seat, bone),
                parent=joint_frame(seat, i) if above[i] >= 0 else place_frame(seat),
                values=_rounded(local[:, i]),
                tolerance=TOLERANCE / reach[i],
                exact=exact,
            )
            for i, bone in enumerate(BONES)
        ),
        Track(child=name_frame(seat), parent=WORLD, values=_rounded(name), tolerance=_COARSE, exact=np.zeros_like(exact)),
    ]


def _reach(rest: F64, parents: I64) -> F64:
    """``[23]`` distance from each joint to the farthest point attached to it, limbs stretched [m]."""
    reach = np.full(len(BONES), _LIMB_END)
    reach[BONE["Racket"]] = RACKET_LENGTH
    for i in reversed(range(len(BONES))):  # children come after their parents
        if parents[i] >= 0:
            reach[parents[i]] = max(reach[parents[i]], np.linalg.norm(rest[i] - rest[parents[i]]) + reach[i])
    return reach


def _rounded(values: Floats) -> F64:
    return np.rint(values.astype(np.float64) * _GRID) / _GRID


def _heading(motion: Motion) -> F64:
    """``[F, 3, 3]`` rotation of the shuttle: the cork points forward, except just after a contact."""
    velocity = motion.shuttle_velocity.astype(np.float64)
    speed = np.linalg.norm(velocity, axis=1)
    heading = np.zeros_like(velocity)
    last = np.array([0.0, 0.0, -1.0])
    for i in range(len(velocity)):
        # In the hand the cork points down; on the floor it keeps its last direction.
        if i >= motion.contact_frame[0] and speed[i] > 0.3:
            last = velocity[i] / speed[i]
        heading[i] = last
    flip = round(_FLIP * motion.fps)
    for contact in motion.contact_frame:
        before, after = heading[max(contact - 1, 0)], heading[min(contact + flip, len(heading) - 1)]
        for k in range(flip):
            if contact + k < len(heading):
                heading[contact + k] = _between(before, after, (k + 0.5) / flip)
    ended = round(float(motion.trajectory.end_time[-1]) * motion.fps)
    # A shuttle at rest lies on its side.
    flat = heading[ended:] * np.array([1.0, 1.0, 0.0])
    fraction = np.clip(np.arange(len(flat)) / (0.2 * motion.fps), 0, 1)[:, None]
    heading[ended:] = unit((1 - fraction) * heading[ended:] + fraction * unit(flat + np.array([1e-6, 0, 0])))
    up = np.where(np.abs(heading[:, 2:]) < 0.95, np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]]))
    x = unit(cross(up, heading))
    return np.stack([x, cross(heading, x), heading], axis=-1)


def _between(a: F64, b: F64, fraction: float) -> F64:
    """Direction between two unit vectors by spherical interpolation; any plane if they are opposite."""
    angle = float(np.arccos(np.clip(a @ b, -1, 1)))
    aside = b - (a @ b) * a
    if np.linalg.norm(aside) < 1e-6:
        aside = np.cross(a, [0.0, 0.0, 1.0] if abs(a[2]) < 0.9 else [1.0, 0.0, 0.0])
    aside = aside / np.linalg.norm(aside)
    out: F64 = np.cos(fraction * angle) * a + np.sin(fraction * angle) * aside
    return out


@compiled
def _distance(a: F64, b: F64, fraction: float, value: F64) -> float:
    """Distance of a value from the interpolated one: metres for translations ``[3]``, radians for quaternions ``[4]``."""
    width = len(a)
    here, there = 1 - fraction, fraction
    if width == 4:
        cosine = 0.0
        for k in range(width):
            cosine += a[k] * b[k]
        sign = 1.0 if cosine >= 0 else -1.0
        cosine = min(abs(cosine), 1.0)
        there *= sign
        if cosine < 0.9999:
            angle = np.arccos(cosine)
            here, there = np.sin((1 - fraction) * angle) / np.sin(angle), sign * np.sin(fraction * angle) / np.sin(angle)
    same, opposite = 0.0, 0.0
    for k in range(width):
        interpolated = here * a[k] + there * b[k]
        same += (interpolated - value[k]) ** 2
        opposite += (interpolated + value[k]) ** 2
    # A quaternion and its negative are the same rotation; the angle of a rotation is twice that between quaternions.
    return 2 * np.sqrt(min(same, opposite)) if width == 4 else np.sqrt(same)


@compiled
def choose_instants(values: F64, tolerance: float, exact: Bools, packet: int, chosen: Bools) -> None:
    """Choose instants between which all values can be interpolated.

    Args:
        values: ``[F, 3]`` translations or ``[F, 4]`` quaternions.
        tolerance: largest error of an interpolated value [m] or [rad].
        exact: ``[F]`` instants that are always chosen.
        packet: number of instants in a message; the first of each message is always chosen.
        chosen: ``[F]`` output.
    """
    last = len(values) - 1
    chosen[:] = False
    chosen[0] = True
    first = 0
    while first < last:
        until, following = min((first // packet + 1) * packet, last), first + 1
        while following < until and not exact[following]:
            for between in range(first + 1, following + 1):
                fraction = (between - first) / (following + 1 - first)
                if _distance(values[first], values[following + 1], fraction, values[between]) > tolerance:
                    break
            else:
                following += 1
                continue
            break
        first = following
        chosen[first] = True
