"""Timelines of a player: key poses, jumps and stands on the clock of a rally, method by method."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shuttle_marl.game import default_game
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.game.rules import FAULT, WINNER
from shuttle_marl.staging import load_skeleton
from shuttle_marl.staging.body import Course, PlayerMotion, Prepared
from shuttle_marl.staging.curves import curve, half_time, leap, slopes_through
from shuttle_marl.staging.feet import Feet, Plant
from shuttle_marl.staging.flight import shoot
from shuttle_marl.staging.idle import Habits
from shuttle_marl.staging.library import Athlete, bent, pointed
from shuttle_marl.staging.motions import MOTIONS, Stance
from shuttle_marl.staging.poses import CONTACT
from shuttle_marl.staging.rotation import turned
from shuttle_marl.staging.skeleton import HIPS_HEIGHT, HIPS_YAW
from shuttle_marl.staging.timeline import LANDING, SPLIT, WAIT, Hit, Keys, Stand, Timeline, TimelineBuilder, feet_at, placed
from shuttle_marl.staging.trajectory import OPEN, OUT, RETURN, WIN, Trajectory

CATALOGUE = default_game().catalogue
MALE = load_skeleton("male")
FPS, FRAMES = 50, 300
NAMES = ("short-serve:front-centre:below:back", "lift:back-left:below:fore", "smash:middle-left:above:fore", "block:")
MOTION = ("backhand serve", "lunge", "overhead", "defence")
TIME, END_TIME = np.array([1.0, 2.0, 3.2, 3.6]), np.array([2.0, 3.2, 3.6, 4.6])


def a_trajectory(motions: tuple[str, ...] = MOTION, names: tuple[str, ...] = NAMES, end: int = WIN, **others: Any) -> Trajectory:
    """A serve of seat 0 after 1 s, a lift, a smash and a block."""
    strokes = [next(k for k, each in enumerate(CATALOGUE.names) if each.startswith(name)) for name in names]
    n = len(strokes)
    hurried = np.array(others.pop("hurried", [False] * n))
    contact = np.array([[0.0, -2.5, 1.0], [0.3, 2.2, 0.8], [-0.4, -5.0, 2.6], [0.2, 4.0, 0.7]])[:n]
    contact[2:3, 2] = others.pop("height", 2.6)
    ends = np.array([[0.3, 2.2, 0.8], [-0.4, -5.0, 2.6], [0.2, 4.0, 0.7], [0.5, -2.0, 0.014]])[:n]
    ending = {WIN: WINNER, OUT: FAULT, OPEN: 2}[end]
    stance = tuple(
        Stance(motion=MOTIONS.index(motion), heading=0.1 * k, root=np.array([0.1 * k, -3.0]), reach=0.5)
        for k, motion in enumerate(motions)
    )
    return Trajectory(
        rally=Rally(catalogue=CATALOGUE, server=0, stroke=np.array(strokes), hurried=hurried, ending=ending),
        time=TIME[:n],
        contact=contact,
        end=np.array([*[RETURN] * (n - 1), end]),
        end_time=END_TIME[:n],
        chosen_point=ends,
        end_point=ends,
        flight=shoot(contact, ends, END_TIME[:n] - TIME[:n]),
        stance=stance[:n],
        base=np.zeros((n, 2, 2)),
        before=np.array([[0.2, -2.4], [-0.3, -3.0]]),
        reply=stance[-1],
    )


def a_builder(
    trajectory: Trajectory | None = None,
    seat: int = 0,
    right_handed: bool = True,
    higher: float = 0.0,
    mood: tuple[int, float] = (0, 0.5),
) -> TimelineBuilder:
    trajectory = trajectory or a_trajectory()
    athlete = Athlete(seat=seat, facing=trajectory.rally.facing(seat), right_handed=right_handed, skeleton=MALE)
    hips = np.column_stack([np.linspace(0, 0.6, FRAMES), np.full(FRAMES, -3.0)])
    return TimelineBuilder(trajectory, athlete, hips, np.full(len(trajectory.time), higher), FPS, mood)


def stands_of(made: TimelineBuilder | Timeline) -> list[tuple[int, int]]:
    return [(stand.begin, stand.end) for stand in made.stands]


def test_a_key_pose_keeps_two_frames_from_others_unless_it_is_fixed() -> None:
    made = a_builder()
    for frame, fixed, keys in (
        (10, False, [10]),
        (12, False, [10]),
        (13, False, [10, 13]),
        (15, True, [10, 15]),
        (17, False, [10, 15]),
        (17, True, [10, 15, 17]),
        (-5, True, [10, 15, 17]),
        (999, False, [10, 15, 17, FRAMES - 1]),
    ):
        made._key(frame, np.full(27, float(frame)), fixed=fixed)
        assert sorted(made.keys) == keys
    assert made.fixed == {15, 17}
    made.done = 20
    for frame in (20, 19):
        made._key(frame, np.zeros(27), fixed=True)
    assert sorted(made.keys) == keys, "frames that are done stay"
    made._key(21, np.zeros(27))
    assert 21 in made.keys


def test_stands_follow_each_other_after_two_frames_and_end_with_the_motion() -> None:
    made, feet = a_builder(), (np.zeros((2, 2)), np.zeros(2))
    for begin, end, stands in (
        (0, 10, [(0, 10)]),
        (5, 8, [(0, 10), (12, 12)]),
        (13, 20, [(0, 10), (12, 12), (14, 20)]),
        (297, 400, [(0, 10), (12, 12), (14, 20), (297, 299)]),
        (299, 400, [(0, 10), (12, 12), (14, 20), (297, 299)]),
    ):
        made._stand(begin, end, feet, last=0, hop=True)
        assert stands_of(made) == stands
    assert (made.stands[-1].last, made.stands[-1].hop) == (0, True)
    for begin, count in ((FRAMES - 2, 1), (FRAMES - 1, 0)):
        late = a_builder()
        late._stand(begin, FRAMES, feet)
        assert len(late.stands) == count
    fresh = a_builder()
    fresh.done = 7
    for begin, count in ((7, 0), (8, 1)):
        fresh._stand(begin, 9, feet)
        assert len(fresh.stands) == count
    assert (fresh.stands[0].last, fresh.stands[0].hop) == (1, False)


def test_jumps_are_added() -> None:
    made = a_builder()
    up, down = made._jump(100.0, 0.2, 0.1)
    assert (up, down) == (int(np.floor(100 - half_time(0.2) * FPS)), int(np.ceil(100 + half_time(0.2) * FPS)))
    hips, air = leap((np.arange(FRAMES) - 100) / FPS, 0.2, 0.1)
    assert_allclose(made.lift, hips)
    assert_allclose(made.air, air)
    made.done = 99
    made._jump(100.0, 0.2, 0.1)
    assert_allclose(made.lift, hips * np.where(np.arange(FRAMES) > 99, 2, 1))
    assert_allclose(made.air, air)


@pytest.mark.parametrize(("frame", "i"), [(-3, 0), (50, 0), (51, 1), (160, 2), (180, 3), (290, 3), (400, 3)])
def test_players_face_the_next_contact(frame: int, i: int) -> None:
    """By seven tenths of its direction; what is less than 1.5 m ahead counts as 1.5 m ahead."""
    for seat, right_handed in ((0, True), (1, True), (0, False)):
        made = a_builder(seat=seat, right_handed=right_handed)
        x, y, _ = made.trajectory.contact[i] * made.sign
        way = np.array([x, y]) - made.hips[min(max(frame, 0), FRAMES - 1)]
        assert made._facing(frame) == pytest.approx(0.7 * np.arctan2(-way[0], max(way[1], 1.5)))
        ready = made._ready(frame, 0.03)
        change = ready - made.library.ready
        assert change[HIPS_YAW] == pytest.approx(made._facing(frame))
        assert change[HIPS_HEIGHT] == pytest.approx(-0.03)
        assert set(np.flatnonzero(np.abs(change) > 1e-12)) <= {HIPS_YAW, HIPS_HEIGHT}


def test_both_players_wait_for_the_serve() -> None:
    server, receiver = a_builder(), a_builder(seat=1)
    server._begin()
    assert server.keys == {}
    assert stands_of(server) == [(0, 56)]
    place, yaw, _ = feet_at(0, server.hips[0], 0.0, 0.0)
    assert_allclose(server.stands[0].place, place)
    assert_allclose(server.stands[0].yaw, yaw)
    receiver._begin()
    assert sorted(receiver.keys) == [0, 38]
    assert all((pose == receiver.library.wait).all() for pose in receiver.keys.values())
    assert stands_of(receiver) == [(0, 46)]
    assert_allclose(receiver.stands[0].place, placed(WAIT, receiver.hips[0], 0.0)[0])
    waiting = a_trajectory()
    nothing = dataclasses.replace(
        waiting,
        rally=dataclasses.replace(waiting.rally, stroke=np.zeros(0, np.int64), hurried=np.zeros(0, bool), ending=2),
        time=np.zeros(0),
        reply=Stance(motion=0, heading=0.3, root=np.array([1.0, -2.0]), reach=0.0),
    )
    for right_handed, heading in ((True, 0.3), (False, -0.3)):
        made = a_builder(nothing, right_handed=right_handed)
        made._begin()
        assert list(made.keys) == [0]
        change = made.keys[0] - made.library.stroke[0, 0]
        assert change[HIPS_YAW] == pytest.approx(heading)
        assert np.count_nonzero(change) == 1
        assert stands_of(made) == [(0, FRAMES - 1)]


def test_players_who_have_waited_walk_to_the_serve() -> None:
    """From their last stand they are in the places of the serve 0.45 s before it."""
    motion, _ = plan()
    stand = Stand(begin=0, end=10, place=np.zeros((2, 2)), yaw=np.zeros(2))
    for seat, end in ((0, 56), (1, 46)):
        made = a_builder(seat=seat)
        made.stands, made.past, made.done = [stand], motion.past(10, 0)[0], 10
        made._begin()
        assert stands_of(made) == [(0, 10), (28, end)]
        spots = feet_at(0, made.hips[28], 0.0, 0.0)[:2] if seat == 0 else placed(WAIT, made.hips[28], 0.0)
        assert_allclose(made.stands[1].place, spots[0])
        assert sorted(made.keys) == ([] if seat == 0 else [38])
        made = a_builder(seat=seat)
        made.stands, made.past, made.done = [stand], motion.past(10, 1)[0], 10
        made._begin()
        assert stands_of(made) == [(0, 10)], "after strokes they are on their way"


def test_stances_of_left_handers_are_mirrored() -> None:
    stance = Stance(motion=3, heading=0.3, root=np.array([1.0, -2.0]), reach=0.4)
    assert a_builder()._mirrored(stance) is stance
    found = a_builder(right_handed=False)._mirrored(stance)
    assert (found.heading, found.root.tolist(), found.motion, found.reach) == (-0.3, [-1, -2], 3, 0.4)


def split(end: int, frame: int = 100, following: int = 200, i: int = 1, away: float = 0.5) -> TimelineBuilder:
    """A split step when the opponent strikes in frame 100, from a stand that ended before."""
    made = a_builder()
    x = made.hips[95, 0] - away
    made.stands = [Stand(begin=0, end=end, place=np.array([[x - 0.2, -3.0], [x + 0.2, -3.0]]), yaw=np.zeros(2))]
    made._split(i, frame, following)
    return made


def test_a_split_step_hops_when_the_opponent_strikes() -> None:
    """3.5 cm high: up in frame 95, down in frame 104; with a step before where there is time for it."""
    made = split(50)
    assert stands_of(made) == [(0, 50), (94, 95), (104, 106)]
    assert [stand.hop for stand in made.stands] == [False, False, True]
    assert made.stands[1].last == 1
    assert split(50, i=2).stands[1].last == 0
    assert_allclose(made.stands[2].place, placed(SPLIT, made.hips[105], made._facing(100))[0])
    assert_allclose(made.stands[1].place, placed(SPLIT, made.hips[95], made._facing(100))[0])
    assert made.air.max() == pytest.approx(0.035, abs=5e-3)
    assert sorted(made.keys) == [94, 104]
    assert_allclose(made.keys[94][HIPS_HEIGHT] - made.library.ready[HIPS_HEIGHT], -0.01)
    assert_allclose(made.keys[104][HIPS_HEIGHT] - made.library.ready[HIPS_HEIGHT], -0.05)


@pytest.mark.parametrize(
    ("end", "following", "i", "away", "stands"),
    [
        (50, 200, 0, 0.5, [(0, 95), (104, 106)]),  # at the serve
        (50, 200, 1, 0.24, [(0, 95), (104, 106)]),  # it stands well
        (50, 200, 1, 0.26, [(0, 50), (94, 95), (104, 106)]),
        (83, 200, 1, 0.5, [(0, 95), (104, 106)]),  # no time for a step
        (82, 200, 1, 0.5, [(0, 82), (94, 95), (104, 106)]),
        (91, 200, 1, 0.5, [(0, 95), (104, 106)]),
        (92, 200, 1, 0.5, [(0, 92), (102, 104)]),  # no time to hop
        (92, 126, 1, 0.5, [(0, 92), (102, 104)]),
        (92, 125, 1, 0.5, [(0, 92)]),
    ],
)
def test_split_steps_without_time(end: int, following: int, i: int, away: float, stands: list[tuple[int, int]]) -> None:
    assert stands_of(split(end, following=following, i=i, away=away)) == stands


@pytest.mark.parametrize(
    ("motion", "name", "z", "higher", "ahead", "jump", "raised"),
    [
        # Above the natural contact, in metres; an attack is jumped when there is time, others only when too high.
        ("overhead", "smash:middle-left:above:fore", 0.0, 0.0, 1.0, 0.12, 0.0),
        ("overhead", "smash:middle-left:above:fore", 0.2, 0.0, 1.0, 0.23, 0.0),
        ("overhead", "smash:middle-left:above:fore", 0.2, 0.1, 1.0, 0.33, 0.0),
        ("overhead", "smash:middle-left:above:fore", 0.9, 0.0, 1.0, 0.48, 0.0),
        ("overhead", "smash:middle-left:above:fore", 0.05, 0.0, 0.6, None, 0.05),
        ("overhead", "clear:back-left:above:fore", 0.07, 0.0, 1.0, None, 0.07),
        ("overhead", "clear:back-left:above:fore", 0.09, 0.0, 1.0, 0.12, 0.0),
        ("overhead", "clear:back-left:above:fore", -0.1, 0.02, 1.0, None, 0.02),
        ("lunge", "lift:back-left:below:fore", 0.3, 0.04, 1.0, None, 0.04),
        ("defence", "block:", 0.0, 0.0, 1.0, None, -0.02),
    ],
)
def test_jumps_and_bent_knees_for_the_height_of_a_contact(
    motion: str, name: str, z: float, higher: float, ahead: float, jump: float | None, raised: float
) -> None:
    kind = MOTIONS.index(motion)
    natural = float(a_builder().library.contact[kind, 0, 2])
    trajectory = a_trajectory((*MOTION[:2], motion), (*NAMES[:2], name), height=natural + z)
    made = a_builder(trajectory, higher=higher)
    keys = made.library.stroke[kind].copy()
    air = made._rise(2, keys, trajectory.stance[2], 160, ahead)
    assert (air is None) == (jump is None)
    if jump is not None:
        hips, feet = leap((np.arange(FRAMES) - 159) / FPS, jump, 0.14)
        assert_allclose(made.lift, hips, atol=1e-9)
        assert_allclose(made.air, feet, atol=1e-9)
        need = min(z - jump, 0.0)
    else:
        need = z
        assert (made.lift == 0).all()
    old = made.library.stroke[kind]
    change = bent(old[CONTACT, :7], kind, np.array([need]))[0] - old[CONTACT, :7]
    change[HIPS_HEIGHT] += raised
    for k, share in enumerate((0.0, 0.0, 0.6, 1.0, 0.8, 0.0)):
        assert_allclose(keys[k, :7] - old[k, :7], share * change, atol=1e-9)
        assert (keys[k, 7:] == old[k, 7:]).all()


def feet_of(motion: str, air: tuple[int, int] | None = None, hurried: bool = False, i: int = 2) -> tuple[TimelineBuilder, Stance]:
    kind = MOTIONS.index(motion)
    trajectory = a_trajectory((*MOTION[:2], motion, motion), hurried=[False, False, hurried, False])
    made = a_builder(trajectory)
    stance = Stance(motion=kind, heading=0.2, root=np.zeros(2), reach=0.5)
    made._feet(i, stance, 160, air)
    return made, stance


def test_feet_stand_at_a_contact_and_land_after_a_jump() -> None:
    for motion, end in (
        ("lunge", 168),
        ("backhand lunge", 168),
        ("net kill", 168),
        ("side arm", 165),
        ("backhand net kill", 165),
    ):
        made, stance = feet_of(motion)
        high = float(made.trajectory.contact[2, 2] - made.library.contact[stance.motion, 0, 2])
        place, yaw, last = feet_at(stance.motion, made.hips[160], 0.2, 0.5, high)
        assert stands_of(made) == [(158, end)]
        assert_allclose(made.stands[0].place, place)
        assert_allclose(made.stands[0].yaw, yaw)
        assert made.stands[0].last == last
        assert stands_of(feet_of(motion, hurried=True)[0]) == [(161, end)]
    assert stands_of(feet_of("lunge", i=0)[0]) == [], "the server stands already"
    made, stance = feet_of("around the head", (150, 170))
    assert stands_of(made) == [(146, 150), (170, 174)]
    place, yaw, last = feet_at(stance.motion, made.hips[149], 0.2, 0.5)
    assert_allclose(made.stands[0].place, place)
    assert (made.stands[0].last, made.stands[0].hop, made.stands[1].hop) == (last, False, True)
    assert_allclose(made.stands[1].place, placed(LANDING, made.hips[171], 0.1)[0])
    assert_allclose(made.stands[1].yaw, placed(LANDING, made.hips[171], 0.1)[1])


def test_reactions_to_the_end_of_a_rally() -> None:
    """Joy after 0.5 and 1 s, which passes; disappointment after 0.9 and 1.7 s, which stays."""
    for end, seat, won in ((WIN, 1, True), (WIN, 0, False), (OUT, 1, False), (OUT, 0, True)):
        for which, much in ((0, 0.5), (1, 1.0)):
            made = a_builder(a_trajectory(end=end), seat, mood=(which, much))
            made.stands = [Stand(begin=0, end=100, place=np.zeros((2, 2)), yaw=np.zeros(2))]
            made._finish(230)
            library, turn = made.library, made._facing(230)
            shown = (library.wins if won else library.loses)[which]
            felt = library.rest + much * (shown - library.rest)
            felt[HIPS_YAW] += turn
            rest = library.rest.copy()
            rest[HIPS_YAW] += turn
            frames = [255, 280] if won else [275, FRAMES - 1]  # the second one, in frame 315, is at the end
            waiting = [228] if seat == 0 else []
            assert sorted(made.keys) == sorted({*waiting, *frames, FRAMES - 1})
            assert_allclose(made.keys[frames[0]], felt)
            assert_allclose(made.keys[FRAMES - 1], rest if won else felt)
            if waiting:
                assert made.keys[228][HIPS_HEIGHT] == pytest.approx(library.ready[HIPS_HEIGHT] - 0.02)
            assert stands_of(made)[1:] == [(275, FRAMES - 1)]
            assert_allclose(made.stands[1].place, placed(SPLIT, made.hips[-1], made._facing(FRAMES - 1))[0])
    early = a_builder(a_trajectory(), 1)
    early.stands = [Stand(begin=0, end=100, place=np.zeros((2, 2)), yaw=np.zeros(2))]
    early._finish(185)
    assert 225 in early.keys, "0.4 s after the last contact at least"


def hit_of(trajectory: Trajectory, i: int, seat: int) -> tuple[TimelineBuilder, Hit]:
    made = a_builder(trajectory, seat)
    clock = [50, 100, 160, 180, 230]
    return made, made._strike(i, clock[i], clock[i - 1] if i else 0, clock[i + 1])


def test_a_stroke_has_six_key_poses_on_the_clock() -> None:
    """Preparation, take-back and load follow from the time since the opponent's contact; a hurried player has less."""
    for hurried, early in ((False, (0.54, 0.27, 0.09)), (True, (0.378, 0.189, 0.063))):
        made, hit = hit_of(a_trajectory(hurried=[False, False, hurried, False]), 2, 0)
        before = [160 - round(seconds * FPS) for seconds in early]
        assert sorted(made.keys) == [*before, 160, 164, 170]  # 22 % and 48 % of the 0.4 s until the next contact
        assert made.fixed == {before[0], before[2], 160, 164}
        assert (hit.frame, hit.stroke, hit.soft) == (160, 2, 0.0)
    made, _ = hit_of(a_trajectory(), 3, 1)
    assert sorted(made.keys) == [180 - round(share * 0.4 * FPS) for share in (0.74, 0.42, 0.18)] + [180, 185, 195, 218]
    made, _ = hit_of(a_trajectory(), 0, 0)
    assert sorted(made.keys) == [0, 5, 36, 46, 50, 55, 65, 88]
    made, _ = hit_of(a_trajectory(), 1, 1)
    keys, power = made.library.stroke[MOTIONS.index("lunge")].copy(), made.trajectory.flight.launch_speed[1] / 38
    keys[:, HIPS_YAW] += 0.1
    assert 0.35 < power < 1
    assert_allclose(made.keys[100 - 27], keys[0])
    assert_allclose(made.keys[100 - 14][7:], (keys[0] + power * (keys[1] - keys[0]))[7:])
    assert_allclose(made.keys[105][7:], (keys[3] + max(power, 0.5) * (keys[4] - keys[3]))[7:])


