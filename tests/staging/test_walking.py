"""Walks between rallies, part by part: times, ways, key poses and stands; players put onto the court."""

import types
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64
from shuttle_marl.game import default_game
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.staging import load_skeleton
from shuttle_marl.staging.assemble import onto_court, players_of
from shuttle_marl.staging.feet import Feet, Plant
from shuttle_marl.staging.flight import net_height, shoot
from shuttle_marl.staging.library import FREE_ARM, TRUNK, Athlete, bent, pointed
from shuttle_marl.staging.motions import LUNGE
from shuttle_marl.staging.poses import CONTACT
from shuttle_marl.staging.rotation import matrix, turned
from shuttle_marl.staging.skeleton import BONES, HIPS_HEIGHT, HIPS_PITCH, HIPS_YAW, SPINE_PITCH
from shuttle_marl.staging.timeline import feet_at
from shuttle_marl.staging.walk import _nearest, _standing, _WalkBuilder

MALE = load_skeleton("male")
FPS = 50


def player(x: float, y: float, yaw: float = 0.0) -> Any:
    """A player who stands, as far as a walk reads it."""
    pose = np.zeros((2, 27))
    pose[:, HIPS_YAW], pose[:, FREE_ARM] = yaw, 0.3
    sides = (
        [Plant(0, 5, np.array([x - 0.2, y]), yaw), Plant(6, 9, np.array([x - 0.3, y]), yaw)],
        [Plant(0, 9, np.array([x + 0.2, y]), yaw)],
    )
    course = types.SimpleNamespace(hips=np.array([[x, y, 0.9]] * 2), pose=pose)
    return types.SimpleNamespace(course=course, prepared=types.SimpleNamespace(plants=sides))


def a_walk(
    starts: tuple[tuple[float, float], tuple[float, float]] = ((0.0, -4.0), (0.0, -3.0)),
    ends: tuple[tuple[float, float], tuple[float, float]] = ((0.3, -2.5), (-0.8, -3.5)),
    lying: tuple[float, float] = (1.5, -5.0),
    server: int = 0,
) -> _WalkBuilder:
    """A walk of two right-handers; places are in their own frames, the shuttle lies on the court."""
    made = _WalkBuilder.__new__(_WalkBuilder)
    made.fps, made.server = FPS, server
    first, second = (Athlete(seat=seat, facing=1.0 - 2.0 * seat, right_handed=True, skeleton=MALE) for seat in (0, 1))
    made.athletes = first, second
    made.starts, made.ends = ((player(*a), player(*b, 0.2)) for a, b in (starts, ends))
    made.lying = np.array([*lying, 0.014])
    made.picker = int(lying[1] > 0)
    made.stance = made._pick_up()
    made._plan()
    return made


def test_headings_turn_the_shorter_way() -> None:
    for now, yaw, found in (
        (0.0, 1.0, 1.0),
        (3.0, -3.0, -3.0 + 2 * np.pi),
        (-3.0, 3.0, 3.0 - 2 * np.pi),
        (7.0, 0.5, 0.5 + 2 * np.pi),
    ):
        keys = {0: np.full(27, 99.0), 5: np.full(27, now)}
        assert _nearest(yaw, keys) == pytest.approx(found)


def test_the_first_and_the_last_places_of_the_feet() -> None:
    own = player(1.0, -3.0, 0.4)
    for which, left in ((0, 0.8), (-1, 0.7)):
        found = _standing(own, which, 3, 8)
        assert (found.begin, found.end, found.stride) == (3, 8, 0.78)
        assert_allclose(found.place, [[left, -3], [1.2, -3]])
        assert_allclose(found.yaw, 0.4)


def test_the_shuttle_is_picked_up_with_a_lunge() -> None:
    """The player lunges in the direction of the way to it; the hips stay 45 cm behind the net."""
    made = a_walk()
    natural = made.athletes[0].library.natural(LUNGE, 0.10)
    heading = np.arctan2(-1.5, -1.0)
    assert (made.stance.motion, made.stance.reach) == (LUNGE, 0.0)
    assert made.stance.heading == pytest.approx(heading)
    assert_allclose(made.stance.root, np.array([1.5, -5.0]) - (turned(heading) @ natural)[:2])
    assert a_walk(((0.0, -0.5), (0.0, -3.0)), lying=(1.5, -0.5)).stance.root[1] == -0.45
    other = a_walk(lying=(-1.5, 5.0))  # on the half of seat 1, who sees it at (1.5, -5)
    assert other.picker == 1
    assert other.stance.heading == pytest.approx(np.arctan2(-1.5, -2.0))


