"""From a played rally to motion: the path of the shuttle and the bones of both players.

The shuttle is in the server's hand first, then in flight, and after the rally off the net and on the floor.
"""

import dataclasses
import functools
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.staging.arm import arm_of
from shuttle_marl.staging.body import HELD, Performance, Prepared, perform, prepare
from shuttle_marl.staging.flight import GRAVITY, fall
from shuttle_marl.staging.library import FLIP, library_of
from shuttle_marl.staging.measured import load_measured
from shuttle_marl.staging.rally import PlayedRally, StagingError
from shuttle_marl.staging.rotation import apply, matrix, quaternion
from shuttle_marl.staging.skeleton import BONE, MIRROR, N_BONES, SWEET_SPOT, Skeleton, load_skeleton
from shuttle_marl.staging.timeline import Timeline, TimelineBuilder, own_frame
from shuttle_marl.staging.trajectory import NET, Physique, Trajectory, draw_trajectory, with_contacts_moved
from shuttle_marl.staging.travel import travel

Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]

HANDS: Final = ("right", "left")
_ATTEMPTS: Final = 5
_RETRIES: Final = 3
_TOLERANCE: Final = 3e-3
_TAIL: Final = 1.4
"""Time after the end of the last flight [s]."""
_REST: Final = 0.014
"""Height of a shuttle that lies on the floor [m]."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """A rally as motion: F frames, two players, 23 bones. Metres, seconds; the frame of the court.

    The origin lies on the floor under the middle of the net, x along the net, y along the court, z up. Seat 0 plays from
    y < 0 and looks towards +y, seat 1 from y > 0. A bone's rotation is how far it has turned since the rest pose of its
    skeleton, in which all bones are aligned with the axes and the athlete looks towards +y; so a vertex ``v`` of the rest
    pose that hangs on bone ``b`` is at ``rotation[b] (v - rest[b]) + position[b]``.

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
    """

    fps: int
    time: Floats
    shuttle: Floats32
    shuttle_velocity: Floats32
    rotation: Floats32
    position: Floats32
    planted: npt.NDArray[np.bool_]
    contact_frame: npt.NDArray[np.int64]
    skeletons: tuple[Skeleton, Skeleton]
    handedness: tuple[str, str]
    trajectory: Trajectory

    @functools.cached_property
    def sweet_spot(self) -> Floats:
        """``[F, 2, 3]`` the middle of the strings of both rackets."""
        racket = BONE["Racket"]
        axis = np.stack([self.racket(seat)[0] for seat in (0, 1)])
        turn = matrix(self.rotation[:, :, racket])
        return self.position[:, :, racket] + SWEET_SPOT * apply(turn, np.broadcast_to(axis, (*turn.shape[:2], 3)))

    def parents(self, seat: int) -> npt.NDArray[np.int64]:
        """``[23]`` parent of every bone of a player, -1 for the hips."""
        return self.skeletons[seat].parents(right_handed=self.handedness[seat] == "right")

    def rest(self, seat: int) -> Floats:
        """``[23, 3]`` where every bone of a player begins at rest [m]."""
        return self.skeletons[seat].rest_pose(right_handed=self.handedness[seat] == "right")

    def racket(self, seat: int) -> tuple[Floats, Floats]:
        """Shaft and forehand side of the strings of a player's racket at rest, ``[3]`` each."""
        return self.skeletons[seat].racket(right_handed=self.handedness[seat] == "right")


