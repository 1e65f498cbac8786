"""Policies act on observations of the environments."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.game.layout import GameError, observations, states_of
from shuttle_marl.game.policy import PolicyError, States
from shuttle_marl.policy import resolve
from tests.reduced import reduced_game

GAME = reduced_game()


@pytest.mark.parametrize("name", ["bc", "random", "safe@greedy", "minimax", "tests.policy.test_act:Reader"])
@pytest.mark.parametrize("module", [rally_v0, match_v0])
def test_every_policy_acts_in_a_loop(name: str, module: Any) -> None:
    env = module.env(game=GAME)
    policy, rng = resolve(name, GAME), np.random.default_rng(0)
    env.reset(seed=3)
    strokes = 0
    for _ in env.agent_iter(150):
        observation, _, terminated, truncated, info = env.last()
        assert "illegal" not in str(info)
        env.step(None if terminated or truncated else policy.act(observation, observation["action_mask"], rng))
        strokes += 1
    assert strokes > 2


class Reader:
    """Reads the score, and checks it."""

    reads_score = True

    def probabilities(self, states: States) -> Any:
        assert states.score is None or ((states.score >= 0) & (states.score <= 30)).all()
        return states.mask / states.mask.sum(axis=1, keepdims=True)


def test_observations_determine_states() -> None:
    states = np.flatnonzero(GAME.playable).astype(np.int32)
    assert (states_of(GAME, observations(GAME, states)) == states).all()
    for wrong in (np.zeros((1, 59)), np.zeros(60), np.full((1, 60), 0.5), np.full((1, 60), np.nan)):
        with pytest.raises(GameError):
            states_of(GAME, wrong)


def test_strokes_are_drawn_from_the_probabilities() -> None:
    policy = resolve("bc", GAME)
    state = np.full(20_000, np.flatnonzero(GAME.playable)[40], np.int32)
    seen = observations(GAME, state)
    strokes = policy.act(seen, rng=np.random.default_rng(1))
    p = policy.probabilities(States(game=GAME, state=state[:1]))[0]
    assert np.abs(np.bincount(strokes, minlength=GAME.n_strokes) / len(state) - p).max() < 0.02
    assert policy.act(seen[0], rng=np.random.default_rng(5)) == policy.act(seen[0], rng=np.random.default_rng(5))
    best = int(p.argmax())
    mask = np.arange(GAME.n_strokes) == best
    assert policy.act(seen[0], mask, np.random.default_rng(2)) == best
    with pytest.raises(PolicyError, match="none of the allowed strokes"):
        policy.act(seen[0], np.zeros(GAME.n_strokes), np.random.default_rng(2))


def test_policies_are_copied() -> None:
    policy, seen = resolve("safe", GAME), observations(GAME, np.zeros(1, np.int32))[0]
    for again in (copy.copy(policy), pickle.loads(pickle.dumps(policy))):
        assert again.act(seen, rng=np.random.default_rng(1)) == policy.act(seen, rng=np.random.default_rng(1))
