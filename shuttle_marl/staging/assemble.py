"""From a played rally to motion: the path of the shuttle and the bones of both players."""

from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.staging.arm import arm_of
from shuttle_marl.staging.body import HELD, Prepared, bones, course, prepare
from shuttle_marl.staging.feet import Feet
from shuttle_marl.staging.library import FLIP, library_of
from shuttle_marl.staging.measured import load_measured
from shuttle_marl.staging.motion import HANDS, Motion
from shuttle_marl.staging.rally import PlayedRally, StagingError
from shuttle_marl.staging.rotation import quaternion
from shuttle_marl.staging.shuttle import held, shuttle_path
from shuttle_marl.staging.skeleton import BONE, MIRROR, N_BONES, Skeleton, load_skeleton
from shuttle_marl.staging.timeline import Timeline, TimelineBuilder, own_frame
from shuttle_marl.staging.trajectory import Physique, Trajectory, draw_trajectory, with_contacts_moved
from shuttle_marl.staging.travel import travel

Floats = npt.NDArray[np.float64]

_ATTEMPTS: Final = 5
_RETRIES: Final = 3
_TOLERANCE: Final = 3e-3
_TAIL: Final = 1.4
"""Time after the end of the last flight [s]."""


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
        found = course(skeletons[seat], ready[seat][1], shuttle * sign)
        turn, place = bones(skeletons[seat], found)
        rotation[:, seat], position[:, seat], planted[:, seat] = _onto_court(turn, place, found.feet, sign)
        if seat == rally.server:
            hand = BONE["LeftHand"]
            palm = place[:, hand] + turn[:, hand] @ (arm_of(skeletons[seat]).offset[3] * FLIP)
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


def _onto_court(rotation: Floats, position: Floats, feet: Feet, sign: Floats) -> tuple[Floats, Floats, npt.NDArray[np.bool_]]:
    """Rotations, positions and plants of a player in the frame of the court.

    ``sign`` turns by half a turn about the vertical (seat 1), mirrors (a left-hander), or both. Under a mirror the bones of
    the left and the right change places.
    """
    position, planted = position * sign, feet.planted.T
    mirror = sign[0] * sign[1] < 0
    flip = np.diag([-1.0, 1.0, 1.0])
    if mirror:
        rotation, position, planted = flip @ rotation[:, MIRROR] @ flip, position[:, MIRROR], planted[:, ::-1]
    # What is left of the signs after the mirror is a turn of the whole player.
    turn = np.diag([sign[1], sign[1], 1.0])
    return quaternion(turn @ rotation), position, planted