def test_what_a_hit_wants_of_the_arm() -> None:
    """The strings face between both flights, and move at a fraction of the shuttle's speed."""
    trajectory = a_trajectory()
    for i, seat, ratio, soft in ((0, 0, 0.60, 0.3), (1, 1, 0.68, 0.0), (2, 0, 0.72, 0.0), (3, 1, 0.30, 0.75)):
        made, hit = hit_of(trajectory, i, seat)
        launch = trajectory.flight.velocity(i, 0)
        assert_allclose(hit.point, trajectory.contact[i] * made.sign)
        assert_allclose(hit.swing, ratio * launch * made.sign)
        assert hit.soft == soft
        normal = launch / np.linalg.norm(launch)
        if i:
            into = trajectory.flight.velocity(i - 1, -1)
            normal = normal - 0.4 * into / np.linalg.norm(into)
        assert_allclose(hit.normal, normal / np.linalg.norm(normal) * made.sign)
        for direction in (hit.shaft, hit.elbow):
            assert np.linalg.norm(direction) == pytest.approx(1)


@pytest.mark.parametrize(
    ("shot", "ratio", "soft"),
    [
        ("short-serve", 0.60, 0.3),
        ("long-serve", 0.62, 0.0),
        ("clear", 0.72, 0.0),
        ("lift", 0.68, 0.0),
        ("drop", 0.45, 0.25),
        ("smash", 0.72, 0.0),
        ("half-smash", 0.70, 0.0),
        ("drive", 0.68, 0.0),
        ("push", 0.60, 0.35),
        ("net-kill", 0.80, 0.0),
        ("net-shot", 0.32, 0.75),
        ("block", 0.30, 0.75),
        ("cross-court-net-shot", 0.36, 0.7),
    ],
)
def test_strings_are_slower_than_the_shuttle_and_soft_strokes_have_no_swing(shot: str, ratio: float, soft: float) -> None:
    """Serves are struck first, the others third."""
    i, names = (0, (f"{shot}:", *NAMES[1:])) if "serve" in shot else (2, (*NAMES[:2], f"{shot}:", NAMES[3]))
    trajectory = a_trajectory(names=names)
    _, hit = hit_of(trajectory, i, 0)
    assert np.linalg.norm(hit.swing) == pytest.approx(ratio * trajectory.flight.launch_speed[i])
    assert hit.soft == soft


