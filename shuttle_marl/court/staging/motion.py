"""From a rally to motion: path of the shuttle and bones of both players, its packed binary form, and continuation of motions."""

import dataclasses
import functools
import json
import zlib
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F32, F64, I64, Bools, Floats
from shuttle_marl.court.staging.body import Course, Habits, PlayerMotion, Prepared, bones, course, free_palm, habits, prepare
from shuttle_marl.court.staging.draw import TrajectoryBuilder
from shuttle_marl.court.staging.feet import Feet
from shuttle_marl.court.staging.geometry import apply, matrix, quaternion
from shuttle_marl.court.staging.poses import MOTIONS, Athlete
from shuttle_marl.court.staging.skeleton import BONE, FLIP, MIRROR, N_BONES, SWEET_SPOT, Skeleton, StagingError, load_skeleton
from shuttle_marl.court.staging.timeline import TimelineBuilder
from shuttle_marl.court.staging.trajectory import ENDS, LEAD_IN, Trajectory, held, shuttle_path, travel, with_contacts_moved
from shuttle_marl.game import draws
from shuttle_marl.game.court import Hands
from shuttle_marl.game.rally import Rally
from shuttle_marl.game.rules import OUTCOMES

_ATTEMPTS, _RETRIES = 5, 3
_TOLERANCE: Final = 3e-3
_MOOD: Final = 1 << 20  # counter of the draws for the reactions, above those of the strokes
_TAIL: Final = 2.0  # time after the end of the last flight [s]
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
        """Pack the motion; ``docs/motion_format.md`` describes the format; ``first``: first packed frame; the reader has the
        previous frames. Raises StagingError: the frame does not exist."""
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


def stage(
    rally: Rally, *, seed: int, athletes: tuple[str, str] = ("male", "male"), fps: int = 50, lead_in: float = LEAD_IN
) -> Motion:
    """Stage a rally, whose players hold the racket in their own hand. The same arguments give the same motion.

    An open rally is staged up to where the next striker is expected to meet the shuttle, or, without any stroke, for
    ``lead_in`` seconds of waiting; :func:`continue_motion` appends what follows.

    Args:
        seed: random seed of the times and places of the contacts.
        athletes: ``male`` or ``female``, of seats 0 and 1.
        fps: frames per second, 25 to 1000; every contact falls on a frame.
        lead_in: time before the serve, or duration of the waiting [s].

    Raises:
        RallyError: the strokes do not form a rally.
        StagingError: an invalid option.
    """
    if not 25 <= fps <= 1000:
        raise StagingError(f"{fps} frames a second: expected 25 to 1000")
    if not 1.0 <= lead_in <= 3600:
        raise StagingError(f"{lead_in} s before the serve: expected 1 to 3600")
    players = players_of(rally, (load_skeleton(athletes[0]), load_skeleton(athletes[1])))
    return _staged(rally.checked(), players, None, seed, fps, lead_in)


def continue_motion(motion: Motion, rally: Rally, *, seed: int, from_stroke: int | None = None) -> Motion:
    """Stage more strokes of an open rally, or another continuation of a finished one.

    The frames up to the branch stay the same, bit for bit; athletes and frame rate are those of ``motion``. The
    branch is the contact of the stroke before ``from_stroke``; before the serve it is the end of the waiting.

    Args:
        motion: a motion that :func:`stage` or this function returned.
        rally: a rally with the same hands, and the same strokes before ``from_stroke``.
        seed: random seed of the times and places of the new contacts.
        from_stroke: number of the first new stroke; by default the number of strokes of ``motion``.

    Raises:
        RallyError: the strokes do not form a rally.
        StagingError: other strokes.
    """
    branch = _branch(rally.checked(), motion, from_stroke)
    return _staged(rally, players_of(rally, motion.skeletons), branch, seed, motion.fps, LEAD_IN)


def players_of(rally: Rally, skeletons: tuple[Skeleton, Skeleton]) -> tuple[Athlete, Athlete]:
    """Both players of a rally as bodies."""
    first, second = (Athlete(seat, rally.facing(seat), rally.hands[seat] == "right", skeletons[seat]) for seat in (0, 1))
    return first, second


