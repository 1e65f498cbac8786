"""From a rally to motion: path of the shuttle and bones of both players, and continuation of motions."""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.court.staging.body import Habits, PlayerMotion, Prepared, bones, course, free_palm, habits, prepare
from shuttle_marl.court.staging.draw import TrajectoryBuilder
from shuttle_marl.court.staging.feet import Feet
from shuttle_marl.court.staging.geometry import quaternion
from shuttle_marl.court.staging.motion import Branch, Motion
from shuttle_marl.court.staging.poses import Athlete
from shuttle_marl.court.staging.skeleton import FLIP, MIRROR, N_BONES, Skeleton, StagingError, load_skeleton
from shuttle_marl.court.staging.timeline import TimelineBuilder
from shuttle_marl.court.staging.trajectory import LEAD_IN, Trajectory, held, shuttle_path, travel, with_contacts_moved
from shuttle_marl.game import draws
from shuttle_marl.game.rally import Rally

_ATTEMPTS, _RETRIES = 5, 3
_TOLERANCE: Final = 3e-3
_MOOD: Final = 1 << 20  # counter of the draws for the reactions, above those of the strokes
_TAIL: Final = 2.0  # time after the end of the last flight [s]


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
    """The motion; frames up to the branch are copied."""
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
    """Feet and key poses of one player, and ``[n, 3]`` shift of the hips at each stroke [m].

    Where the racket does not reach the shuttle, the hips are shifted and the contacts are solved again.
    """
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
    """Rotations, positions and plants of a player in the frame of the court.

    ``sign`` turns by half a turn about the vertical (seat 1), mirrors (a left-hander), or both. A mirror swaps the bones of
    left and right.
    """
    position, planted = position * sign, feet.planted.T
    # Without the mirror, the signs are a rotation of the whole player.
    signs = np.array([[sign[1]], [sign[1]], [1.0]])
    if sign[0] * sign[1] < 0:
        rotation, position, planted = rotation[:, MIRROR], position[:, MIRROR], planted[:, ::-1]
        signs = signs * np.outer(FLIP, FLIP)
    return quaternion(signs * rotation), position, planted