def test_feet_in_the_split_step_the_landing_and_the_wait_for_the_serve() -> None:
    """Left and right foot: to the right, ahead, heading in degrees; after a jump the racket foot lands in front."""
    assert SPLIT.tolist() == [[-0.29, 0.03, 14], [0.29, 0.00, -14]]
    assert LANDING.tolist() == [[-0.16, -0.26, 22], [0.14, 0.26, -6]]
    assert WAIT.tolist() == [[-0.10, 0.24, 0], [0.12, -0.22, -28]]


def test_the_racket_leans_back_in_overhead_strokes_upwards() -> None:
    """By twice the sine of the angle of the launch; otherwise shaft and elbow are those of the motion."""
    trajectory = a_trajectory()
    for seconds in (0.4, 1.5):
        flight = shoot(trajectory.contact, trajectory.end_point, np.array([1.0, 1.2, seconds, 1.0]))
        for i, seat in ((1, 1), (2, 0)):
            made, hit = hit_of(dataclasses.replace(trajectory, flight=flight), i, seat)
            launch, kind = flight.velocity(i, 0), trajectory.stance[i].motion
            up = max(launch[2] / np.linalg.norm(launch), 0.0) if i == 2 else 0.0
            assert (up > 0.1) == (i == 2 and seconds > 1)
            facing = turned(made.keys[hit.frame][HIPS_YAW])
            need = np.array([hit.point[2] - made.library.contact[kind, 0, 2]])
            shaft, elbow = (facing @ direction[0] for direction in pointed(kind, need))
            leaning = shaft - np.array([0.0, 2.0 * up, 0.0])
            assert_allclose(hit.shaft, leaning / np.linalg.norm(leaning), atol=1e-12)
            assert_allclose(hit.elbow, elbow, atol=1e-12)


