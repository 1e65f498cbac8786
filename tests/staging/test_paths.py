"""Curves and jumps, paths of hips and shuttle, idle movements, and swings: parts by hand, systems beside those of numpy."""

import dataclasses
import types
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from shuttle_marl.base.arrays import F64
from shuttle_marl.game import default_game
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.game.rules import FAULT, WINNER
from shuttle_marl.staging import body, curves, load_skeleton
from shuttle_marl.staging import trajectory as paths
from shuttle_marl.staging.arm import LIMITS, arm_of, sweet_spot_jacobian
from shuttle_marl.staging.flight import GRAVITY, fall, shoot
from shuttle_marl.staging.idle import habits
from shuttle_marl.staging.library import FREE_ARM, NEEDS, RACKET_ARM, TRUNK, bent, library_of, pointed
from shuttle_marl.staging.motions import LEFT, MOTIONS, RIGHT, SERVE_BACKHAND, Stance
from shuttle_marl.staging.poses import CONTACT, STROKES
from shuttle_marl.staging.skeleton import HIPS_YAW, SPINE_PITCH, chest_of
from shuttle_marl.staging.timeline import feet_at
from shuttle_marl.staging.trajectory import NET, OUT, RESTING, RETURN, WIN, Trajectory, own_frame
from tests import golden

MALE = load_skeleton("male")
FPS = 50
RIGHTWARDS, FORWARD, UP = np.eye(3)


def test_moving_means_and_maxima() -> None:
    """The Hann window of half width 1 weighs (1, 2, 1); the first and the last value hold beyond the ends."""
    x = np.array([0.0, 4.0, 0.0, 0.0, 8.0])
    assert curves.held_ends(x, 2).tolist() == [0, 0, 0, 4, 0, 0, 8, 8, 8]
    assert curves.smooth(x, 1) == pytest.approx([1, 2, 1, 2, 6])
    assert curves.widen(x, 1).tolist() == [4, 4, 4, 8, 8]
    assert curves.ease(np.array([-1.0, 0.0, 0.25, 0.5, 1.0, 2.0])) == pytest.approx([0, 0, 0.15625, 0.5, 1, 1])


def test_a_jump_obeys_gravity_between_take_off_and_landing() -> None:
    """Hips sink before and after it, with speed and acceleration of a body: no jump of the speed, at most twice gravity."""
    height, dt = 0.3, 1e-3
    half = np.sqrt(2 * height / 9.81)
    assert curves.half_time(height) == pytest.approx(half)
    since = np.arange(-1.2, 1.2, dt)
    for sink, depth in ((0.0, 9.81 * height / 17), (0.4, 0.4)):
        hips, air = curves.leap(since, height, sink)
        flying = np.abs(since) < half
        assert_allclose(hips[flying], height - 9.81 / 2 * since[flying] ** 2, atol=1e-9)
        assert_allclose(air[flying], hips[flying], atol=1e-9)
        assert (air[~flying] == 0).all()
        speed = np.gradient(hips, dt)
        assert np.abs(np.diff(speed)).max() < 20 * dt
        assert hips[since < 0].min() == pytest.approx(-9.81 * height / 15, abs=1e-3), "the take-off pushes with 15 m/s²"
        assert hips[since > 0].min() == pytest.approx(-depth, abs=1e-3)
        rising = np.gradient(speed, dt)[since < -half - 2 * 9.81 * height / 15 / (9.81 * half) - 0.01]
        assert np.abs(rising).max() == pytest.approx(12, rel=0.03)
        back = np.gradient(speed, dt)[since > half + 2 * depth / (9.81 * half) + 0.01]
        assert np.abs(back).max() == pytest.approx(7, rel=0.03)
        assert hips[0] == hips[-1] == 0


def differences(n: int, order: int) -> F64:
    return np.diff(np.eye(n), order, axis=0)


