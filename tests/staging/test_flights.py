"""Flights of the shuttle beside an exact integration, its terminal speed, and the Laws."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from shuttle_marl.court.staging.flight import GRAVITY, LENGTH, TERMINAL, Flights, fall, net_height, shoot

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


def test_the_net_is_higher_at_the_posts() -> None:
    """Law 1: 1.524 m in the middle and 1.55 m over the side lines."""
    np.testing.assert_allclose(net_height(np.array([-3.05, 0.0, 3.05])), [1.55, 1.524, 1.55])