def plan(n: int = 60) -> tuple[PlayerMotion, Keys]:
    rng = np.random.default_rng(0)
    frame, pose = np.array([0, 20, 40]), rng.normal(size=(3, 27))
    keys = Keys(frame=frame, pose=pose, slope=slopes_through(frame, pose))
    feet = Feet(np.zeros((2, n, 3)), np.zeros((2, n)), np.zeros((2, n)), np.ones((2, n), dtype=bool))
    course = Course(hips=rng.normal(size=(n, 3)), pose=rng.normal(size=(n, 27)), feet=feet, gaze=rng.normal(size=(n, 2)))
    plants = ([Plant(0, n - 1, np.zeros(2), 0.0)], [Plant(0, n - 1, np.ones(2), 0.0)])
    line = Timeline(
        frame=frame,
        pose=pose,
        known=keys,
        hits=(),
        lift=np.linspace(0.0, 0.1 * (n - 1), n),
        air=np.linspace(0.0, 0.2 * (n - 1), n),
        stands=[],
    )
    added = Habits(pose=np.zeros((n, 27)), place=np.zeros((n, 3)))
    ready = Prepared(
        hips=course.hips,
        path=course.hips[:, :2],
        feet=feet,
        plants=plants,
        keys=keys,
        miss=np.zeros((0, 3)),
        timeline=line,
        added=added,
    )
    return PlayerMotion(course, ready, np.zeros((0, 3)), 3), keys