@pytest.mark.parametrize("n", [2, 3, 7])
def test_the_system_of_the_path_is_solved(n: int) -> None:
    rng = np.random.default_rng(n)
    weight, still, bands = rng.uniform(0.5, 2, n), rng.uniform(0, 1, n - 1), np.empty((3, n))
    paths._factor(weight, still, 0.3, 2.0, 0.7, bands)
    square = np.diag(weight) + 2.0 * differences(n, 1).T @ np.diag(still + 0.3) @ differences(n, 1)
    square += 0.7 * differences(n, 2).T @ differences(n, 2)
    right = rng.normal(size=(n, 2))
    found = right.copy()
    paths._solve(bands, found)
    assert_allclose(found, np.linalg.solve(square, right), rtol=1e-9)


def test_vectors_are_projected_onto_a_disc() -> None:
    """With relaxation 1.5: one and a half times the new vector, less half of the old projection, plus the multiplier."""
    now = np.array([[3.0, 4.0], [0.1, 0.0]])
    projected, scaled = np.array([[1.0, 0.0], [0.2, 0.2]]), np.array([[0.5, 0.0], [0.0, 0.1]])
    assert paths._project(now, 2.0, projected, scaled, 1.5) == pytest.approx(5.0)
    length = np.hypot(4.5, 6.0)
    assert_allclose(projected, [[2 * 4.5 / length, 2 * 6.0 / length], [0.05, 0.0]], atol=1e-12)
    assert_allclose(scaled, [[4.5 - 9.0 / length, 6.0 - 12.0 / length], [0.0, 0.0]], atol=1e-12)


def test_the_smoothest_path_without_limits_is_that_of_the_least_squares() -> None:
    rng, n = np.random.default_rng(0), 60
    weight, still = np.full(n, 0.5), np.full(n - 1, 0.004)
    target = weight[:, None] * np.cumsum(rng.normal(0, 0.01, (n, 2)), axis=0)
    square = np.diag(weight) + FPS**2 * differences(n, 1).T @ np.diag(still) @ differences(n, 1)
    square += 2e-3 * FPS**4 * differences(n, 2).T @ differences(n, 2)
    assert_allclose(paths._smoothest(weight, target, still, FPS), np.linalg.solve(square, target), atol=2e-3)


def test_the_smoothest_path_keeps_the_limits_of_a_runner() -> None:
    """A place 9.5 m away is wanted in one and a half seconds: the runner keeps below 12 m/s² and 6.5 m/s."""
    n = 100
    weight, target = np.full(n, 1e-3), np.zeros((n, 2))
    weight[[0, -1]] += 50.0
    target[-1] = 50.0 * np.array([9.0, 3.0])
    still = np.full(n - 1, 4e-3)
    still[:25] += 50.0
    path = paths._smoothest(weight, target, still, FPS)
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1) * FPS
    acceleration = np.linalg.norm(np.diff(path, 2, axis=0), axis=1) * FPS**2
    assert 5.7 < speed.max() < 6.5
    assert 9.5 < acceleration.max() < 12.0


CATALOGUE = default_game().catalogue
SERVE = CATALOGUE.index("short-serve:front-centre:below:backhand")
LIFT = next(k for k, name in enumerate(CATALOGUE.names) if name.startswith("lift:back-centre:below"))
SMASH = next(k for k, name in enumerate(CATALOGUE.names) if name.startswith("smash:"))


def a_rally(ending: int = WINNER, hurried: tuple[bool, ...] = (False, False, False), **others: Any) -> Rally:
    stroke = np.array([SERVE, LIFT, SMASH])
    return Rally(catalogue=CATALOGUE, server=0, stroke=stroke, hurried=np.array(hurried), ending=ending, **others)


def a_trajectory(end: int = WIN, **others: Any) -> Trajectory:
    """Serve after 1 s, lift after 2 s, smash after 3.2 s, which ends at 3.6 s."""
    contact = np.array([[0.0, -2.5, 1.0], [0.3, 2.2, 0.8], [-0.4, -5.0, 2.6]])
    stop = np.array([[0.3, 2.2, 0.8], [-0.4, -5.0, 2.6], [1.0, 4.0, RESTING] if end in (WIN, OUT) else [0.0, -0.02, 1.2]])
    time, end_time = np.array([1.0, 2.0, 3.2]), np.array([2.0, 3.2, 3.6])
    motions = [SERVE_BACKHAND, MOTIONS.index("lunge"), MOTIONS.index("overhead")]
    stance = tuple(
        Stance(motion=motion, heading=0.0, root=np.array([0.1 * k, -2.0 - k]), reach=0.0) for k, motion in enumerate(motions)
    )
    base = np.arange(12.0).reshape(3, 2, 2) / 10 - [0, 4]
    given: dict[str, Any] = {
        "rally": a_rally(WINNER if end == WIN else FAULT),
        "time": time,
        "contact": contact,
        "end": np.array([RETURN, RETURN, end]),
        "end_time": end_time,
        "chosen_point": stop,
        "end_point": stop.copy(),
        "flight": shoot(contact, stop, end_time - time),
        "stance": stance,
        "base": base,
        "before": np.array([[0.2, -2.4], [-0.3, -3.0]]),
    }
    return Trajectory(**(given | others))


