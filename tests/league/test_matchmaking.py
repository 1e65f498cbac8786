"""Opponents of learners: weights that never vanish, draws by weight, and the order in which opponents come."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.training.league.schedule import FLOOR, chosen, order, prioritised, uniform


@pytest.mark.parametrize("win", [[1.0, 1.0, 1.0], [0.0, 0.0], [np.nan, np.nan], [1.0], [1 - 1e-17, 1.0]])
def test_alike_opponents_are_met_alike_however_one_sided(win: list[float]) -> None:
    assert np.allclose(prioritised(win), 1 / len(win))


def test_opponents_that_win_are_met_most() -> None:
    weight = prioritised([1.0, 0.5, 0.0])
    assert np.allclose(weight, (1 - FLOOR) * np.array([0, 0.2, 0.8]) + FLOOR / 3)
    assert len(prioritised([])) == 0
    assert len(uniform(0)) == 0


@given(st.lists(st.floats(0, 1) | st.sampled_from([0.0, 1.0, float("nan")]), min_size=1, max_size=50))
def test_weights_are_always_probabilities(win: list[float]) -> None:
    weight = prioritised(win)
    assert weight.sum() == pytest.approx(1)
    assert weight.min() >= FLOOR / len(win) / 2


def test_more_opponents_than_places_are_drawn_by_weight() -> None:
    rng = np.random.default_rng(0)
    weight = np.array([0.0, 1, 1, 6])
    drawn, shares = chosen(weight, 4, rng)
    assert drawn.tolist() == [1, 2, 3]
    assert shares.tolist() == [0.125, 0.125, 0.75]
    counts = np.zeros(4)
    for _ in range(2000):
        one, all_of_it = chosen(weight, 1, rng)
        counts[one] += 1
        assert all_of_it.tolist() == [1.0]
    assert np.allclose(counts / 2000, weight / 8, atol=0.04)
    assert len(chosen(np.zeros(3), 2, rng)[0]) == 0


def test_the_order_keeps_the_shares_and_spreads_them() -> None:
    met = order([0.1, 0.25], 200)
    assert [(met == k).sum() for k in (-1, 0, 1)] == [130, 20, 50]
    assert np.diff(np.flatnonzero(met == 0)).max() <= 12
    assert (order([0.5, 0.5]) >= 0).all()
    assert (order([]) == -1).all()
