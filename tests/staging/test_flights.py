"""Flights by hand: their heights, bounds, and steps; heights of contacts, kinds of motion, and stances."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shuttle_marl.base.arrays import F64
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES
from shuttle_marl.staging import flight as flights
from shuttle_marl.staging.flight import BOUNDS, CLEARANCE, GRAVITY, LENGTH, STEPS, TERMINAL, Bounds, Flights, fall, net_height
from shuttle_marl.staging.motions import (
    BACKHANDS,
    HELD,
    MOTIONS,
    OVERHEADS,
    SERVE_BACKHAND,
    SERVE_FOREHAND,
    STRIDES,
    height_range,
    motion_of,
    stance_of,
)


def straight(start: tuple[float, float, float], heading: tuple[float, float], along: float, rise: float) -> Flights:
    """One flight of a second in a straight line at constant speed, known at three instants."""
    time = np.array([[0.0, 0.4, 1.0]])
    level, up = np.full((1, 3), along), np.full((1, 3), rise)
    return Flights(np.array([start]), np.array([heading]), time, along * time, rise * time, level, up)


def test_a_flight_is_read_between_its_instants_and_held_at_its_ends() -> None:
    path = straight((1.0, -2.0, 1.5), (0.6, 0.8), 5.0, -1.0)
    place, velocity = path.at(0, np.array([-1.0, 0.0, 0.1, 0.7, 1.0, 3.0]))
    for t, found in zip((0.0, 0.0, 0.1, 0.7, 1.0, 1.0), place, strict=True):
        assert_allclose(found, [1 + 3 * t, -2 + 4 * t, 1.5 - t], atol=1e-12)
    assert_allclose(velocity, np.tile([3.0, 4.0, -1.0], (6, 1)), atol=1e-12)
    assert_allclose(path.velocity(0, -1), [3.0, 4.0, -1.0])
    assert path.launch_speed == pytest.approx(np.sqrt(26))
    assert path.apex == pytest.approx(1.5)
    assert straight((0.0, 0.0, 1.0), (0.0, 1.0), 3.0, 2.0).apex == pytest.approx(3.0)


def test_cubics_between_two_instants() -> None:
    """Of the polynomial t³ between t = 0.2 and 0.7: value and slope in the middle."""
    t = np.array([0.2, 0.7])
    value, slope = flights._hermite(t**3, 3 * t**2, np.array([0]), np.array([0.5]), np.array([0.5]))
    assert value == pytest.approx(0.45**3)
    assert slope == pytest.approx(3 * 0.45**2)


@pytest.mark.parametrize(
    ("start", "heading", "height"),
    [
        ((0.0, -2.0, 1.5), (0.0, 1.0), 1.1),
        ((0.0, -2.0, 1.5), (0.6, 0.8), 1.0),
        ((0.0, -4.0, 1.5), (0.6, 0.8), 0.5),
        ((0.0, -4.01, 1.5), (0.6, 0.8), np.inf),  # it comes down before
        ((0.0, 0.0, 1.5), (0.0, 1.0), 1.5),
        ((0.0, 0.1, 1.5), (0.0, 1.0), np.inf),
        ((0.0, -2.0, 1.5), (1.0, 0.0), np.inf),
    ],
)
def test_heights_where_a_flight_crosses_a_plane(
    start: tuple[float, float, float], heading: tuple[float, float], height: float
) -> None:
    path = straight(start, heading, 5.0, -1.0)
    assert path.height_over(0.0) == pytest.approx(height)
    if np.isfinite(height):
        x = start[0] - start[1] * heading[0] / heading[1]
        assert flights.height_over_net(path) == pytest.approx(height - (1.524 + 0.026 * (x / 3.05) ** 2))


def test_the_net_is_higher_at_the_posts() -> None:
    assert_allclose(net_height(np.array([-3.05, 0.0, 1.525, 3.05])), [1.55, 1.524, 1.5305, 1.55])


def test_a_step_of_a_flight() -> None:
    """One step of the Runge-Kutta method, in units in which gravity is 1 and drag the square of the speed."""

    def change(state: F64) -> F64:
        _, _, u, w = state
        return np.array([u, w, -np.hypot(u, w) * u, -np.hypot(u, w) * w - 1.0])

    state = np.array([0.0, 0.0, 1.5, 0.7])
    found = flights._states(np.array([9.0, 1.5]), np.array([9.0, 0.7]), np.array([[0.0, 0.1, 0.3]] * 2))[:, 1]
    assert_allclose(found[:, 0], state)
    for k, h in enumerate((0.1, 0.2), 1):
        a = change(state)
        b = change(state + h / 2 * a)
        c = change(state + h / 2 * b)
        state = state + h / 6 * (a + 2 * b + 2 * c + change(state + h * c))
        assert_allclose(found[:, k], state, atol=1e-14)


def test_steps_grow_as_the_shuttle_slows_down() -> None:
    """Drag alone covers log(1 + v t) in a time t, from rest steps are equal; the last one ends in time."""
    speed, t = np.array([3.0, 0.0]), np.array([2.0, 1.0])
    nodes, *_ = flights._integrate(0.6 * speed, 0.8 * speed, t, 8)
    assert_allclose(np.log1p(3.0 * nodes[0]), np.log1p(6.0) * np.arange(9) / 8, atol=1e-12)
    assert_allclose(nodes[1], np.arange(9) / 8, atol=1e-3)
    assert nodes[:, -1] == pytest.approx(t)
    drop = fall(np.array([[1.0, 2.0, 3.0]]), np.array([[6.0, 8.0, 1.0]]), np.array([0.5]))
    assert drop.time.shape == (1, STEPS + 1)
    assert drop.time[0, -1] == pytest.approx(0.5)
    assert_allclose(drop.heading, [[0.6, 0.8]])
    assert_allclose(drop.velocity(0, 0), [6.0, 8.0, 1.0])
    assert LENGTH == pytest.approx(TERMINAL**2 / GRAVITY) == pytest.approx(4.7135, abs=1e-3)


def test_distances_from_the_bounds_of_a_shot() -> None:
    """5 m/s along and 1 m/s down over the net at 1.1 + 0.2 · 2 m: in metres over the net, and a metre for each 100 km/h."""
    path = straight((0.0, -2.0, 2.0), (0.0, 1.0), 5.0, -1.0)  # 7.6 cm over the net, at 18.36 km/h
    over, kmh = 1.6 - 1.524, 3.6 * np.sqrt(26)

    def excess(met: int = 0, u: float = 0.0, crosses: bool = True, **bounds: object) -> float:
        return float(Bounds(**bounds).excess(path, met, u, crosses=crosses)[0])  # type: ignore[arg-type]

    assert excess() == 0
    assert excess(over=(0.1, 0.2)) == pytest.approx(0.1 - over)
    assert excess(over=(0.0, 0.05)) == pytest.approx(over - 0.05)
    assert excess(over=(0.1, 0.2), met=1) == 0
    assert excess(over_high=(0.1, 0.2), met=1) == pytest.approx(0.1 - over)
    assert excess(kmh=(0, 10)) == pytest.approx(0.01 * (kmh - 10))
    assert excess(kmh=(30, 40), crosses=False) == pytest.approx(0.01 * (30 - kmh))
    assert excess(apex=(2.5, 3)) == pytest.approx(0.5)
    assert excess(apex=(2.5, 3), crosses=False) == 0
    # The upper end comes down by a share of the range.
    assert excess(over=(0.0, 0.1), varied=0.5, u=1.0) == pytest.approx(over - 0.05)
    assert excess(over=(0.0, 0.1), varied=0.5, u=0.4) == 0
    low = straight((0.0, -2.0, 1.95), (0.0, 1.0), 5.0, -1.0)  # 2.6 cm over the net: 9 mm less than the least
    assert Bounds().excess(low, 0, 0.0, crosses=True)[0] == pytest.approx(101 * (CLEARANCE - 0.026))
    assert CLEARANCE == 0.035


@pytest.mark.parametrize(
    ("shot", "over", "over_high", "varied", "kmh", "apex"),
    [
        ("short-serve", 0.24, (0.035, 0.5), 0.6, (0, 75), (0, np.inf)),
        ("long-serve", np.inf, (0.035, np.inf), 0.0, (0, np.inf), (0, 7)),
        ("clear", np.inf, (0.035, np.inf), 0.0, (0, 230), (4, 7)),
        ("lift", np.inf, (0.035, np.inf), 0.0, (0, 150), (4, 7)),
        ("drop", 0.85, (0.035, 1.0), 0.0, (0, 114), (0, np.inf)),
        ("smash", 0.45, (0.035, 0.6), 0.0, (208, 330), (0, np.inf)),
        ("half-smash", 0.45, (0.035, 0.6), 0.0, (130, 200), (0, np.inf)),
        ("drive", 0.40, (0.035, 0.38), 0.0, (80, 220), (0, np.inf)),
        ("push", np.inf, (0.035, np.inf), 0.0, (0, 110), (0, 3.6)),
        ("net-kill", 0.35, (0.035, 0.45), 0.0, (60, 200), (0, np.inf)),
        ("net-shot", 0.23, (0.4, 0.9), 0.7, (0, 70), (0, np.inf)),
        ("block", 0.35, (0.4, 0.9), 0.5, (0, 85), (0, np.inf)),
        ("cross-court-net-shot", 0.23, (0.4, 0.9), 0.7, (0, 75), (0, np.inf)),
    ],
)
def test_each_shot_has_its_heights_and_speeds(
    shot: str, over: float, over_high: tuple[float, float], varied: float, kmh: tuple[float, float], apex: tuple[float, float]
) -> None:
    bounds = BOUNDS[SHOTS.index(shot)]
    assert (bounds.over, bounds.over_high, bounds.varied, bounds.kmh, bounds.apex) == (
        (0.035, over),
        over_high,
        varied,
        kmh,
        apex,
    )


@pytest.mark.parametrize(
    ("shot", "height", "technique", "flat", "expected"),
    [
        ("short-serve", 0, "backhand", False, (0.98, 1.10)),
        ("long-serve", 0, "forehand", False, (0.68, 0.90)),
        ("long-serve", 1, "forehand", False, (0.68, 0.90)),
        ("long-serve", 0, "backhand", False, (0.98, 1.10)),
        ("clear", 0, "forehand", False, (1.05, 1.42)),
        ("clear", 1, "forehand", False, (2.34, 2.60)),
        ("clear", 1, "backhand", False, (2.20, 2.46)),
        ("clear", 1, "around-the-head", False, (2.29, 2.55)),
        ("clear", 1, "around-the-head", True, (2.12, 2.22)),
        ("clear", 0, "forehand", True, (1.05, 1.42)),
        ("lift", 0, "forehand", False, (0.50, 1.20)),
        ("lift", 1, "forehand", False, (1.62, 1.80)),
        ("drop", 0, "forehand", False, (1.05, 1.42)),
        ("drop", 1, "forehand", False, (2.30, 2.59)),
        ("smash", 0, "forehand", False, (1.30, 1.45)),
        ("smash", 1, "forehand", False, (2.50, 2.84)),
        ("half-smash", 0, "forehand", False, (1.30, 1.45)),
        ("half-smash", 1, "forehand", False, (2.42, 2.68)),
        ("drive", 0, "backhand", False, (0.95, 1.42)),
        ("drive", 1, "backhand", False, (1.62, 2.00)),
        ("drive", 1, "backhand", True, (1.58, 1.70)),
        ("drive", 1, "around-the-head", False, (2.12, 2.30)),
        ("drive", 0, "around-the-head", False, (0.95, 1.42)),
        ("push", 0, "forehand", False, (1.05, 1.45)),
        ("push", 1, "forehand", False, (1.60, 1.80)),
        ("net-kill", 0, "forehand", False, (1.38, 1.48)),
        ("net-kill", 1, "forehand", False, (1.70, 2.00)),
        ("net-shot", 0, "forehand", False, (0.75, 1.42)),
        ("net-shot", 1, "forehand", False, (1.60, 1.72)),
        ("block", 0, "forehand", False, (0.55, 1.20)),
        ("block", 1, "forehand", False, (1.60, 1.85)),
        ("cross-court-net-shot", 0, "forehand", False, (0.75, 1.38)),
        ("cross-court-net-shot", 1, "forehand", False, (1.60, 1.72)),
        ("short-serve", 1, "forehand", False, (0.98, 1.10)),
    ],
)
def test_shuttles_are_met_as_high_as_players_meet_them(
    shot: str, height: int, technique: str, flat: bool, expected: tuple[float, float]
) -> None:
    found = height_range(SHOTS.index(shot), height, TECHNIQUES.index(technique), flat=flat)
    assert found == pytest.approx(expected)
    assert (found[0] > 1.55) == (bool(height) and "serve" not in shot)
    assert found[1] < 1.15 or "serve" not in shot, "Law 9"


@pytest.mark.parametrize(
    ("shot", "technique", "z", "from_net", "name"),
    [
        ("short-serve", "backhand", 1.0, 2.5, "backhand serve"),
        ("long-serve", "forehand", 0.8, 2.5, "forehand serve"),
        ("clear", "forehand", 1.0, 5.0, "defence"),
        ("clear", "forehand", 2.11, 1.0, "overhead"),
        ("clear", "backhand", 2.11, 5.0, "backhand overhead"),
        ("clear", "around-the-head", 2.11, 5.0, "around the head"),
        ("drive", "forehand", 2.1, 2.7, "side arm"),
        ("drive", "backhand", 1.56, 2.7, "backhand side arm"),
        ("drive", "forehand", 1.56, 2.69, "net kill"),
        ("drive", "backhand", 2.1, 2.69, "backhand net kill"),
        ("lift", "forehand", 1.55, 2.69, "lunge"),
        ("lift", "backhand", 0.5, 1.0, "backhand lunge"),
        ("lift", "forehand", 1.21, 2.7, "side arm"),
        ("lift", "backhand", 1.55, 2.7, "backhand side arm"),
        ("lift", "forehand", 1.2, 2.7, "defence"),
        ("lift", "backhand", 1.2, 2.7, "backhand defence"),
    ],
)
def test_motions_follow_from_height_and_distance(shot: str, technique: str, z: float, from_net: float, name: str) -> None:
    assert MOTIONS[motion_of(SHOTS.index(shot), TECHNIQUES.index(technique), z, from_net)] == name


def test_kinds_of_motions() -> None:
    assert {MOTIONS[k] for k in OVERHEADS} == {"overhead", "around the head", "backhand overhead"}
    assert {MOTIONS[k] for k in STRIDES} == {"net kill", "backhand net kill", "lunge", "backhand lunge"}
    assert {MOTIONS[k] for k in BACKHANDS} == {name for name in MOTIONS if "backhand" in name}
    # The hand holds the shuttle to the left of where it is struck, higher for a long serve, which falls for longer.
    assert HELD == {SERVE_BACKHAND: ((-0.04, 0.02, 0.04), 0.06), SERVE_FOREHAND: ((-0.12, 0.04, 0.32), 0.26)}


LUNGE, DEFENCE = MOTIONS.index("lunge"), MOTIONS.index("defence")


@pytest.mark.parametrize(
    ("motion", "way", "right_handed", "heading", "root"),
    [
        (DEFENCE, (1.0, 0.5), True, 0.0, (-0.3, -0.4)),
        (DEFENCE, (1.0, 0.5), False, 0.0, (0.3, -0.4)),
        (LUNGE, (0.0, 1.0), True, 0.0, (-0.3, -0.4)),
        (LUNGE, (-1.0, 1.0), True, np.pi / 4, (0.1 * np.sqrt(0.5), -0.7 * np.sqrt(0.5))),
        (LUNGE, (1.0, 1.0), False, -np.pi / 4, (-0.1 * np.sqrt(0.5), -0.7 * np.sqrt(0.5))),
        (LUNGE, (0.2, -3.0), True, -np.pi / 4, (-0.7 * np.sqrt(0.5), -0.1 * np.sqrt(0.5))),
        (LUNGE, (3.0, 0.0), True, np.radians(-55), (-0.49973, 0.01632)),
        (LUNGE, (-3.0, 0.0), True, np.radians(55), (0.15559, -0.47518)),
    ],
)
def test_the_hips_are_where_the_racket_reaches_the_shuttle(
    motion: int, way: tuple[float, float], right_handed: bool, heading: float, root: tuple[float, float]
) -> None:
    """The natural contact is 30 cm to the right and 40 cm in front; a lunge turns to the shuttle by 55 degrees at most."""
    contact = np.array([0.5, -3.0, 1.0])
    found = stance_of(motion, contact, contact[:2] - way, right_handed, np.array([0.3, 0.4, 1.0]))
    assert found.heading == pytest.approx(heading)
    assert found.root - contact[:2] == pytest.approx(np.array(root), abs=1e-4)


def test_hips_stay_behind_the_net_and_wide_shuttles_stretch_the_player() -> None:
    for y, root in ((0.3, -0.45), (-0.04, -0.45), (-0.06, -0.46), (-0.2, -0.6)):
        found = stance_of(DEFENCE, np.array([0.0, y, 1.0]), np.zeros(2), True, np.array([0.0, 0.4, 1.0]))
        assert found.root[1] == pytest.approx(root)
    for far, reach in ((0.9, 0.0), (0.5, 0.0), (1.55, 0.5), (2.2, 1.0), (3.0, 1.0)):
        base = np.array([0.6 * far, -3.0 - 0.8 * far])
        assert stance_of(DEFENCE, np.array([0.0, -3.0, 1.0]), base, True, np.zeros(3)).reach == pytest.approx(reach)