def stage(
    rally: PlayedRally,
    *,
    seed: int,
    handedness: tuple[str, str] = ("right", "right"),
    athletes: tuple[str, str] = ("male", "male"),
    fps: int = 50,
) -> Motion:
    """Stage a rally. The same arguments give the same motion.

    Args:
        rally: what was played.
        seed: names all draws: where and when the shuttle is met.
        handedness: ``right`` or ``left``, of seats 0 and 1.
        athletes: ``male`` or ``female``, of seats 0 and 1.
        fps: frames a second, from 25; every contact falls on a frame.

    Raises:
        StagingError: a rally or an option that cannot be staged.
    """
    rally = rally.checked()
    if any(hand not in HANDS for hand in handedness):
        raise StagingError(f"handedness {handedness}: expected {' or '.join(HANDS)} for each player")
    if not 25 <= fps <= 1000:
        raise StagingError(f"{fps} frames a second: expected 25 to 1000")
    skeletons = (load_skeleton(athletes[0]), load_skeleton(athletes[1]))
    right = (handedness[0] == "right", handedness[1] == "right")
    players = (_physique(skeletons[0], right[0]), _physique(skeletons[1], right[1]))
    trajectory = draw_trajectory(rally, load_measured(), players, seed=seed, fps=fps)
    frames = round((trajectory.end_time[-1] + _TAIL) * fps) + 1
    for _ in range(_RETRIES):
        ready = [_prepared(trajectory, seat, skeletons[seat], right[seat], frames, fps) for seat in (0, 1)]
        missed = _missed(ready, right)
        if not missed:
            break
        trajectory = with_contacts_moved(trajectory, missed)
    shuttle, velocity = shuttle_path(trajectory, frames, fps)
    rotation, position = np.empty((frames, 2, N_BONES, 4)), np.empty((frames, 2, N_BONES, 3))
    planted = np.empty((frames, 2, 2), dtype=bool)
    contacts = np.rint(trajectory.time * fps).astype(np.int64)
    for seat in (0, 1):
        sign = own_frame(seat, right[seat])
        played = perform(skeletons[seat], *ready[seat], shuttle * sign)
        rotation[:, seat], position[:, seat], planted[:, seat] = _onto_court(played, sign)
        if seat == rally.server:
            hand = BONE["LeftHand"]
            palm = played.position[:, hand] + played.rotation[:, hand] @ (arm_of(skeletons[seat]).offset[3] * FLIP)
            release = int(contacts[0]) - round(HELD[trajectory.stance[0].motion][1] * fps)
            held(shuttle, palm * sign, int(contacts[0]), release, fps)
    velocity[: contacts[0]] = np.gradient(shuttle[: contacts[0] + 1], 1 / fps, axis=0)[:-1]
    return Motion(
        fps=fps,
        time=np.arange(frames) / fps,
        shuttle=shuttle.astype(np.float32),
        shuttle_velocity=velocity.astype(np.float32),
        rotation=rotation.astype(np.float32),
        position=position.astype(np.float32),
        planted=planted,
        contact_frame=contacts,
        skeletons=skeletons,
        handedness=handedness,
        trajectory=trajectory,
    )


def _prepared(
    trajectory: Trajectory, seat: int, skeleton: Skeleton, right_handed: bool, frames: int, fps: int
) -> tuple[Timeline, Prepared]:
    """Timeline and feet of one player. Where the racket does not get to the shuttle, the hips are moved and it tries again."""
    shift, library = np.zeros((len(trajectory.time), 3)), library_of(skeleton)
    mirror = np.array([1.0 if right_handed else -1.0, 1.0])
    for _ in range(_ATTEMPTS):
        hips = travel(trajectory, seat, shift[:, :2] * mirror, frames, fps) * mirror
        timeline = TimelineBuilder(trajectory, seat, right_handed, library, hips, shift[:, 2], fps).timeline()
        prepared = prepare(skeleton, timeline, hips, fps)
        missed = np.linalg.norm(prepared.miss, axis=1) > _TOLERANCE
        if not missed.any():
            break
        strokes = np.array([hit.stroke for hit in timeline.hits])
        # A little further than the miss, or the last millimetres would take many attempts.
        shift[strokes[missed]] += 1.15 * prepared.miss[missed]
    return timeline, prepared


def _missed(ready: list[tuple[Timeline, Prepared]], right: tuple[bool, bool]) -> dict[int, Floats]:
    """From the shuttle to the strings, in the frame of the court, by number of the stroke, where they are still apart."""
    return {
        hit.stroke: -miss * own_frame(seat, right[seat])
        for seat, (timeline, prepared) in enumerate(ready)
        for hit, miss in zip(timeline.hits, prepared.miss, strict=True)
        if np.linalg.norm(miss) > 2 * _TOLERANCE
    }