def test_signs_between_the_court_and_a_player() -> None:
    assert own_frame(1.0).tolist() == [1, 1, 1]
    assert own_frame(-1.0).tolist() == [-1, -1, 1]
    assert own_frame(1.0, False).tolist() == [-1, 1, 1]
    assert own_frame(-1.0, False).tolist() == [1, -1, 1]


def test_contacts_are_moved_with_the_flights_to_and_from_them() -> None:
    old = a_trajectory()
    new = paths.with_contacts_moved(old, {0: np.array([0.1, 0.0, 0.0]), 2: np.array([0.0, 0.0, 0.2])})
    assert_allclose(new.contact - old.contact, [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.2]], atol=1e-12)
    assert_allclose(new.end_point - old.end_point, [[0.0, 0.0, 0.0], [0.0, 0.0, 0.2], [0.0, 0.0, 0.0]], atol=1e-12)
    for i in range(3):
        ends, _ = new.flight.at(i, np.array([0.0, old.end_time[i] - old.time[i]]))
        assert_allclose(ends, [new.contact[i], new.end_point[i]], atol=2e-3)
    once = paths.with_contacts_moved(old, {2: np.array([0.0, 0.0, 0.2])})
    assert once.flight.launch_speed[0] == old.flight.launch_speed[0], "the serve stays as it was"
    assert (once.flight.launch_speed[1:] != old.flight.launch_speed[1:]).all()


def test_the_first_strokes_of_one_rally_and_the_last_of_another() -> None:
    old, new = a_trajectory(), a_trajectory(NET)
    rest = {name: getattr(new, name)[2:] for name in paths._BY_STROKE}
    whole = paths.behind(old, dataclasses.replace(new, **rest, flight=type(new.flight)(*(p[2:] for p in new.flight))), 2)
    assert whole.end.tolist() == [RETURN, RETURN, NET]
    assert_allclose(whole.end_point, new.end_point)
    assert len(whole.flight.start) == 3
    assert len(whole.stance) == 5, "two of the old ones and the three that were given"


