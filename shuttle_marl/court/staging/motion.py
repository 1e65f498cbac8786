"""Staged rally: path of the shuttle and bones of both players, and its packed binary form."""

import dataclasses
import functools
import json
import zlib
from collections.abc import Sequence
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F32, F64, I64, Bools, Floats, Ints
from shuttle_marl.court.staging.body import Course, PlayerMotion
from shuttle_marl.court.staging.flight import Flights, fall
from shuttle_marl.court.staging.motions import MOTIONS, Stance
from shuttle_marl.court.staging.rotation import apply, matrix, quaternion
from shuttle_marl.court.staging.skeleton import BONE, N_BONES, SWEET_SPOT, Skeleton, StagingError, load_skeleton
from shuttle_marl.court.staging.trajectory import ENDS, Trajectory
from shuttle_marl.game.court import HANDS, Hands
from shuttle_marl.game.rally import Rally
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.stroke import Catalogue, UnknownStrokeError

MAGIC: Final = b"SMOT"
VERSION: Final = 2
BITS: Final = 15
"""Bits of each component of a quaternion."""
HIPS_STEP: Final = 2.5e-4
"""Step of the places of the hips [m]."""
SHUTTLE_STEP: Final = 5e-4
"""Step of the places of the shuttle outside flights [m]."""
_OTHERS: Final = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
_LARGEST: Final = 1 << 26
"""Maximum size of an inflated motion in bytes: about an hour."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Frames:
    """Numbers packed for every frame: F frames, two players.

    Attributes:
        hips: ``[F, 2, 3]`` positions of the hips [m].
        local: ``[F, 2, 23, 4]`` quaternions (x, y, z, w) of the bones against their parents.
        planted: ``[F, 2, 2]`` whether the left and the right foot of each player stand.
        loose: ``[L, 3]`` positions of the shuttle in frames outside its flights [m].
    """

    hips: F64
    local: F64
    planted: Bools
    loose: F64


def write(head: dict[str, Any], frames: Frames) -> bytes:
    """Pack a motion."""
    about = json.dumps(head, ensure_ascii=True, separators=(",", ":"), allow_nan=False).encode()
    parts = [len(about).to_bytes(4, "little"), about]
    scale = ((1 << (BITS - 1)) - 1) * np.sqrt(2)
    for seat in (0, 1):
        parts.append(_deltas(np.rint(frames.hips[:, seat] / HIPS_STEP)))
        largest, rest = _three(frames.local[:, seat])
        parts.append(np.diff(largest, axis=0, prepend=0).astype(np.uint8).T.tobytes())
        parts += [_deltas(np.rint(rest[:, bone] * scale)) for bone in range(N_BONES)]
    parts.append((frames.planted.reshape(-1, 4) @ np.array([1, 2, 4, 8])).astype(np.uint8).tobytes())
    parts.append(_deltas(np.rint(frames.loose / SHUTTLE_STEP)))
    return MAGIC + bytes([VERSION]) + zlib.compress(b"".join(parts), 9)


def read_head(content: bytes) -> tuple[dict[str, Any], memoryview]:
    """Header of a packed motion, and the remaining bytes.

    Raises:
        StagingError: not a packed motion, of another version, cut off or damaged.
    """
    if content[:4] != MAGIC:
        raise StagingError("no packed motion: its first bytes are not SMOT; expected what Motion.pack() returned")
    if content[4:5] != bytes([VERSION]):
        raise StagingError(f"a packed motion of version {content[4:5].hex() or 'none'}: expected {VERSION}; pack it again")
    inflate = zlib.decompressobj()
    try:
        data = inflate.decompress(content[5:], _LARGEST)
        if not inflate.eof:
            raise StagingError("a packed motion is cut off, or too long to be one; take another copy")
        size = int.from_bytes(data[:4], "little")
        head = msgspec.json.decode(data[4 : 4 + size], type=dict[str, Any])
    except (zlib.error, msgspec.MsgspecError) as error:
        raise StagingError(f"a packed motion is damaged: {error}; take another copy") from error
    return head, memoryview(data)[4 + size :]


def read_frames(data: memoryview, count: int, loose: int) -> Frames:
    """The frames of a packed motion.

    Args:
        data: bytes after the header.
        loose: number of frames without a flight.

    Raises:
        StagingError: the wrong number of bytes.
    """
    expected = count * (2 * (6 + 7 * N_BONES) + 1) + 6 * loose
    if len(data) != expected:
        raise StagingError(f"a packed motion is damaged: {len(data)} bytes of frames, expected {expected}; take another copy")
    at = 0

    def block(size: int) -> memoryview:
        nonlocal at
        at += size
        return data[at - size : at]

    hips, local = np.empty((count, 2, 3)), np.empty((count, 2, N_BONES, 4))
    scale = ((1 << (BITS - 1)) - 1) * np.sqrt(2)
    for seat in (0, 1):
        hips[:, seat] = HIPS_STEP * _summed(block(6 * count), count)
        changes = np.frombuffer(block(N_BONES * count), dtype=np.uint8).reshape(N_BONES, count)
        largest = np.cumsum(changes, axis=1, dtype=np.uint8).T & 3
        rest = np.stack([_summed(block(6 * count), count) for _ in range(N_BONES)], axis=1) / scale
        local[:, seat] = _four(largest, rest)
    planted = np.frombuffer(block(count), dtype=np.uint8)[:, None] >> np.arange(4) & 1
    return Frames(
        hips=hips,
        local=local,
        planted=planted.astype(bool).reshape(count, 2, 2),
        loose=SHUTTLE_STEP * _summed(block(6 * loose), loose),
    )


def against_parents(rotation: Floats, parents: I64) -> F64:
    """``[F, 23, 4]`` rotations relative to the parent bones, from rotations relative to the rest pose."""
    turn = matrix(rotation)
    carried = np.swapaxes(turn[:, np.maximum(parents, 0)], -1, -2) @ turn
    carried[:, parents < 0] = turn[:, parents < 0]
    return quaternion(carried)


def from_parents(hips: F64, local: F64, parents: I64, rest: F64) -> tuple[F64, F64]:
    """Forward kinematics.

    Args:
        hips: ``[F, 3]`` positions of the hips [m].
        local: ``[F, 23, 4]`` quaternions against the parent bones.
        parents: ``[23]`` parent of every bone, -1 for the hips, parents before children but for the racket.
        rest: ``[23, 3]`` start of every bone at rest [m].

    Returns:
        ``[F, 23, 4]`` rotations relative to the rest pose, and ``[F, 23, 3]`` positions [m].
    """
    own = matrix(local)
    turn, place = np.empty_like(own), np.empty((len(own), N_BONES, 3))
    for bone, parent in enumerate(parents):
        if parent < 0:
            turn[:, bone], place[:, bone] = own[:, bone], hips
        else:
            turn[:, bone] = turn[:, parent] @ own[:, bone]
            place[:, bone] = place[:, parent] + apply(turn[:, parent], rest[bone] - rest[parent])
    return quaternion(turn), place


def _three(q: F64) -> tuple[I64, F64]:
    """``[F, 23]`` index of the largest component, and ``[F, 23, 3]`` the others, signed so that it is positive."""
    largest = np.abs(q).argmax(axis=-1)
    sign = np.where(np.take_along_axis(q, largest[..., None], axis=-1) < 0, -1.0, 1.0)
    return largest, np.take_along_axis(sign * q, _OTHERS[largest], axis=-1)


def _four(largest: Ints, rest: F64) -> F64:
    q = np.empty((*rest.shape[:-1], 4))
    np.put_along_axis(q, _OTHERS[largest], rest, axis=-1)
    missing = np.sqrt(np.maximum(1 - (rest**2).sum(axis=-1, keepdims=True), 0.0))
    np.put_along_axis(q, largest[..., None].astype(np.int64), missing, axis=-1)
    return q


def _deltas(values: F64) -> bytes:
    """Columns of ``[N, k]`` whole numbers: second differences modulo 2^16, zigzag, low bytes then high bytes."""
    whole = values.astype(np.int64).astype(np.int16)
    change = np.diff(whole, 2, axis=0, prepend=np.zeros((2, whole.shape[1]), dtype=np.int16))
    zigzag = ((change << 1) ^ (change >> 15)).astype("<u2")
    return np.ascontiguousarray(zigzag.T).view(np.uint8).reshape(whole.shape[1], -1, 2).transpose(0, 2, 1).tobytes()


def _summed(data: memoryview, n: int) -> F64:
    """``[n, 3]`` inverse of :func:`_deltas`."""
    planes = np.frombuffer(data, dtype=np.uint8).reshape(3, 2, n).astype(np.uint16)
    zigzag = planes[:, 0] | (planes[:, 1] << np.uint16(8))
    change = (zigzag >> np.uint16(1)).astype(np.int16) ^ -(zigzag & np.uint16(1)).astype(np.int16)
    whole = np.cumsum(np.cumsum(change, axis=1, dtype=np.int16), axis=1, dtype=np.int16)
    return whole.T.astype(np.float64)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """A rally as motion: F frames, two players, 23 bones. Metres, seconds; the frame of the court.

    The origin lies on the floor under the middle of the net, x along the net, y along the court, z up. Seat 0 plays from
    y < 0 and looks towards +y, seat 1 from y > 0, unless they have changed ends. A bone's rotation is relative to the rest pose
    of its skeleton, in which all bones are aligned with the axes and the athlete looks towards +y; so a vertex ``v`` of the
    rest pose on bone ``b`` is at ``rotation[b] (v - rest[b]) + position[b]``.

    Attributes:
        time: ``[F]`` since the start [s].
        shuttle: ``[F, 3]`` position of the shuttle.
        shuttle_velocity: ``[F, 3]`` [m/s].
        rotation: ``[F, 2, 23, 4]`` quaternions (x, y, z, w).
        position: ``[F, 2, 23, 3]`` where each bone begins.
        planted: ``[F, 2, 2]`` whether the left and the right foot of each player stand.
        contact_frame: ``[n]`` frame in which each stroke is struck.
        players: state of both players for :func:`~shuttle_marl.court.staging.continue_motion`; None in an unpacked motion.
    """

    fps: int
    time: F64
    shuttle: F32
    shuttle_velocity: F32
    rotation: F32
    position: F32
    planted: Bools
    contact_frame: I64
    skeletons: tuple[Skeleton, Skeleton]
    trajectory: Trajectory
    players: tuple[PlayerMotion, PlayerMotion] | None = dataclasses.field(default=None, repr=False)

    @property
    def hands(self) -> Hands:
        """``right`` or ``left``, of seats 0 and 1."""
        return self.trajectory.rally.hands

    @functools.cached_property
    def sweet_spot(self) -> F64:
        """``[F, 2, 3]`` the middle of the strings of both rackets."""
        racket = BONE["Racket"]
        axis = np.stack([self.racket(seat)[0] for seat in (0, 1)])
        turn = matrix(self.rotation[:, :, racket])
        return self.position[:, :, racket] + SWEET_SPOT * apply(turn, np.broadcast_to(axis, (*turn.shape[:2], 3)))

    def parents(self, seat: int) -> I64:
        """``[23]`` parent of every bone of a player, -1 for the hips."""
        return self.skeletons[seat].parents(right_handed=self.hands[seat] == "right")

    def rest(self, seat: int) -> F64:
        """``[23, 3]`` start of every bone of a player at rest [m]."""
        return self.skeletons[seat].rest_pose(right_handed=self.hands[seat] == "right")

    def racket(self, seat: int) -> tuple[F64, F64]:
        """Shaft and forehand side of the strings of a player's racket at rest, ``[3]`` each."""
        return self.skeletons[seat].racket(right_handed=self.hands[seat] == "right")

    def pack(self, first: int = 0) -> bytes:
        """Pack the motion; ``docs/motion_format.md`` describes the format.

        Args:
            first: first packed frame; the reader has the previous frames.

        Raises:
            StagingError: the frame does not exist.
        """
        frames = len(self.time)
        if not 0 <= first < frames:
            raise StagingError(f"first frame {first}: this motion has frames 0 to {frames - 1}")
        trajectory, rally = self.trajectory, self.trajectory.rally
        rows = slice(first, None)
        local = [against_parents(self.rotation[rows, seat], self.parents(seat)) for seat in (0, 1)]
        strokes = [_stroke(trajectory, i, self.fps) for i in range(len(rally))]
        head = {
            "fps": self.fps,
            "first": first,
            "frames": frames - first,
            "players": [{"athlete": self.skeletons[seat].name, "hand": self.hands[seat]} for seat in (0, 1)],
            "server": rally.server,
            "points": list(rally.points),
            "ends_changed": rally.ends_changed,
            "ending": OUTCOMES[rally.ending],
            "before": [_short(place) for place in trajectory.before],
            "strokes": strokes,
        }
        kept = Frames(
            hips=self.position[rows, :, 0].astype(np.float64),
            local=np.stack(local, axis=1),
            planted=self.planted[rows],
            loose=self.shuttle[rows][~_flying(strokes, first, frames)].astype(np.float64),
        )
        return write(head, kept)

    @classmethod
    def unpack(cls, content: bytes, before: "Motion | None" = None) -> "Motion":
        """Unpack a motion; its catalogue has only the strokes of this rally.

        Args:
            content: result of :meth:`pack`.
            before: motion with the frames before the first packed one, if that is not frame 0.

        Raises:
            StagingError: not a packed motion, damaged, or ``before`` is missing.
        """
        head, data = read_head(content)
        try:
            return _unpacked(head, data, before)
        except (LookupError, AttributeError, TypeError, ValueError, OverflowError, UnknownStrokeError) as error:
            raise StagingError(f"a packed motion is damaged: {error!r} in its head; take another copy") from error


