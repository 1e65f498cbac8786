"""Rewards of a turn: what an agent is told has happened since its last action adds up to what was given."""

from typing import Any

import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.game.scoring import Rules

SHORT = Rules(points=3, clear=2, cap=4, games=1)


@pytest.mark.parametrize(("env", "episodes"), [(rally_v0.env(), 20), (match_v0.env(rules=SHORT, reward="rally"), 3)], ids=str)
def test_rewards_of_turns_add_up(env: Any, episodes: int) -> None:
    rng = np.random.default_rng(0)
    for episode in range(episodes):
        env.reset(seed=episode)
        given, told = dict.fromkeys(env.possible_agents, 0.0), dict.fromkeys(env.possible_agents, 0.0)
        for agent in env.agent_iter():
            _, reward, over, cut, _ = env.last()
            told[agent] += reward
            if over or cut:
                env.step(None)
                continue
            env.step(int(rng.choice(np.flatnonzero(env.observe(agent)["action_mask"]))))
            for each, points in env.rewards.items():
                given[each] += points
        assert told == given
        assert sum(given.values()) == 0
        assert any(given.values())
