"""Equilibria of small games between policies, against known answers and OpenSpiel."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.exact.meta_games import MetaGameError, nash, nash_average

ROCK_PAPER_SCISSORS = np.array([[0.0, -1, 1], [1, 0, -1], [-1, 1, 0]])
TRANSITIVE = np.array([[0.0, 1, 2], [-1, 0, 1], [-2, -1, 0]])


def _with_copy(payoff: np.ndarray) -> np.ndarray:
    """The game with its first policy entered twice."""
    order = [0, *range(len(payoff))]
    return payoff[np.ix_(order, order)]


def test_nash_of_known_games() -> None:
    found = nash(ROCK_PAPER_SCISSORS)
    assert np.allclose(found.row, 1 / 3)
    assert np.allclose(found.column, 1 / 3)
    assert abs(found.value) < 1e-9
    assert np.allclose(nash(TRANSITIVE).row, [1, 0, 0])
    # A game without symmetry, by hand.
    found = nash([[3, -1], [-2, 4]])
    assert np.allclose(found.row, [0.6, 0.4])
    assert np.allclose(found.column, [0.5, 0.5])
    assert found.value == pytest.approx(1.0)


def test_nash_averages_of_known_games() -> None:
    assert np.allclose(nash_average(ROCK_PAPER_SCISSORS), 1 / 3, atol=1e-9)
    assert np.allclose(nash_average(TRANSITIVE), [1, 0, 0], atol=1e-9)
    assert np.allclose(nash_average(np.zeros((4, 4))), 1 / 4, atol=1e-12)
    # Copies share what one would have: the equilibrium is that of the game without the copy.
    assert np.allclose(nash_average(_with_copy(ROCK_PAPER_SCISSORS)), [1 / 6, 1 / 6, 1 / 3, 1 / 3], atol=1e-9)
    assert np.allclose(nash_average(_with_copy(TRANSITIVE)), [1 / 2, 1 / 2, 0, 0], atol=1e-9)
    # Payoffs of any scale need not be antisymmetric to the last digit.
    assert np.allclose(nash_average(1e6 * ROCK_PAPER_SCISSORS + 0.4 * np.eye(3)[[1, 2, 0]]), 1 / 3, atol=1e-6)
    # One who loses to all changes nothing.
    weak = np.pad(ROCK_PAPER_SCISSORS, (0, 1))
    weak[:3, 3], weak[3, :3] = 1, -1
    assert np.allclose(nash_average(weak), [1 / 3, 1 / 3, 1 / 3, 0], atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 7), st.integers(0, 2**32 - 1), st.booleans())
def test_nash_average_is_an_equilibrium_that_treats_copies_alike(n: int, seed: int, whole: bool) -> None:
    rng = np.random.default_rng(seed)
    raw = rng.integers(-3, 4, (n, n)).astype(float) if whole else rng.normal(size=(n, n))
    payoff = raw - raw.T
    p = nash_average(payoff)
    assert p.sum() == pytest.approx(1)
    assert (p >= 0).all()
    assert (p @ payoff).min() > -1e-6 * max(1, np.abs(payoff).max())
    copied = nash_average(_with_copy(payoff))
    assert copied[0] == pytest.approx(copied[1], abs=1e-6)
    entropy = -np.sum(p * np.log(np.maximum(p, 1e-300)))
    other = nash(payoff).row
    assert entropy >= -np.sum(other * np.log(np.maximum(other, 1e-300))) - 1e-6


@pytest.mark.parametrize(
    ("payoff", "says"),
    [
        ([0.0, 1.0], r"payoffs of shape \(2,\): expected a matrix of finite numbers"),
        ([[]], r"payoffs of shape \(1, 0\): expected a matrix of finite numbers"),
        ([[[0.0]]], r"payoffs of shape \(1, 1, 1\): expected a matrix"),
        ([[0.0, np.inf], [0.0, 0.0]], r"payoffs of shape \(2, 2\): expected a matrix of finite numbers"),
        ([[0.0, np.nan], [0.0, 0.0]], r"payoffs of shape \(2, 2\): expected a matrix of finite numbers"),
    ],
)
def test_payoffs_are_matrices_of_finite_numbers(payoff: Any, says: str) -> None:
    for solver in (nash, nash_average):
        with pytest.raises(MetaGameError, match=says):
            solver(payoff)


def test_averages_are_of_square_matrices() -> None:
    for payoff in (np.zeros((2, 3)), np.zeros((2, 1))):
        with pytest.raises(MetaGameError, match="expected a square matrix"):
            nash_average(payoff)
    assert nash(np.zeros((2, 3))).column.shape == (3,)


def test_payoffs_are_antisymmetric_up_to_a_millionth_of_the_largest() -> None:
    for scale in (1e-9, 1.0, 1e6):
        assert np.allclose(nash_average(scale * np.array([[0, 1], [-1 + 0.9e-6, 0]])), [1, 0], atol=1e-6)
        with pytest.raises(MetaGameError, match=r"the payoff matrix is not antisymmetric; expected a = -a\.T"):
            nash_average(scale * np.array([[0, 1], [-1 + 1.1e-6, 0]]))
    with pytest.raises(MetaGameError, match="not antisymmetric"):
        nash_average(np.eye(2))