def seconds_of(way: F64) -> float:
    """0.35 s of rest before and after a walk at 1.6 m/s, of 0.8 s at least, and two turns when it is over 1.3 m long."""
    far = float(np.hypot(*way))
    return 0.7 + max(0.8, far / 1.6) + (0.56 if far > 1.3 else 0.0)


@pytest.mark.parametrize(
    ("lying", "server"),
    [((1.5, -5.0), 0), ((1.5, -5.0), 1), ((1.0, 6.0), 1), ((0.2, -3.9), 0), ((-1.0, 3.0), 0), ((0.1, -4.0), 1)],
)
def test_times_of_a_walk(lying: tuple[float, float], server: int) -> None:
    """The picker flicks the shuttle up when the server can catch it; half a second after the catch the next rally begins."""
    starts, ends = np.array([[0.0, -4.0], [0.0, -3.0]]), np.array([[0.3, -2.5], [-0.8, -3.5]])
    made = a_walk(lying=lying, server=server)
    picker, root = made.picker, made.stance.root
    direct = [seconds_of(ends[seat] - starts[seat]) for seat in (0, 1)]
    pick, flight = seconds_of(root - starts[picker]), 0.6
    if picker != server:
        pick, flight = max(pick, direct[server] - 1.15), made._flight_time()
    arrival = list(direct)
    arrival[picker] = pick + seconds_of(ends[picker] - root)
    assert made.pick == round(pick * FPS)
    assert made.catch == made.pick + round(flight * FPS)
    assert made.arrival == [round(seconds * FPS) for seconds in arrival]
    assert made.frames == round(max(*arrival, pick + flight + 0.5) * FPS) + 1


@pytest.mark.parametrize(("x", "y"), [(1.5, -5.0), (0.0, -1.0), (-2.0, -0.5), (0.0, -0.3), (0.0, -0.06)])
def test_the_shuttle_is_flicked_over_the_net(x: float, y: float) -> None:
    """Within 1.15 s, or as much slower, in steps of 0.05 s, as it needs to be 15 cm over the net, or under its lower edge."""
    made = a_walk(lying=(x, y), server=1)
    start, end = made.lying, np.array([0.8, 3.5, 1.1])
    fitting = []
    for seconds in 1.15 + 0.05 * np.arange(24):
        path = shoot(start[None], end[None], np.array([seconds])).at(0, np.linspace(0, seconds, 2000))[0]
        k = np.abs(path[:, 1]).argmin()
        over, under = path[k, 2] - net_height(path[k, 0]) - 0.15, 1.55 - 0.76 - 0.15 - path[k, 2]
        fitting.append(max(over, under))
    found = made._flight_time()
    steps = int(np.rint((found - 1.15) / 0.05))
    assert found == pytest.approx(1.15 + 0.05 * steps)
    assert found <= 2.31
    assert steps == 23 or fitting[steps] > -0.02
    assert all(value < 0.02 for value in fitting[:steps])


def test_hips_stay_at_the_stops_and_walk_in_between() -> None:
    made, shift = a_walk(), np.array([0.1, -0.2, 9.0])
    for seat in (0, 1):
        path = made._path(seat, shift)
        assert path.shape == (made.frames, 2)
        assert_allclose(path[0], made._place(seat, end=False), atol=1e-9)
        assert_allclose(path[-1], made._place(seat, end=True), atol=1e-9)
        assert_allclose(path[made.arrival[seat]], made._place(seat, end=True), atol=1e-9)
    assert_allclose(made._path(0, shift)[made.pick], made.stance.root + shift[:2], atol=1e-9)
    # In the middle between two stops, and as fast there as a walk of constant speed between their rests.
    whole = made._path(1, shift)
    begin, end, rest = 0, made.arrival[1], round(0.35 * FPS)
    way = made._place(1, end=True) - made._place(1, end=False)
    middle = (begin + end) // 2
    assert_allclose(whole[middle] - whole[middle - 1], way / (end - begin - 2 * rest), atol=1e-3)


