"""Reward shaping, the entropic risk measure, and the distribution over legal strokes."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.env.batched import VersusEnv
from shuttle_marl.game import default_game
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.training import PPOConfig
from shuttle_marl.training.learner import added_rewards, fault_penalty
from shuttle_marl.training.networks import LegalStrokes, make_actor, tabulated
from tests.reduced import reduced_game

GAME = reduced_game()


def test_bonus_and_penalty_belong_to_the_stroke_that_was_played() -> None:
    added = added_rewards(PPOConfig(bonus=("smash=0.25", "lift=-0.5"), fault_cost=2.0), GAME).reshape(GAME.levels, -1)
    fault = GAME.limits[..., 0] / ONE
    shot = np.array(SHOTS)[GAME.catalogue.shot[GAME.base_pair_stroke]]
    np.testing.assert_allclose(added, 0.25 * (shot == "smash") - 0.5 * (shot == "lift") - 2 * fault, atol=1e-6)


@given(cost=st.floats(0, 2), aversion=st.floats(0.05, 4), probabilities=st.lists(st.floats(0.01, 1), min_size=6, max_size=6))
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


SHIPPED = default_game()


def masks(states: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(SHIPPED.mask(states))


def test_probabilities_are_those_of_a_softmax_over_the_legal_strokes() -> None:
    rng = np.random.default_rng(0)
    mask = masks(rng.integers(4, SHIPPED.n_states, 64))
    logits = torch.from_numpy(rng.normal(size=(64, SHIPPED.n_strokes)) * 5)
    distribution = LegalStrokes(logits, mask=mask)
    weight = torch.where(mask, logits.exp(), 0.0)
    expected = weight / weight.sum(-1, keepdim=True)
    torch.testing.assert_close(distribution.probs, expected)
    legal = expected > 0
    entropy = -torch.where(legal, expected * expected.clamp_min(1e-300).log(), 0.0).sum(-1)
    torch.testing.assert_close(distribution.entropy(), entropy)
    stroke = expected.argmax(-1)
    torch.testing.assert_close(distribution.log_prob(stroke), expected.gather(-1, stroke[:, None])[:, 0].log())
    assert (distribution.deterministic_sample == stroke).all()


def test_samples_hold_no_illegal_stroke() -> None:
    torch.manual_seed(1)
    mask = masks(np.random.default_rng(1).integers(4, SHIPPED.n_states, 100))
    # Logits so far apart that rounding would show.
    drawn = LegalStrokes(torch.randn(100, SHIPPED.n_strokes) * 12, mask=mask).sample((10_000,))
    assert mask.expand(10_000, -1, -1).gather(-1, drawn[..., None]).all()


def test_the_table_of_an_actor_is_what_it_plays() -> None:
    torch.manual_seed(0)
    actor = make_actor(SHIPPED, width=16, hidden=1)
    table = tabulated(actor, SHIPPED).pair_probabilities()
    state = np.random.default_rng(2).integers(4, SHIPPED.n_states, 50)
    with torch.no_grad():
        seen = {"observation": torch.from_numpy(SHIPPED.observation(state)), "action_mask": masks(state)}
        distribution = actor.get_dist(VersusEnv(50).reset().update(seen))
    for row, s in enumerate(state):
        pairs = slice(SHIPPED.pair_start[s], SHIPPED.pair_start[s + 1])
        expected = distribution.probs[row, SHIPPED.pair_stroke[pairs].astype(np.int64)]
        assert np.abs(table[pairs] - expected.numpy()).max() < 2 / 65535