@pytest.mark.parametrize(("frame", "known"), [(0, 0), (5, 1), (20, 1), (21, 2), (40, 2), (41, 3), (50, 3)])
def test_the_past_of_a_continued_motion_ends_in_its_last_frame(frame: int, known: int) -> None:
    motion, keys = plan()
    past, plants = motion.past(frame, 4)
    assert (past.frame, past.strokes) == (frame, 4)
    assert past.keys.frame.tolist() == [*keys.frame[:known], frame]
    assert_allclose(past.keys.pose[:-1], keys.pose[:known])
    whole = curve(keys.frame, keys.pose, keys.slope, 60)
    assert_allclose(past.keys.pose[-1], whole[frame], atol=1e-12)
    slope = (whole[frame + 1] - whole[frame - 1]) / 2 if 0 < frame < 40 else np.zeros(27)
    assert_allclose(past.keys.slope[-1], slope, atol=0.02)
    if frame in (20, 5):
        assert np.abs(past.keys.slope[-1]).max() > 0.02
    assert [plant.end for own in plants for plant in own] == [frame, frame]
    assert past.lift[10] == pytest.approx(1.0)
    assert past.air[10] == pytest.approx(2.0)
    part = motion.course.part(slice(3, 8))
    for name in ("hips", "pose", "gaze"):
        assert (getattr(part, name) == getattr(motion.course, name)[3:8]).all()
    assert part.feet.ball.shape == (2, 5, 3)