def test_a_player_turns_to_walk_far_and_back_to_the_net() -> None:
    made, pose = a_walk(), np.arange(27.0)
    keys = {0: np.zeros(27), 10: np.zeros(27)}
    made._go(keys, pose, np.array([0.9, 0.9]), 400)
    assert sorted(keys) == [0, 10], "1.27 m away"
    made._go(keys, pose, np.array([1.0, 1.0]), 400)
    assert sorted(keys) == [0, 10, 10 + round((0.35 + 0.28 * np.pi / 4) * FPS), 360]
    for frame in sorted(keys)[2:]:
        assert keys[frame][HIPS_YAW] == pytest.approx(-np.pi / 4)
        assert_allclose(np.delete(keys[frame], HIPS_YAW), np.delete(pose, HIPS_YAW))
    short = {10: np.zeros(27)}
    made._go(short, pose, np.array([0.0, -2.0]), 40)
    assert sorted(short) == [10, 25, 26], "no time to turn: half of it"


def test_key_poses_and_stands_of_who_picks_up_the_shuttle() -> None:
    made, shift = a_walk(), np.array([0.1, -0.2, 0.03])
    line = made._timeline(0, shift)
    root = made.stance.root + shift[:2]
    frames = [made.pick + round(seconds * FPS) for seconds in (-0.50, -0.28, -0.12, 0.0, 0.16, 0.42)]
    poses = {int(frame): pose for frame, pose in zip(line.frame, line.pose, strict=True)}
    assert set(frames) <= set(poses)
    assert list(line.frame) == sorted(line.frame)
    library = made.athletes[0].library
    heading = poses[frames[0]][HIPS_YAW] - library.stroke[LUNGE, 0, HIPS_YAW]
    assert np.cos(heading - made.stance.heading) == pytest.approx(1)
    need = np.array([0.10 - library.contact[LUNGE, 0, 2]])
    lower = bent(library.stroke[LUNGE, CONTACT, TRUNK], LUNGE, need)[0] - library.stroke[LUNGE, CONTACT, TRUNK]
    lower[HIPS_HEIGHT] += 0.03
    lower[[HIPS_PITCH, SPINE_PITCH]] += np.radians(10)
    for k, share in enumerate((0, 0, 0.7, 1.0, 0.7, 0)):
        expected = library.stroke[LUNGE, k].copy()
        expected[HIPS_YAW] += heading
        expected[TRUNK] += share * lower
        assert_allclose(poses[frames[k]], expected, atol=1e-9)
    assert_allclose(poses[0], made.starts[0].course.pose[-1])
    last = poses[made.frames - 1]
    assert_allclose(np.delete(last, HIPS_YAW), np.delete(made.ends[0].course.pose[0], HIPS_YAW))
    assert np.cos(last[HIPS_YAW]) == pytest.approx(1), "it faces the net, after any number of turns"
    assert (poses[made.frames - 3] == last).all()
    # The server catches the shuttle with the hand that will hold it.
    assert_allclose(poses[made.catch][FREE_ARM], 0.3)
    first, lunge, final = line.stands
    assert (first.begin, first.end) == (0, 18)
    assert (lunge.begin, lunge.end, lunge.stride) == (made.pick - 3, frames[4], 0.78)
    place, yaw, landing = feet_at(LUNGE, root, heading, 0.0, 0.35)
    assert_allclose(lunge.place, place)
    assert_allclose(lunge.yaw, yaw)
    assert lunge.last == landing
    assert (final.begin, final.end, final.stays) == (made.arrival[0] - 1, made.frames - 1, 0.03)
    assert line.known.frame.tolist() == [0]
    assert (line.known.slope == 0).all()
    assert (line.lift == 0).all()
    (hit,) = line.hits
    assert (hit.frame, hit.stroke, hit.soft) == (made.pick, 0, 0.6)
    assert_allclose(hit.point, [1.5, -5.0, 0.10])
    assert_allclose(hit.swing, [0, 0, 2.5])
    facing = turned(heading)
    shaft, elbow = (facing @ direction[0] for direction in pointed(LUNGE, need))
    assert_allclose(hit.shaft, shaft - [0, 0, 0.5], atol=1e-9)
    assert_allclose(hit.elbow, elbow, atol=1e-9)
    assert_allclose(hit.normal, facing @ [0, 0.5, 0.87], atol=1e-9)