def test_the_shuttle_flies_falls_from_the_net_and_rolls() -> None:
    frames = 300
    position, velocity = paths.shuttle_path(a_trajectory(), frames, FPS)
    assert_allclose(position[:50], np.tile([0.0, -2.5, 1.0], (50, 1)))
    assert (velocity[:50] == 0).all()
    for i, frame in enumerate((50, 100, 160)):
        assert_allclose(position[frame], a_trajectory().contact[i], atol=2e-3)
        assert_allclose(velocity[frame], a_trajectory().flight.velocity(i, 0), atol=1e-6)
    later, _ = paths.shuttle_path(a_trajectory(), frames, FPS, 2)
    assert_allclose(later[:160], np.tile([0.0, -2.5, 1.0], (160, 1)))
    assert_allclose(later[160:], position[160:])
    # On the floor it bounces by a height, slides on a little and lies still.
    assert_allclose(position[181], [*position[181, :2], max(RESTING, position[181, 2])])
    assert position[181:, 2].max() < 0.3
    assert position[-1, 2] == RESTING
    landed, way = a_trajectory().end_point[-1, :2], a_trajectory().flight.velocity(2, -1)[:2]
    assert_allclose(position[-1, :2], landed + 0.12 * way * 0.25, atol=1e-3)
    assert_allclose(velocity[200], (position[201] - position[199]) * FPS / 2, atol=1e-9)
    assert np.abs(velocity[-1]).max() < 1e-2
    # From the net it drops a little back, and rolls where it lands.
    trajectory = a_trajectory(NET)
    position, velocity = paths.shuttle_path(trajectory, frames, FPS)
    hit = trajectory.flight.velocity(2, -1)
    dropped = fall(np.array([[0.0, -0.02, 1.2]]), np.array([[-0.04 * hit[0], -0.05 * hit[1], 0.3 * hit[2]]]), np.array([2.5]), 32)
    free = dropped.at(0, np.arange(1, 60) / FPS)[0]
    landed = np.flatnonzero(free[:, 2] <= RESTING)[0]
    assert 15 < landed < 25
    assert_allclose(position[181 : 181 + landed], free[:landed], atol=1e-9)
    assert (position[181 + landed :, 2] < 0.1).all()
    assert position[-1, 1] < -0.02, "on the striker's half"
    assert position[-1, 2] == RESTING
    nothing = dataclasses.replace(a_rally(), stroke=np.zeros(0, np.int64), hurried=np.zeros(0, bool), ending=2)
    empty: dict[str, Any] = {name: np.zeros((0, *np.shape(getattr(trajectory, name))[1:])) for name in paths._BY_STROKE}
    waiting, still = paths.shuttle_path(dataclasses.replace(trajectory, rally=nothing, **empty), 3, FPS)
    assert_allclose(waiting, np.tile([0.2, -2.4, 1.0], (3, 1)) * [nothing.facing(0), nothing.facing(0), 1])
    assert (still == 0).all()


def test_the_bounce_depends_on_the_speed_of_the_landing() -> None:
    time = np.arange(30) / FPS
    for down, up in ((-2.0, 0.36), (-20.0, 1.0)):
        position, velocity = np.zeros((30, 3)), np.zeros((30, 3))
        paths._roll(position, velocity, 5, np.array([1.0, 2.0, 0.5]), np.array([4.0, 0.0, down]), time)
        since = (np.arange(25) + 0.5) / FPS
        assert (position[:5] == 0).all()
        assert_allclose(position[5:, 0], 1 + 0.12 * 4 * 0.25 * (1 - np.exp(-4 * since)))
        assert_allclose(position[5:, 1], 2.0)
        assert_allclose(position[5:, 2], np.maximum(RESTING, RESTING + up * since - 9.81 / 2 * since**2))
        assert_allclose(velocity[6:-1], (position[7:] - position[5:-2]) * FPS / 2)
    paths._roll(position, velocity, 29, np.zeros(3), np.array([4.0, 0.0, -1.0]), time)
    assert (velocity[29] == 0).all()


def test_the_server_drops_the_shuttle_onto_the_racket() -> None:
    """A backhand serve releases it 0.06 s before the contact: gravity brings it there in three frames."""
    position, palm = np.zeros((80, 3)), np.tile(np.linspace(0, 0.1, 80)[:, None], (1, 3))
    position[50:] = [0.3, -2.0, 1.0]
    before = position.copy()
    trajectory = a_trajectory()
    paths.held(position, palm, np.array([50, 100]), trajectory, FPS)
    assert_allclose(position[:48], palm[:48])
    assert_allclose(position[50:], before[50:])
    steps = np.diff(position[47:51], 2, axis=0) * FPS**2
    assert_allclose(steps, np.tile([0, 0, -GRAVITY], (2, 1)), atol=1e-9)
    paths.held(position, palm, np.zeros(0, dtype=np.int64), trajectory, FPS)
    assert_allclose(position, palm)