def _physique(skeleton: Skeleton, right_handed: bool) -> Physique:
    return Physique(right_handed=right_handed, size=skeleton.scale, library=library_of(skeleton))


def _onto_court(played: Performance, sign: Floats) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
    """Rotations, positions and plants of a player in the frame of the court.

    ``sign`` turns by half a turn about the vertical (seat 1), mirrors (a left-hander), or both. Under a mirror the bones of
    the left and the right change places.
    """
    rotation, position = played.rotation, played.position * sign
    planted = played.feet.planted.T
    mirror = sign[0] * sign[1] < 0
    flip = np.diag([-1.0, 1.0, 1.0])
    if mirror:
        rotation, position, planted = flip @ rotation[:, MIRROR] @ flip, position[:, MIRROR], planted[:, ::-1]
    # What is left of the signs after the mirror is a turn of the whole player.
    turn = np.diag([sign[1], sign[1], 1.0])
    return quaternion(turn @ rotation), position, planted


def shuttle_path(trajectory: Trajectory, frames: int, fps: int) -> tuple[Floats, Floats]:
    """``[F, 3]`` position and ``[F, 3]`` velocity; before the serve it waits where it will be struck."""
    time = np.arange(frames) / fps
    position, velocity = np.tile(trajectory.contact[0], (frames, 1)), np.zeros((frames, 3))
    for i in range(len(trajectory.time)):
        rows = np.flatnonzero((time >= trajectory.time[i] - 1e-6) & (time <= trajectory.end_time[i] + 1e-6))
        position[rows], velocity[rows] = trajectory.flight.at(i, time[rows] - trajectory.time[i])
    rows = np.flatnonzero(time > trajectory.end_time[-1] + 1e-6)
    _, hit = trajectory.flight.at(len(trajectory.time) - 1, trajectory.flight.time[-1, -1:])
    since = time[rows] - trajectory.end_time[-1]
    if trajectory.end[-1] == NET:
        start = trajectory.end_point[-1]
        back = np.array([-0.04 * hit[0, 0], -0.05 * hit[0, 1], min(0.0, 0.3 * hit[0, 2])])
        drop = fall(start[None], back[None], np.array([2.5]))
        position[rows], velocity[rows] = drop.at(0, since)
        landed = np.flatnonzero(position[rows, 2] <= _REST)
        if len(landed):
            first = rows[landed[0]]
            _roll(position, velocity, first, position[first], velocity[first], time)
    elif len(rows):
        _roll(position, velocity, int(rows[0]), trajectory.end_point[-1], hit[0], time)
    return position, velocity


def held(position: Floats, palm: Floats, contact: int, release: int, fps: int) -> None:
    """Put the shuttle into the server's hand: until frame ``release`` it is at the palm, then it drops to the racket.

    Args:
        position: ``[F, 3]`` path of the shuttle, changed in place.
        palm: ``[F, 3]`` the server's free palm [m].
        contact: frame of the serve.
        release: frame in which the hand opens.
        fps: frames a second.
    """
    position[: release + 1] = palm[: release + 1]
    whole = (contact - release) / fps
    since = np.arange(1, contact - release)[:, None] / fps
    pull = np.array([0.0, 0.0, -GRAVITY])
    start = (position[contact] - palm[release] - pull / 2 * whole**2) / whole
    position[release + 1 : contact] = palm[release] + start * since + pull / 2 * since**2


def _roll(position: Floats, velocity: Floats, first: int, start: Floats, into: Floats, time: Floats) -> None:
    """From frame ``first`` on: one small bounce, then a short slide to rest."""
    rows = slice(first, None)
    since = time[rows] - time[first] + 0.5 * (time[1] - time[0])
    up = min(0.18 * abs(float(into[2])), 1.0)
    stop = 0.25
    slide = 0.12 * into[:2] * stop * (1 - np.exp(-since / stop))[:, None]
    position[rows, :2] = start[:2] + slide
    position[rows, 2] = np.maximum(_REST, _REST + up * since - GRAVITY / 2 * since**2)
    velocity[rows] = np.gradient(position[rows], time[1] - time[0], axis=0) if len(since) > 1 else 0.0
