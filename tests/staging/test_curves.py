"""Curves, rotations and flights beside those of scipy, and against what physics says."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from shuttle_marl.staging import BONES, SWEET_SPOT, Motion, StagingError, load_skeleton, stage, with_walk
from shuttle_marl.staging.arm import LIMITS, SWING_1, SWING_2, SWING_LIMIT, Goal, anywhere, arm_of, solve, solve_best
from shuttle_marl.staging.curves import curve, curve_at, slopes_through
from shuttle_marl.staging.flight import GRAVITY, LENGTH, TERMINAL, Flights, fall, shoot
from shuttle_marl.staging.rotation import exponential, from_yaw_pitch_roll, matrix, quaternion, turned
from tests import golden
from tests.staging.conftest import HANDS
from tests.staging.motion_metrics import to_yaw_pitch_roll

STEPS = st.lists(st.integers(1, 9), min_size=1, max_size=8)


def poses(steps: list[int], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Key frames, and three curves of which one is flat in places."""
    frame = np.cumsum([4, *steps]).astype(np.int64)
    pose = np.random.default_rng(seed).normal(size=(len(frame), 3))
    pose[:, 1] = np.round(pose[:, 1])
    return frame, pose


@settings(max_examples=60, deadline=None)
@given(STEPS, st.integers(0, 1000))
def test_curves_are_those_of_scipy(steps: list[int], seed: int) -> None:
    frame, pose = poses(steps, seed)
    slope = slopes_through(frame, pose)
    np.testing.assert_allclose(slope, PchipInterpolator(frame, pose, axis=0)(frame, 1), atol=1e-12)
    spline, frames = CubicHermiteSpline(frame, pose, slope, axis=0), int(frame[-1]) + 5
    when = np.clip(np.arange(frames), frame[0], frame[-1])
    np.testing.assert_allclose(curve(frame, pose, slope, frames), spline(when), atol=1e-12)
    for now in range(int(frame[0]), int(frame[-1])):
        for found, order in zip(curve_at(frame, pose, slope, now), (0, 1), strict=True):
            np.testing.assert_allclose(found, spline(now, order), atol=1e-12)


ANGLE = st.floats(-3.1, 3.1)


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_quaternions_and_matrices_of_any_shape(shape: tuple[int, ...]) -> None:
    v = np.random.default_rng(0).normal(size=(*shape, 3))
    turn = exponential(v)
    assert turn.shape == (*shape, 3, 3)
    q = quaternion(turn)
    assert q.shape == (*shape, 4)
    assert (q[..., 3] >= 0).all()
    np.testing.assert_allclose(matrix(q), turn, atol=1e-15)
    np.testing.assert_allclose(matrix(2 * q), turn, atol=1e-15)


@given(angle=ANGLE)
def test_rotation_vectors_turn_about_their_own_direction(angle: float) -> None:
    np.testing.assert_allclose(exponential(np.array([0.0, 0.0, angle])), turned(angle), atol=1e-15)


@given(yaw=ANGLE, pitch=st.floats(-1.5, 1.5), roll=ANGLE)
def test_angles_of_the_body_are_found_again(yaw: float, pitch: float, roll: float) -> None:
    angles = [np.array(angle) for angle in (yaw, pitch, roll)]
    np.testing.assert_allclose(to_yaw_pitch_roll(from_yaw_pitch_roll(*angles)), angles, atol=1e-9)


TARGETS = st.tuples(
    st.floats(-2.5, 2.5),
    st.floats(-6.5, -0.4),
    st.floats(0.3, 2.8),
    st.floats(-2.5, 2.5),
    st.floats(0.4, 6.5),
    st.floats(0.02, 2.8),
)


def shot(numbers: tuple[float, ...], seconds: float) -> Flights:
    values = np.array(numbers)
    return shoot(values[None, :3], values[None, 3:], np.array([seconds]))


def integrated(start: np.ndarray, velocity: np.ndarray, seconds: float) -> np.ndarray:
    """Place of a shuttle after some seconds, by a Runge-Kutta method of order 8 with tight tolerances."""

    def change(_: float, state: np.ndarray) -> np.ndarray:
        v = state[3:]
        return np.r_[v, -np.linalg.norm(v) * v / LENGTH - np.array([0, 0, GRAVITY])]

    return solve_ivp(change, (0, seconds), np.r_[start, velocity], method="DOP853", rtol=1e-9, atol=1e-9).y[:3, -1]