def test_hips_are_wanted_at_stances_bases_and_places_for_the_serve() -> None:
    trajectory, frames = a_trajectory(), 220
    shift = np.zeros((3, 2))
    shift[0], shift[2] = [0.01, 0.02], [0.05, -0.05]
    for seat, hits, waits in ((0, {0: 50, 2: 160}, {1: 100}), (1, {1: 100}, {0: 50, 2: 160})):
        weight, target, still = paths._wishes(trajectory, seat, shift, frames, FPS)
        place = target / weight[:, None]
        assert_allclose(place[0], trajectory.before[seat] + (shift[0] if seat == 0 else 0), atol=1e-4)
        assert weight[0] == pytest.approx(50.001)
        for i, frame in hits.items():
            assert weight[frame] == pytest.approx(4000.001)
            assert_allclose(place[frame], trajectory.stance[i].root + shift[i], atol=1e-4)
        for i, frame in waits.items():
            assert_allclose(weight[frame - 3 : frame + 4], 6.001)
            assert_allclose(weight[[frame - 4, frame + 4]], 0.001)
            assert_allclose(place[frame], trajectory.base[i, seat], atol=1e-3)
        assert_allclose(place[30], trajectory.before[seat])
        # Calm before the serve, at contacts, at the opponent's, and at the end.
        expected = np.full(frames - 1, 4e-3)
        expected[:50] += 3
        for frame in hits.values():
            expected[frame - 4 : frame + 5] += 0.6
        for frame in waits.values():
            expected[frame - 5 : frame + 6] += 1.2
        expected[-15:] += 5
        assert_allclose(still, expected)
        if seat == 1:
            # The receiver goes half of the way to a winner, to at most 0.8 m from the net.
            landing = trajectory.rally.facing(1) * trajectory.end_point[-1, :2]
            wanted = trajectory.base[2, 1] + 0.55 * (landing - trajectory.base[2, 1])
            assert_allclose(place[180], [wanted[0], min(wanted[1], -0.8)], atol=1e-3)
            assert weight[180] == pytest.approx(60.001)
    hurried = dataclasses.replace(trajectory, rally=a_rally(hurried=(False, False, True)))
    *_, still = paths._wishes(hurried, 0, shift, frames, FPS)
    assert_allclose(still[162:171], 0.604)
    assert_allclose(still[[161, 171]], 0.004), "a hurried player brakes after the contact"
    reply = Stance(motion=0, heading=0.0, root=np.array([7.0, -7.0]), reach=0.0)
    for seat, place in ((0, None), (1, reply.root)):
        weight, target, _ = paths._wishes(dataclasses.replace(trajectory, reply=reply), seat, shift, frames, FPS)
        assert weight[-1] == pytest.approx(0.001 if place is None else 60.001)
        if place is not None:
            assert_allclose(target[-1] / weight[-1], place, atol=1e-3)


def test_a_continued_way_begins_where_the_player_was() -> None:
    trajectory, shift = a_trajectory(), np.zeros((3, 2))
    whole = paths.travel(trajectory, 0, shift, 220, FPS)
    again = paths.travel(trajectory, 0, shift, 220, FPS, whole[:120])
    assert (again[:120] == whole[:120]).all()
    assert np.abs(again - whole).max() < 0.05
    moved = paths.travel(trajectory, 0, shift, 220, FPS, whole[:120] + 0.3)
    assert_allclose(moved[119] - whole[119], 0.3)
    assert np.linalg.norm(np.diff(moved, 2, axis=0), axis=1).max() * FPS**2 < 12


def test_idle_movements_are_those_that_somebody_looked_at() -> None:
    """Of both players, in a rally with a smash, while it is open, while they wait for the serve, and in many attacks."""
    trajectory, nothing = a_trajectory(), np.zeros(0, np.int64)
    time = np.linspace(1.0, 14.5, 16)
    long = dataclasses.replace(a_rally(), stroke=np.array([SERVE] + 15 * [SMASH]), hurried=np.zeros(16, bool))
    told = dataclasses.replace(trajectory, rally=long, time=time, end_time=time + 0.9)
    tired = habits(told, 0, 11, 900, FPS)
    assert_allclose(tired.pose[860, SPINE_PITCH], 0.10, atol=0.05)
    waiting = dataclasses.replace(a_rally(), stroke=nothing, hurried=nothing > 0, ending=2)
    found = {"idle, tired": [golden.weighted_sum(tired.pose), golden.weighted_sum(tired.place)]}
    for name, rally, rows in (("over", trajectory.rally, 3), ("open", a_rally(2), 3), ("waiting", waiting, 0)):
        told = dataclasses.replace(trajectory, rally=rally, time=trajectory.time[:rows], end_time=trajectory.end_time[:rows])
        for seat in (0, 1):
            added = habits(told, seat, 11, 400, FPS)
            found[f"idle, {name}, {seat}"] = [golden.weighted_sum(added.pose), golden.weighted_sum(added.place)]
            if rows:
                own = np.flatnonzero(rally.striker == seat)
                for frame in np.rint(trajectory.time[own] * FPS).astype(int):
                    near = slice(frame - 3, frame + 4)
                    assert np.abs(added.place[near]).max() < 1e-12, "nothing is idle around an own contact"
                    assert np.abs(added.pose[near, HIPS_YAW]).max() < 1e-12
    golden.check("idle", found, 1e-6)