@pytest.mark.parametrize(("server", "catches"), [(1, True), (0, False)])
def test_key_poses_of_the_other_player(server: int, catches: bool) -> None:
    """Who serves is in place for the catch and faces the net as in the next rally; who receives only walks."""
    made = a_walk(((0.0, -4.0), (1.5, -5.0)), server=server)
    line = made._timeline(1, np.zeros(3))
    poses = {int(frame): pose for frame, pose in zip(line.frame, line.pose, strict=True)}
    assert line.hits == ()
    assert len(line.stands) == 2
    assert (made.catch in poses) == catches
    turning = sorted(set(poses) - {0, made.catch, made.frames - 3, made.frames - 1})
    way = np.array([-0.8, -3.5]) - [1.5, -5.0]
    turn = np.arctan2(-way[0], way[1])
    assert turning == [round((0.35 + 0.28 * abs(turn - 0.2)) * FPS), made.arrival[1] - 40]
    rest = made.athletes[1].library.rest
    for frame in turning:
        assert poses[frame][HIPS_YAW] == pytest.approx(turn)
        assert_allclose(np.delete(poses[frame], HIPS_YAW), np.delete(rest, HIPS_YAW))
    if catches:
        caught = poses[made.catch]
        assert_allclose(caught[FREE_ARM], 0.3)
        assert caught[HIPS_YAW] == pytest.approx(0.2)
        assert_allclose(
            np.delete(caught, [HIPS_YAW, *range(FREE_ARM.start, FREE_ARM.stop)]),
            np.delete(rest, [HIPS_YAW, *range(FREE_ARM.start, FREE_ARM.stop)]),
        )
    assert poses[made.frames - 1][HIPS_YAW] == pytest.approx(0.2)


@pytest.mark.parametrize(("facing", "right_handed"), [(1.0, True), (-1.0, True), (1.0, False), (-1.0, False)])
def test_players_are_put_onto_the_court(facing: float, right_handed: bool) -> None:
    """Half a turn for seat 1, a mirror for a left-hander, whose bones and feet of left and right change places."""
    rng = np.random.default_rng(0)
    turn = Rotation.random(2 * 23, random_state=1).as_matrix().reshape(2, 23, 3, 3)
    place = rng.normal(size=(2, 23, 3))
    planted = np.array([[True, False], [True, True]])
    feet = Feet(np.zeros((2, 2, 3)), np.zeros((2, 2)), np.zeros((2, 2)), planted)
    signs = Athlete(seat=0, facing=facing, right_handed=right_handed, skeleton=MALE).signs
    quaternions, places, stands = onto_court(turn, place, feet, signs)
    half_turn, flip = np.diag([facing, facing, 1.0]), np.diag([1.0 if right_handed else -1.0, 1.0, 1.0])
    for bone, name in enumerate(BONES):
        other = name if right_handed else name.replace("Right", "*").replace("Left", "Right").replace("*", "Left")
        source = BONES.index(other)
        assert_allclose(places[:, bone], place[:, source] @ (half_turn @ flip).T, atol=1e-12)
        assert_allclose(matrix(quaternions[:, bone]), half_turn @ flip @ turn[:, source] @ flip, atol=1e-9)
    assert stands.tolist() == ([[True, True], [False, True]] if right_handed else [[True, True], [True, False]])


def test_players_of_a_rally() -> None:
    nothing = np.zeros(0, np.int64)
    rally = Rally(
        catalogue=default_game().catalogue,
        server=0,
        stroke=nothing,
        hurried=nothing > 0,
        ending=RETURNED_BELOW,
        hands=("left", "right"),
    )
    first, second = players_of(rally, (MALE, load_skeleton("female")))
    assert [(who.seat, who.facing, who.right_handed, who.skeleton.name) for who in (first, second)] == [
        (0, rally.facing(0), False, "male"),
        (1, rally.facing(1), True, "female"),
    ]
    assert first.signs.tolist() == [-rally.facing(0), rally.facing(0), 1]