@settings(max_examples=40, deadline=None)
@given(TARGETS, st.floats(0.35, 2.0))
def test_a_flight_ends_at_its_target_in_time(numbers: tuple[float, ...], seconds: float) -> None:
    flight = shot(numbers, seconds)
    ends, _ = flight.at(0, np.array([0.0, seconds]))
    np.testing.assert_allclose(ends[0], numbers[:3], atol=1e-9)
    np.testing.assert_allclose(ends[1], numbers[3:], atol=1e-3)


@settings(max_examples=20, deadline=None)
@given(TARGETS, st.floats(0.4, 1.6))
def test_the_same_launch_integrated_precisely_arrives_too(numbers: tuple[float, ...], seconds: float) -> None:
    flight = shot(numbers, seconds)
    position, velocity = flight.at(0, np.array([0.0]))
    half, _ = flight.at(0, np.array([seconds / 2]))
    for share, expected in ((1.0, np.array(numbers[3:])), (0.5, half[0])):
        np.testing.assert_allclose(integrated(position[0], velocity[0], share * seconds), expected, atol=0.02)


def test_a_falling_shuttle_comes_to_its_terminal_speed() -> None:
    """Closed form: v = U tanh(g t / U)."""
    drop = fall(np.array([[0.0, 0.0, 50.0]]), np.zeros((1, 3)), np.array([4.0]), steps=32)
    for seconds in (0.3, 1.0, 3.9):
        _, velocity = drop.at(0, np.array([seconds]))
        assert abs(-velocity[0, 2] - TERMINAL * np.tanh(GRAVITY * seconds / TERMINAL)) < 0.03


ANGLES = st.lists(st.floats(0.02, 0.98), min_size=10, max_size=10)


def angles_of(shares: list[float]) -> np.ndarray:
    low, high = LIMITS.T
    return arm_of(load_skeleton("male")).clipped((low + np.array(shares) * (high - low))[None])


def goal_at(angles: np.ndarray, weight: tuple[float, float, float, float]) -> Goal:
    """Reach of an arm with these angles, as a goal."""
    arm = arm_of(load_skeleton("male"))
    pose = arm.pose(angles)
    shaft, normal = pose.rotation[4] @ arm.axis, pose.rotation[4] @ arm.normal
    elbow = pose.position[2] - pose.position[1]
    return Goal(
        point=pose.position[4] + SWEET_SPOT * shaft,
        reach=np.full(len(angles), SWEET_SPOT),
        shaft=shaft,
        normal=normal,
        elbow=elbow / np.linalg.norm(elbow, axis=1, keepdims=True),
        weight=np.tile(weight, (len(angles), 1)),
    )


def test_what_can_be_reached_is_reached() -> None:
    rng = np.random.default_rng(5)
    arm = arm_of(load_skeleton("male"))
    angles = arm.clipped(rng.uniform(LIMITS[:, 0], LIMITS[:, 1], (300, 10)))
    goal = goal_at(angles, (60.0, 0.1, 0.05, 0.05))
    pose = arm.pose(solve_best(arm, goal, anywhere(300), rounds=40))
    miss = np.linalg.norm(pose.position[4] + SWEET_SPOT * pose.rotation[4] @ arm.axis - goal.point, axis=1)
    assert np.quantile(miss, 0.95) < 0.01
    assert np.median(miss) < 0.001


@settings(max_examples=40, deadline=None)
@given(ANGLES, st.tuples(*[st.floats(-1.5, 1.5)] * 3), st.tuples(*[st.floats(-1, 1)] * 3))
def test_no_goal_makes_the_arm_break_its_limits(shares: list[float], point: tuple[float, ...], shaft: tuple[float, ...]) -> None:
    arm = arm_of(load_skeleton("female"))
    direction = np.array([shaft]) + np.array([[0.0, 0.0, 1.5]])
    goal = Goal(
        point=np.array([point]),
        reach=np.array([SWEET_SPOT]),
        shaft=direction / np.linalg.norm(direction),
        normal=np.array([[0.0, 1.0, 0.0]]),
        elbow=np.array([[1.0, 0.0, 0.0]]),
        weight=np.array([[8.0, 0.5, 0.5, 0.3]]),
    )
    found = solve(arm, goal, angles_of(shares), rounds=15)
    assert np.isfinite(found).all()
    assert (found >= LIMITS[:, 0] - 1e-9).all()
    assert (found <= LIMITS[:, 1] + 1e-9).all()
    assert np.linalg.norm(found[0, SWING_1 : SWING_2 + 1]) <= SWING_LIMIT + 1e-9


FPS = 50


