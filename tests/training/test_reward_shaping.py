"""Reward shaping: what is added to the rewards, and that the entropic risk measure is what the module says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.thresholds import ONE
from shuttle_marl.training import PPOConfig
from shuttle_marl.training.learner import added_rewards, fault_penalty
from tests.reduced import reduced_game

GAME = reduced_game()


def test_bonus_and_penalty_belong_to_the_stroke_that_was_played() -> None:
    added = added_rewards(PPOConfig(bonus=("smash=0.25", "lift=-0.5"), fault_cost=2.0), GAME).reshape(GAME.levels, -1)
    fault = GAME.limits[..., 0] / ONE
    shot = np.array(SHOTS)[GAME.catalogue.shot[GAME.base_pair_stroke]]
    np.testing.assert_allclose(added, 0.25 * (shot == "smash") - 0.5 * (shot == "lift") - 2 * fault, atol=1e-6)


@given(
    cost=st.floats(0, 2),
    aversion=st.floats(0.05, 4),
    probabilities=st.lists(st.floats(0.01, 1), min_size=6, max_size=6),
)
def test_the_penalty_orders_plays_as_the_entropic_risk_does(cost: float, aversion: float, probabilities: list[float]) -> None:
    """Two plays, each with its probabilities to win, to lose to the opponent, and to lose by an own fault."""
    plays = np.array(probabilities).reshape(2, 3)
    plays /= plays.sum(axis=1, keepdims=True)
    outcomes = np.array([1.0, -1.0, -1.0 - cost])
    risk = np.log(plays @ np.exp(-aversion * outcomes)) / aversion
    expected = plays @ np.array([1.0, -1.0, -1.0 - fault_penalty(cost, aversion)])
    if abs(risk[0] - risk[1]) > 1e-9:
        assert (risk[0] < risk[1]) == (expected[0] > expected[1])


def test_the_penalty_without_aversion_is_the_cost() -> None:
    assert fault_penalty(0.7, 0) == 0.7
    assert fault_penalty(0.7, 1e-6) == pytest.approx(0.7, rel=1e-5)
    assert fault_penalty(0, 3) == 0
    assert not PPOConfig(risk_aversion=2.0).shapes_rewards