@dataclasses.dataclass(frozen=True, eq=False)
class Branch:
    """Branch of a continued motion: the motion, number of strokes struck, and last unchanged frame."""

    motion: Motion
    strokes: int
    frame: int

    def player(self, seat: int) -> PlayerMotion:
        """A player of the motion."""
        assert self.motion.players is not None
        return self.motion.players[seat]

    def course(self, seat: int) -> Course:
        """Unchanged frames of a player."""
        return self.player(seat).course.part(slice(0, self.frame + 1))


def _stroke(trajectory: Trajectory, i: int, fps: int) -> dict[str, Any]:
    rally, stance = trajectory.rally, trajectory.stance[i]
    start, velocity = (v[0] for v in trajectory.flight.at(i, np.array([0.0])))
    return {
        "name": rally.catalogue.names[rally.stroke[i]],
        "frame": round(float(trajectory.time[i]) * fps),
        "end": ENDS[trajectory.end[i]],
        "end_frame": round(float(trajectory.end_time[i]) * fps),
        "start": _short(start),
        "velocity": _short(velocity),
        "chosen": _short(trajectory.chosen_point[i]),
        "motion": MOTIONS[stance.motion],
        "heading": round(stance.heading, 6),
        "root": _short(stance.root),
        "reach": round(stance.reach, 6),
        "hurried": bool(rally.hurried[i]),
        "base": [_short(place) for place in trajectory.base[i]],
    }


