"""Curves, rotations and flights beside those of scipy, and against what physics says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from shuttle_marl.staging.curves import curve, curve_at, slopes_through
from shuttle_marl.staging.flight import GRAVITY, LENGTH, TERMINAL, Flights, fall, shoot
from shuttle_marl.staging.rotation import about, exponential, from_yaw_pitch_roll, matrix, quaternion, to_yaw_pitch_roll

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
    axis = np.array([0.6, 0.0, -0.8])
    np.testing.assert_allclose(exponential(angle * axis), about(axis, angle), atol=1e-15)


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