def test_trunks_bend_for_contacts_of_other_heights() -> None:
    """Hips take a share of the height within bounds, a lower contact bows hips and spine."""
    upright = np.zeros(7)
    upright[0] = 0.9
    for motion, need, height, bow in (
        ("overhead", 0.2, 0.0, 0.0),
        ("around the head", -0.2, -0.11, 0.0),
        ("backhand overhead", -0.5, -0.16, 0.0),
        ("lunge", 0.1, 0.048, -4.0),
        ("backhand lunge", 0.6, 0.21, -16.0),
        ("lunge", -0.1, -0.048, 4.0),
        ("lunge", -0.6, -0.10, 22.0),
        ("side arm", 0.1, 0.04, -3.6),
        ("backhand side arm", 0.6, 0.14, -14.4),
        ("defence", -0.5, -0.14, 18.0),
        ("backhand defence", -0.7, -0.14, 22.0),
        ("net kill", 0.1, 0.035, -2.0),
        ("backhand serve", 0.5, 0.12, -8.0),
        ("forehand serve", -0.5, -0.10, 10.0),
    ):
        found = bent(upright, MOTIONS.index(motion), np.array([need, 0.0]))
        assert_allclose(found[1], upright)
        assert_allclose(found[0] - upright, [height, 0, np.radians(0.45 * bow), 0, 0, np.radians(0.55 * bow), 0], atol=1e-12)


def test_a_lunge_for_a_high_shuttle_holds_the_racket_up_and_the_elbow_down() -> None:
    for motion, name in enumerate(MOTIONS):
        key = STROKES[motion].keys[CONTACT]
        shaft, elbow = (v / np.linalg.norm(v) for v in map(np.array, (key.shaft, key.elbow)))
        found = pointed(motion, np.array([-0.2, 0.0, 0.1, 0.5, 0.9]))
        for k, more in enumerate((0.0, 0.0, 0.1, 0.5, 0.5)):
            up = more if "lunge" in name else 0.0
            for direction, plain, change in zip(found, (shaft, elbow), (2.6, -0.9), strict=True):
                expected = plain + change * up * UP
                assert_allclose(direction[k], expected / np.linalg.norm(expected), atol=1e-12)


def test_natural_contacts_of_other_heights_are_in_between() -> None:
    library = library_of(MALE)
    assert_allclose(NEEDS, (-0.5, -0.28, -0.06, 0.16, 0.38, 0.6), atol=1e-12)
    for motion in range(len(MOTIONS)):
        own, table = library.contact[motion, 0], library.contact[motion, 1:]
        for need, expected in (
            (-0.28, table[1]),
            (0.05, (table[2] + table[3]) / 2),
            (0.6, table[5]),
            (2.0, table[5]),
            (-9, table[0]),
        ):
            found = library.natural(motion, own[2] + need)
            assert_allclose(found, [*expected[:2], own[2]], atol=1e-9)


def test_feet_at_a_contact_turn_with_the_player_and_reach_for_wide_shuttles() -> None:
    root = np.array([0.5, -3.0])
    for motion, name in enumerate(MOTIONS):
        left, right, last = STROKES[motion].feet
        for heading, reach, high in ((0.0, 0.0, 0.0), (0.4, 1.0, 0.0), (-0.3, 0.5, 0.2), (0.2, 0.0, 0.9), (0.0, 0.0, -0.4)):
            spots = np.array([left, right])
            if name in ("defence", "side arm"):
                spots[RIGHT, 0] += 0.16 * reach
            if name == "backhand defence":
                spots[LEFT, 0] -= 0.16 * reach
            if "lunge" in name:
                spots[RIGHT, 1] += 0.05 * reach
                spots[:, 1] *= 1 - 0.9 * min(max(high, 0.0), 0.5)
            turn = Rotation.from_euler("z", heading).as_matrix()[:2, :2]
            place, yaw, foot = feet_at(motion, root, heading, reach, high)
            assert_allclose(place, root + spots[:, :2] @ turn.T, atol=1e-12)
            assert_allclose(yaw, np.radians(spots[:, 2]) + heading)
            assert foot == last