@pytest.fixture(scope="module", params=(1, 2), ids=[f"{a}-{b}" for a, b in HANDS[1:3]])
def match(request: pytest.FixtureRequest, played) -> list[Motion]:
    """Four rallies of two players, each served by the winner of the one before."""
    rallies = [played[4 * request.param]]
    for rally in played[4 * request.param + 1 : 4 * request.param + 4]:
        rallies.append(dataclasses.replace(rally, server=rallies[-1].winner))
    handed = [dataclasses.replace(rally, hands=HANDS[request.param]) for rally in rallies]
    return [stage(rally, seed=i, athletes=("male", "female")) for i, rally in enumerate(handed)]


@pytest.fixture(scope="module")
def walks(match) -> list[tuple[Motion, Motion, Motion]]:
    """A rally, the same with its walk, and the next rally."""
    return [(rally, with_walk(rally, following), following) for rally, following in itertools.pairwise(match)]


def test_the_rally_stays_and_the_walk_ends_in_the_next_one(walks) -> None:
    for rally, whole, following in walks:
        n = len(rally.time)
        for name in ("rotation", "position", "planted", "shuttle", "shuttle_velocity"):
            assert (getattr(whole, name)[:n] == getattr(rally, name)).all()
        assert 2.5 < (len(whole.time) - n) / FPS < 13
        assert np.abs(whole.position[-1, :, 0] - following.position[0, :, 0]).max() < 2e-3, "the hips"
        assert np.abs(whole.position[-1] - following.position[0]).max() < 0.06
        assert np.abs(whole.shuttle[-1] - following.shuttle[0]).max() < 0.02
        assert np.abs(whole.position[n] - whole.position[n - 1]).max() < 0.06


def test_walks_are_those_that_somebody_looked_at(walks) -> None:
    found = {}
    for i, (rally, whole, _) in enumerate(walks):
        name = f"{'-'.join(rally.trajectory.rally.hands)}, {i}"
        for part in ("shuttle", "position", "planted"):
            found[f"{name}, {part}"] = golden.weighted_sum(getattr(whole, part)[len(rally.time) :])
        found[f"{name}, rotation"] = golden.weighted_sum(matrix(whole.rotation[len(rally.time) :]))
    golden.check("walks", found, 1e-3)


def test_players_walk_and_their_feet_do_not_slide(walks) -> None:
    for rally, whole, _ in walks:
        part = slice(len(rally.time) - 1, None)
        hips = whole.position[part, :, 0, :2].astype(float)
        assert np.hypot(*np.moveaxis(np.diff(hips, axis=0), -1, 0)).max() * FPS < 2.5
        for foot, name in enumerate(("LeftToeBase", "RightToeBase")):
            stands = whole.planted[part, :, foot]
            way = np.hypot(*np.moveaxis(np.diff(whole.position[part, :, BONES.index(name), :2].astype(float), axis=0), -1, 0))
            assert way[stands[1:] & stands[:-1]].max() < 3e-3
        for seat in (0, 1):
            toes = whole.position[part, seat][:, [BONES.index("LeftToeBase"), BONES.index("RightToeBase")], 2]
            under = rally.skeletons[seat].at("RightToeBase")[2] - toes
            assert under.max() < 5e-3, "no foot is under the floor"
            knees = whole.position[part, seat][:, [BONES.index("LeftLeg"), BONES.index("RightLeg")], 2]
            assert knees.min() > 0.1
        assert whole.position[part, :, 0, 2].min() > 0.4, "the hips are lowest in the pick-up"


def test_what_does_not_follow_is_refused(match, played) -> None:
    following = dataclasses.replace(played[1], hands=match[0].hands)
    with pytest.raises(StagingError, match="unpacked"):
        with_walk(Motion.unpack(match[0].pack()), match[1])
    with pytest.raises(StagingError, match="different fps"):
        with_walk(match[0], stage(following, seed=0, athletes=("male", "female"), fps=100))
    with pytest.raises(StagingError, match="different skeletons"):
        with_walk(match[0], stage(following, seed=0))
    with pytest.raises(StagingError, match="different hands"):
        with_walk(match[0], stage(played[1], seed=0, athletes=("male", "female")))
    there = stage(dataclasses.replace(played[1], ends_changed=True), seed=0, athletes=("male", "female"))
    with pytest.raises(StagingError, match="change ends"):
        with_walk(match[0], there)
    opened = dataclasses.replace(following, stroke=played[1].stroke[:1], hurried=played[1].hurried[:1], ending=2)
    with pytest.raises(StagingError, match="the rally continues"):
        with_walk(stage(opened, seed=0, athletes=("male", "female")), match[1])