def _short(v: F64) -> list[float]:
    return [round(x, 6) for x in v.tolist()]


def _flying(strokes: Sequence[dict[str, Any]], first: int, end: int) -> Bools:
    """``[end - first]`` whether the shuttle is in a flight."""
    out = np.zeros(end, dtype=bool)
    for stroke in strokes:
        out[stroke["frame"] : stroke["end_frame"] + 1] = True
    return out[first:]


def _unpacked(head: dict[str, Any], data: memoryview, before: Motion | None) -> Motion:
    fps, first, count, strokes = head["fps"], head["first"], head["frames"], head["strokes"]
    numbers = [fps, first, count, *(stroke[name] for stroke in strokes for name in ("frame", "end_frame"))]
    if any(not isinstance(number, int) or not 0 <= number < 1 << 24 for number in numbers) or not 25 <= fps <= 1000 or not count:
        raise ValueError("frame numbers out of range")
    if first and (before is None or len(before.time) < first or before.fps != fps):
        raise StagingError(f"these frames begin at {first}: give the motion that has the {first} before them, at {fps} a second")
    frames = first + count
    flying = _flying(strokes, first, frames)
    found = read_frames(data, count, int(np.count_nonzero(~flying)))
    players = head["players"]
    skeletons = (load_skeleton(players[0]["athlete"]), load_skeleton(players[1]["athlete"]))
    trajectory = _trajectory(head)
    rotation, position = np.empty((count, 2, N_BONES, 4), np.float32), np.empty((count, 2, N_BONES, 3), np.float32)
    for seat in (0, 1):
        right, skeleton = trajectory.rally.hands[seat] == "right", skeletons[seat]
        rest, parents = skeleton.rest_pose(right_handed=right), skeleton.parents(right_handed=right)
        turn, place = from_parents(found.hips[:, seat], found.local[:, seat], parents, rest)
        rotation[:, seat], position[:, seat] = turn, place
    shuttle, velocity = np.empty((count, 3)), np.empty((count, 3))
    shuttle[~flying] = found.loose
    for i, stroke in enumerate(strokes):
        rows = np.arange(max(stroke["frame"], first), min(stroke["end_frame"] + 1, frames))
        shuttle[rows - first], velocity[rows - first] = trajectory.flight.at(i, rows / fps - trajectory.time[i])
    drift = np.gradient(shuttle, 1 / fps, axis=0) if count > 1 else np.zeros_like(shuttle)
    velocity[~flying] = drift[~flying]

    def whole(name: str, now: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return np.concatenate([getattr(before, name)[:first], now.astype(getattr(before, name).dtype)]) if first else now

    return Motion(
        fps=fps,
        time=np.arange(frames) / fps,
        shuttle=whole("shuttle", shuttle.astype(np.float32)),
        shuttle_velocity=whole("shuttle_velocity", velocity.astype(np.float32)),
        rotation=whole("rotation", rotation),
        position=whole("position", position),
        planted=whole("planted", found.planted),
        contact_frame=np.array([stroke["frame"] for stroke in strokes], dtype=np.int64),
        skeletons=skeletons,
        trajectory=trajectory,
    )


def _trajectory(head: dict[str, Any]) -> Trajectory:
    strokes, fps = head["strokes"], head["fps"]
    names = [stroke["name"] for stroke in strokes]
    catalogue = Catalogue.from_names(dict.fromkeys(names))
    hands = (str(head["players"][0]["hand"]), str(head["players"][1]["hand"]))
    if not set(hands) <= set(HANDS):
        raise ValueError(f"hands {hands}")
    rally = Rally(
        catalogue=catalogue,
        server=int(head["server"]),
        stroke=np.array([catalogue.index(name) for name in names], dtype=np.int64),
        hurried=np.array([bool(stroke.get("hurried")) for stroke in strokes], dtype=np.bool_),
        ending=OUTCOMES.index(head["ending"]),
        points=(int(head["points"][0]), int(head["points"][1])),
        ends_changed=bool(head["ends_changed"]),
        hands=hands,
    )

    def column(name: str, shape: tuple[int, ...]) -> F64:
        return np.array([stroke[name] for stroke in strokes], dtype=np.float64).reshape(-1, *shape)

    time, end_time = column("frame", ()) / fps, column("end_frame", ()) / fps
    start = column("start", (3,))
    flight: Flights = fall(start, column("velocity", (3,)), end_time - time)
    last = flight.along[:, -1:] * flight.heading
    return Trajectory(
        rally=rally,
        time=time,
        contact=start,
        end=np.array([ENDS.index(stroke["end"]) for stroke in strokes], dtype=np.int64),
        end_time=end_time,
        chosen_point=column("chosen", (3,)),
        end_point=np.column_stack([start[:, :2] + last, start[:, 2] + flight.rise[:, -1]]),
        flight=flight,
        stance=tuple(
            Stance(
                motion=MOTIONS.index(stroke["motion"]),
                heading=float(stroke["heading"]),
                root=np.array(stroke["root"], dtype=np.float64),
                reach=float(stroke["reach"]),
            )
            for stroke in strokes
        ),
        base=column("base", (2, 2)),
        before=np.array(head["before"], dtype=np.float64).reshape(2, 2),
    )