def _staged(rally: Rally, players: tuple[Athlete, Athlete], branch: Branch | None, seed: int, fps: int, lead_in: float) -> Motion:
    trajectory = TrajectoryBuilder(rally, players, seed, fps).build(lead_in, branch)
    done = branch.frame + 1 if branch else 0
    if len(rally):
        frames = round((trajectory.end_time[-1] + (0.0 if rally.open else _TAIL)) * fps) + 1
    else:
        frames = max(done - 1, 0) + round(lead_in * fps) + 1
    # Index of the reaction of each player to the end of the rally.
    bits = draws.draw(draws.extend(draws.stream(seed), len(rally)), np.array([_MOOD, _MOOD + 1]))
    moods = (bits >> np.uint64(63)).astype(int).tolist()
    rhythm = branch.player(0).rhythm if branch else seed
    added = [habits(trajectory, seat, rhythm, frames, fps) for seat in (0, 1)]
    for _ in range(_RETRIES):
        ready = [_prepared(trajectory, players[seat], added[seat], moods[seat], fps, branch) for seat in (0, 1)]
        # From the shuttle to the strings in the frame of the court, by stroke, where they are apart.
        missed = {
            hit.stroke: -miss * player.signs
            for player, (prepared, _) in zip(players, ready, strict=True)
            for hit, miss in zip(prepared.timeline.hits, prepared.miss, strict=True)
            if np.linalg.norm(miss) > 2 * _TOLERANCE
        }
        if not missed:
            break
        trajectory = with_contacts_moved(trajectory, missed)
    shuttle, velocity = shuttle_path(trajectory, frames, fps, max(branch.strokes - 1, 0) if branch else 0)
    rotation, position = np.empty((frames, 2, N_BONES, 4), np.float32), np.empty((frames, 2, N_BONES, 3), np.float32)
    planted = np.empty((frames, 2, 2), dtype=bool)
    contacts = np.rint(trajectory.time * fps).astype(np.int64)
    states = []
    for seat, (prepared, shift) in enumerate(ready):
        skeleton, sign = players[seat].skeleton, players[seat].signs
        found = course(skeleton, prepared, shuttle * sign, branch.course(seat) if branch else None)
        states.append(PlayerMotion(found, prepared, shift, rhythm))
        rows = slice(done, None)
        new = found.part(rows)
        turn, place = bones(skeleton, new)
        rotation[rows, seat], position[rows, seat], planted[rows, seat] = onto_court(turn, place, new.feet, sign)
        if seat == rally.server and (not len(rally) or contacts[0] >= done):
            palm = np.zeros((frames, 3))
            if branch:
                palm[:done] = branch.motion.shuttle[:done]
            palm[rows] = free_palm(skeleton, turn, place) * sign
            held(shuttle, palm, contacts, trajectory, fps)
            end = int(contacts[0]) if len(contacts) else frames
            velocity[:end] = np.gradient(shuttle[: end + 1], 1 / fps, axis=0)[:end]
    motion = Motion(
        fps=fps,
        time=np.arange(frames) / fps,
        shuttle=shuttle.astype(np.float32),
        shuttle_velocity=velocity.astype(np.float32),
        rotation=rotation,
        position=position,
        planted=planted,
        contact_frame=contacts,
        skeletons=(players[0].skeleton, players[1].skeleton),
        trajectory=trajectory,
        players=(states[0], states[1]),
    )
    if branch:
        # In the frame of a contact the velocity is already that of the new flight.
        flown = branch.frame if branch.strokes else done
        known = {"rotation": done, "position": done, "planted": done, "shuttle": flown, "shuttle_velocity": flown}
        for name, end in known.items():
            getattr(motion, name)[:end] = getattr(branch.motion, name)[:end]
    return motion


def _branch(rally: Rally, motion: Motion, from_stroke: int | None) -> Branch:
    old = motion.trajectory.rally
    strokes = len(old) if from_stroke is None else from_stroke
    if not 0 <= strokes <= min(len(old), len(rally)):
        raise StagingError(f"from_stroke {strokes}: the motion has {len(old)} strokes, the rally {len(rally)}")
    names = [[one.catalogue.names[k] for k in one.stroke[:strokes]] for one in (rally, old)]
    same = [names[0] == names[1], np.array_equal(old.hurried[:strokes], rally.hurried[:strokes])]
    same += [getattr(old, name) == getattr(rally, name) for name in ("server", "from_right", "ends_changed", "hands")]
    if not all(same):
        raise StagingError(
            f"the motion and the rally have other hands, or other strokes before number {strokes}: expected the same"
        )
    if strokes:
        return Branch(motion, strokes, int(motion.contact_frame[strokes - 1]))
    return Branch(motion, 0, max(int(motion.contact_frame[0]) - motion.fps, 1) if len(old) else len(motion.time) - 1)


def _prepared(
    trajectory: Trajectory, athlete: Athlete, added: Habits, mood: int, fps: int, branch: Branch | None
) -> tuple[Prepared, F64]:
    """Feet and key poses of one player, and ``[n, 3]`` shift of the hips at each stroke [m]. Where the racket does not reach the
    shuttle, the hips are shifted and the contacts are solved again."""
    seat, shift, frames = athlete.seat, np.zeros((len(trajectory.time), 3)), len(added.place)
    mirror = np.array([1.0 if athlete.right_handed else -1.0, 1.0])
    past, known, before, walked = None, None, None, None
    if branch:
        shift[: branch.strokes] = branch.player(seat).shift[: branch.strokes]
        before = branch.course(seat)
        walked = branch.player(seat).prepared.path[: branch.frame + 1] * mirror
    for _ in range(_ATTEMPTS):
        if branch:
            past, known = branch.player(seat).past(branch.frame, branch.strokes)
        hips = travel(trajectory, seat, shift[:, :2] * mirror, frames, fps, walked) * mirror
        timeline = TimelineBuilder(trajectory, athlete, hips, shift[:, 2], fps, mood, past).timeline()
        prepared = prepare(athlete.skeleton, timeline, hips, fps, added, known, before)
        missed = np.linalg.norm(prepared.miss, axis=1) > _TOLERANCE
        if not missed.any():
            break
        strokes = np.array([hit.stroke for hit in timeline.hits])
        # Overshoot slightly: otherwise the last millimetres take many attempts.
        shift[strokes[missed]] += 1.15 * prepared.miss[missed]
    return prepared, shift


def onto_court(rotation: F64, position: F64, feet: Feet, sign: F64) -> tuple[F64, F64, Bools]:
    """Rotations, positions and plants of a player in the frame of the court. ``sign`` turns by half a turn about the vertical
    (seat 1), mirrors (a left-hander), or both. A mirror swaps the bones of left and right."""
    position, planted = position * sign, feet.planted.T
    # Without the mirror, the signs are a rotation of the whole player.
    signs = np.array([[sign[1]], [sign[1]], [1.0]])
    if sign[0] * sign[1] < 0:
        rotation, position, planted = rotation[:, MIRROR], position[:, MIRROR], planted[:, ::-1]
        signs = signs * np.outer(FLIP, FLIP)
    return quaternion(signs * rotation), position, planted
