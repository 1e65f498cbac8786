"""Staged rally: path of the shuttle, bones of both players, and the packed form."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.arrays import F32, F64, I64, Bools
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.stroke import Catalogue, UnknownStrokeError
from shuttle_marl.rally.record import Rally
from shuttle_marl.staging import packing
from shuttle_marl.staging.body import Player
from shuttle_marl.staging.flight import Flights, fall
from shuttle_marl.staging.motions import MOTIONS, Stance
from shuttle_marl.staging.rotation import apply, matrix
from shuttle_marl.staging.skeleton import BONE, N_BONES, SWEET_SPOT, Skeleton, StagingError, load_skeleton
from shuttle_marl.staging.trajectory import ENDS, Trajectory

HANDS: Final = ("right", "left")
"""Values of the handedness of a player."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """A rally as motion: F frames, two players, 23 bones. Metres, seconds; the frame of the court.

    The origin lies on the floor under the middle of the net, x along the net, y along the court, z up. Seat 0 plays from
    y < 0 and looks towards +y, seat 1 from y > 0. A bone's rotation is relative to the rest pose of its
    skeleton, in which all bones are aligned with the axes and the athlete looks towards +y; so a vertex ``v`` of the rest
    pose on bone ``b`` is at ``rotation[b] (v - rest[b]) + position[b]``.

    Attributes:
        fps: frames a second.
        time: ``[F]`` since the start [s].
        shuttle: ``[F, 3]`` position of the shuttle.
        shuttle_velocity: ``[F, 3]`` [m/s].
        rotation: ``[F, 2, 23, 4]`` quaternions (x, y, z, w).
        position: ``[F, 2, 23, 3]`` where each bone begins.
        planted: ``[F, 2, 2]`` whether the left and the right foot of each player stand.
        contact_frame: ``[n]`` frame in which each stroke is struck.
        skeletons: of seats 0 and 1.
        handedness: ``right`` or ``left``, of seats 0 and 1.
        trajectory: points, times and flights.
        players: state of both players for :func:`~shuttle_marl.staging.continue_motion`; None in an unpacked motion.
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
    handedness: tuple[str, str]
    trajectory: Trajectory
    players: tuple[Player, Player] | None = dataclasses.field(default=None, repr=False)

    @functools.cached_property
    def sweet_spot(self) -> F64:
        """``[F, 2, 3]`` the middle of the strings of both rackets."""
        racket = BONE["Racket"]
        axis = np.stack([self.racket(seat)[0] for seat in (0, 1)])
        turn = matrix(self.rotation[:, :, racket])
        return self.position[:, :, racket] + SWEET_SPOT * apply(turn, np.broadcast_to(axis, (*turn.shape[:2], 3)))

    def parents(self, seat: int) -> I64:
        """``[23]`` parent of every bone of a player, -1 for the hips."""
        return self.skeletons[seat].parents(right_handed=self.handedness[seat] == "right")

    def rest(self, seat: int) -> F64:
        """``[23, 3]`` start of every bone of a player at rest [m]."""
        return self.skeletons[seat].rest_pose(right_handed=self.handedness[seat] == "right")

    def racket(self, seat: int) -> tuple[F64, F64]:
        """Shaft and forehand side of the strings of a player's racket at rest, ``[3]`` each."""
        return self.skeletons[seat].racket(right_handed=self.handedness[seat] == "right")

    def pack(self, first: int = 0) -> bytes:
        """Pack the motion; ``docs/motion_format.md`` describes the format.

        Args:
            first: first packed frame; the reader has the previous frames.

        Raises:
            StagingError: there is no such frame.
        """
        frames = len(self.time)
        if not 0 <= first < frames:
            raise StagingError(f"first frame {first}: this motion has frames 0 to {frames - 1}")
        trajectory, rally = self.trajectory, self.trajectory.rally
        rows = slice(first, None)
        local = [packing.against_parents(self.rotation[rows, seat], self.parents(seat)) for seat in (0, 1)]
        strokes = [_stroke(trajectory, i, self.fps) for i in range(len(rally))]
        head = {
            "fps": self.fps,
            "first": first,
            "frames": frames - first,
            "players": [{"athlete": self.skeletons[seat].name, "hand": self.handedness[seat]} for seat in (0, 1)],
            "server": rally.server,
            "ending": OUTCOMES[rally.ending],
            "before": [_short(place) for place in trajectory.before],
            "strokes": strokes,
        }
        kept = packing.Frames(
            hips=self.position[rows, :, 0].astype(np.float64),
            local=np.stack(local, axis=1),
            planted=self.planted[rows],
            loose=self.shuttle[rows][~_flying(strokes, first, frames)].astype(np.float64),
        )
        return packing.write(head, kept)

    @classmethod
    def unpack(cls, content: bytes, before: "Motion | None" = None) -> "Motion":
        """Unpack a motion; its catalogue has only the strokes of this rally.

        Args:
            content: result of :meth:`pack`.
            before: motion with the frames before the first packed one, if that is not frame 0.

        Raises:
            StagingError: not a packed motion, damaged, or ``before`` is missing.
        """
        head, data = packing.read_head(content)
        try:
            return _unpacked(head, data, before)
        except (LookupError, AttributeError, TypeError, ValueError, OverflowError, UnknownStrokeError) as error:
            raise StagingError(f"a packed motion is damaged: {error!r} in its head; take another copy") from error


def _stroke(trajectory: Trajectory, i: int, fps: int) -> dict[str, Any]:
    """A stroke in the head of a packed motion."""
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
    found = packing.read_frames(data, count, int(np.count_nonzero(~flying)))
    players = head["players"]
    skeletons = (load_skeleton(players[0]["athlete"]), load_skeleton(players[1]["athlete"]))
    hands = (str(players[0]["hand"]), str(players[1]["hand"]))
    if not set(hands) <= set(HANDS):
        raise ValueError(f"hands {hands}")
    rotation, position = np.empty((count, 2, N_BONES, 4), np.float32), np.empty((count, 2, N_BONES, 3), np.float32)
    for seat in (0, 1):
        right, skeleton = hands[seat] == "right", skeletons[seat]
        rest, parents = skeleton.rest_pose(right_handed=right), skeleton.parents(right_handed=right)
        turn, place = packing.from_parents(found.hips[:, seat], found.local[:, seat], parents, rest)
        rotation[:, seat], position[:, seat] = turn, place
    trajectory = _trajectory(head)
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
        handedness=hands,
        trajectory=trajectory,
    )


def _trajectory(head: dict[str, Any]) -> Trajectory:
    strokes, fps = head["strokes"], head["fps"]
    names = [stroke["name"] for stroke in strokes]
    catalogue = Catalogue.from_names(dict.fromkeys(names))
    rally = Rally(
        catalogue=catalogue,
        server=int(head["server"]),
        stroke=np.array([catalogue.index(name) for name in names], dtype=np.int64),
        ending=OUTCOMES.index(head["ending"]),
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