def test_key_poses_of_contacts_have_no_grip_which_follows_from_the_shuttle() -> None:
    assert {stroke.keys[CONTACT].grip for stroke in STROKES.values()} == {(0, 0, 0)}


def test_a_swing_moves_the_strings_as_wanted_or_as_fast_as_the_joints_allow() -> None:
    arm, rng = arm_of(MALE), np.random.default_rng(0)
    angles = LIMITS.mean(axis=1) + 0.2 * rng.uniform(-1, 1, (6, 10)) * np.ptp(LIMITS, axis=1)
    before, after = np.full(6, 0.1), np.full(6, 0.12)
    jacobian = sweet_spot_jacobian(arm, angles)
    easy = rng.normal(0, 1.0, (6, 3))
    slow = body.swing(arm, angles, easy, before, after)
    assert_allclose(np.einsum("nij,nj->ni", jacobian, slow), easy, atol=0.05)
    hard = body.swing(arm, angles, 300 * easy, before, after)
    most = np.array([7, 7, 24, 24, 36, 32, 36, 24, 14, 0])
    assert (np.abs(hard) <= most + 1e-9).all()
    assert (np.abs(slow[:, 9]) < 1e-12).all(), "the grip does not turn"
    # No joint could have been in its place at the load, or will be at the follow-through, beyond its limits.
    for n in range(6):
        for q, speed, (low, high) in zip(angles[n], hard[n], LIMITS, strict=True):
            back, ahead = ((q - low) / 0.1, (high - q) / 0.12) if speed > 0 else ((high - q) / 0.1, (q - low) / 0.12)
            assert abs(speed) <= 2.2 * min(back, ahead) + 1e-9
    assert (np.abs(hard) > 0.99 * np.minimum(most, 1e9)).any(axis=1).sum() >= 1
    # Joints at their limit leave the rest to the others.
    speed = body.swing(arm, angles, 16 * easy, before, after)
    miss = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, speed) - 16 * easy, axis=1)
    assert ((np.abs(speed[:, :9]) > most[:9] - 1e-6).any(axis=1) & (miss < 0.15)).sum() >= 3
    # Cheaper joints do more: least cost of all speeds that move the strings as wanted.
    cost = np.array([0.5, 0.5, 0.13, 0.13, 0.12, 0.12, 0.14, 0.30, 0.34, 50.0]) ** -2
    for n in range(6):
        square = jacobian[n] * cost @ jacobian[n].T + 0.02 * np.eye(3)
        assert_allclose(slow[n], cost * (jacobian[n].T @ np.linalg.solve(square, easy[n])), atol=1e-9)


def test_a_continued_curve_joins_the_one_before_in_value_and_slope() -> None:
    before = np.column_stack([np.linspace(0, 2, 5), np.ones(5)])
    after = np.column_stack([np.linspace(3, 3.9, 19), np.full(19, 0.5)])
    found = body._joined(before, after)
    assert len(found) == 18
    assert_allclose(found[9:], after[10:], atol=1e-12)
    first, slope = found[0] - before[-1], before[-1] - before[-2]
    assert np.abs(first - slope).max() < 0.07
    u = 1 / 9
    ease = u * u * (3 - 2 * u)
    off, drift = before[-1] - after[0], slope - (after[1] - after[0])
    assert_allclose(found[0], after[1] + (1 - ease) * off + u * (1 - u) ** 2 * 9 * drift)
    assert len(body._joined(before, after[:1])) == 0
    assert_allclose(
        body._joined(before[-1:], after)[0], after[1] + (1 - ease) * off - u * (1 - u) ** 2 * 9 * (after[1] - after[0])
    )


