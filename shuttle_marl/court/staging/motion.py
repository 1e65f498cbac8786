"""Staged rally: path of the shuttle and bones of both players, and its packed binary form."""

import dataclasses
import functools
import json
import zlib
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F32, F64, I64, Bools, Floats
from shuttle_marl.court.staging.body import Course, PlayerMotion
from shuttle_marl.court.staging.geometry import apply, matrix, quaternion
from shuttle_marl.court.staging.poses import MOTIONS
from shuttle_marl.court.staging.skeleton import BONE, N_BONES, SWEET_SPOT, Skeleton, StagingError
from shuttle_marl.court.staging.trajectory import ENDS, Trajectory
from shuttle_marl.game.court import Hands
from shuttle_marl.game.rules import OUTCOMES

_MAGIC: Final = b"SMOT\x02"
_SCALE: Final = ((1 << 14) - 1) * np.sqrt(2)  # steps of a component of a quaternion
_HIPS_STEP, _SHUTTLE_STEP = 2.5e-4, 5e-4  # steps of the places of the hips, and of the shuttle outside flights [m]
_OTHERS: Final = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


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
        players: state of both players for :func:`~shuttle_marl.court.staging.continue_motion`.
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
    players: tuple[PlayerMotion, PlayerMotion] = dataclasses.field(repr=False)

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
        frames, rally = len(self.time), self.trajectory.rally
        if not 0 <= first < frames:
            raise StagingError(f"first frame {first}: this motion has frames 0 to {frames - 1}")
        strokes = [self._stroke(i) for i in range(len(rally))]
        head = {
            "fps": self.fps,
            "first": first,
            "frames": frames - first,
            "players": [{"athlete": self.skeletons[seat].name, "hand": self.hands[seat]} for seat in (0, 1)],
            "server": rally.server,
            "points": list(rally.points),
            "ends_changed": rally.ends_changed,
            "ending": OUTCOMES[rally.ending],
            "before": [_short(place) for place in self.trajectory.before],
            "strokes": strokes,
        }
        about = json.dumps(head, ensure_ascii=True, separators=(",", ":"), allow_nan=False).encode()
        parts = [len(about).to_bytes(4, "little"), about]
        for seat in (0, 1):
            parts.append(_deltas(np.rint(self.position[first:, seat, 0].astype(np.float64) / _HIPS_STEP)))
            largest, rest = _three(against_parents(self.rotation[first:, seat], self.parents(seat)))
            parts.append(np.diff(largest, axis=0, prepend=0).astype(np.uint8).T.tobytes())
            parts += [_deltas(np.rint(rest[:, bone] * _SCALE)) for bone in range(N_BONES)]
        parts.append((self.planted[first:].reshape(-1, 4) @ np.array([1, 2, 4, 8])).astype(np.uint8).tobytes())
        loose = np.ones(frames, dtype=bool)
        for stroke in strokes:
            loose[stroke["frame"] : stroke["end_frame"] + 1] = False
        loose[:first] = False
        parts.append(_deltas(np.rint(self.shuttle[loose].astype(np.float64) / _SHUTTLE_STEP)))
        return _MAGIC + zlib.compress(b"".join(parts), 9)

    def _stroke(self, i: int) -> dict[str, Any]:
        trajectory, rally = self.trajectory, self.trajectory.rally
        stance = trajectory.stance[i]
        start, velocity = (v[0] for v in trajectory.flight.at(i, np.array([0.0])))
        return {
            "name": rally.catalogue.names[rally.stroke[i]],
            "frame": round(float(trajectory.time[i]) * self.fps),
            "end": ENDS[trajectory.end[i]],
            "end_frame": round(float(trajectory.end_time[i]) * self.fps),
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


@dataclasses.dataclass(frozen=True, eq=False)
class Branch:
    """Point from which a motion continues: number of strokes struck, and last unchanged frame."""

    motion: Motion
    strokes: int
    frame: int

    def player(self, seat: int) -> PlayerMotion:
        """A player of the motion."""
        return self.motion.players[seat]

    def course(self, seat: int) -> Course:
        """Unchanged frames of a player."""
        return self.player(seat).course.part(slice(0, self.frame + 1))


def against_parents(rotation: Floats, parents: I64) -> F64:
    """``[F, 23, 4]`` rotations relative to the parent bones, from rotations relative to the rest pose."""
    turn = matrix(rotation)
    carried = np.swapaxes(turn[:, np.maximum(parents, 0)], -1, -2) @ turn
    carried[:, parents < 0] = turn[:, parents < 0]
    return quaternion(carried)


def _three(q: F64) -> tuple[I64, F64]:
    """``[F, 23]`` index of the largest component, and ``[F, 23, 3]`` the others, signed so that it is positive."""
    largest = np.abs(q).argmax(axis=-1)
    sign = np.where(np.take_along_axis(q, largest[..., None], axis=-1) < 0, -1.0, 1.0)
    return largest, np.take_along_axis(sign * q, _OTHERS[largest], axis=-1)


def _deltas(values: F64) -> bytes:
    """Columns of ``[N, k]`` whole numbers: second differences modulo 2^16, zigzag, low bytes then high bytes."""
    whole = values.astype(np.int64).astype(np.int16)
    change = np.diff(whole, 2, axis=0, prepend=np.zeros((2, whole.shape[1]), dtype=np.int16))
    zigzag = ((change << 1) ^ (change >> 15)).astype("<u2")
    return np.ascontiguousarray(zigzag.T).view(np.uint8).reshape(whole.shape[1], -1, 2).transpose(0, 2, 1).tobytes()


def _short(v: F64) -> list[float]:
    return [round(x, 6) for x in v.tolist()]