def test_the_head_looks_at_the_shuttle_as_far_as_the_neck_turns() -> None:
    """Eyes are 15 cm above the neck; the head stays within 95 % of 72 degrees aside, 50 up and 55 down."""
    frames = 30
    chest, middle = np.tile(np.eye(3), (frames, 1, 1)), np.zeros((frames, 3))
    eyes = MALE.at("Neck") - MALE.at("Spine2") + [0, 0, 0.15]
    for way, yaw, pitch in (
        ((0, 5, 0), 0.0, 0.0),
        ((-3, 3, 0), 45.0, 0.0),
        ((3, 3, 3 * np.sqrt(2) * np.tan(np.radians(20))), -45.0, -20.0),
        ((0, 3, -3 * np.tan(np.radians(30))), 0.0, 30.0),
        ((5, 0, 0), -0.95 * 72, 0.0),
        ((-5, -1, 0), 0.95 * 72, 0.0),
        ((0, 0.1, 5), 0.0, -0.95 * 50),
        ((0, 0.1, -5), 0.0, 0.95 * 55),
    ):
        found = np.degrees(body._gaze(MALE, chest, middle, np.tile(eyes + way, (frames, 1))))
        assert_allclose(found[:, 1], pitch, atol=1e-9)
        assert_allclose(found[:, 0], yaw, atol=3.0 if abs(way[1]) < 0.2 else 1e-9)
    left = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    turned = np.degrees(
        body._gaze(MALE, np.tile(left, (frames, 1, 1)), middle, np.tile(left @ (eyes + 5 * FORWARD), (frames, 1)))
    )
    assert_allclose(turned, 0, atol=1e-9)
    # A jump of the shuttle is followed within 11 frames.
    jump = np.tile(eyes + 5 * FORWARD, (frames, 1))
    jump[15:] = eyes + 3 * FORWARD - 3 * RIGHTWARDS
    aside = np.degrees(body._gaze(MALE, chest, middle, jump)[:, 0])
    assert_allclose(aside[:10], 0, atol=1e-9)
    assert_allclose(aside[20:], 45, atol=1e-9)
    assert (np.diff(aside[9:21]) > 0).all()
    assert aside[14] + aside[15] == pytest.approx(45)


def test_a_pose_has_a_trunk_and_two_arms() -> None:
    assert [(part.start, part.stop) for part in (TRUNK, RACKET_ARM, FREE_ARM)] == [(0, 7), (7, 17), (17, 27)]


def test_the_spine_leans_towards_the_shuttle_by_eighteen_degrees_at_most() -> None:
    pose = np.zeros((1, 27))
    hips, lean = np.array([[0.0, 0.0, 0.9]]), np.zeros((1, 3))
    arm = types.SimpleNamespace(seen=np.array([[0.3, 0.6, 0.4]]))
    for away in ([0.0, 0.02, 0.0], [0.01, 0.0, -0.02], [3.0, 3.0, -3.0]):
        from_here = chest_of(MALE, hips, pose)
        point = from_here[1] + from_here[0][0] @ arm.seen[0] + away
        found = body._leant(MALE, hips, pose, lean, arm.seen, point)
        assert (np.delete(found, [4, 5, 6], axis=1) == 0).all()
        assert np.abs(found[:, 4:7]).max() <= np.radians(18) + 1e-12
        chest, collar = chest_of(MALE, hips, found)
        left = np.linalg.norm(point - collar - chest[0] @ arm.seen[0])
        assert left < 0.75 * np.linalg.norm(away) or np.abs(found[:, 4:7]).max() == pytest.approx(np.radians(18))
        # The step of damped least squares, by small changes of each angle.
        steps = []
        for k in range(3):
            near = pose.copy()
            near[0, 4 + k] = 1e-5
            chest, collar = chest_of(MALE, hips, near)
            steps.append((collar[0] + chest[0] @ arm.seen[0] - (point[0] - away)) / 1e-5)
        slope = np.array(steps).T
        step = np.linalg.solve(slope.T @ slope + 0.02 * np.eye(3), slope.T @ away)
        assert_allclose(found[0, 4:7], np.clip(step, -np.radians(18), np.radians(18)), rtol=2e-3, atol=1e-5)
