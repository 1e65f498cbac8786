"""A player for exploit-v1: plays at random, and then the strokes that won most after each incoming shot type."""

from typing import Any

import gymnasium
import numpy as np

from shuttle_marl.suite import Trained


def train(setting: Any) -> Any:
    """Learn within the budget of strokes and, with recovery, positions; returns a policy and the strokes that it took."""
    game, rng = setting.game, np.random.default_rng(setting.seed)
    env = gymnasium.make("shuttle_marl:shuttle_marl/Rally-v0", opponent=setting.opponent or "bc", game=game)
    won, tried, strokes = np.ones((14, game.n_actions)), np.full((14, game.n_actions), 2.0), 0
    while strokes < min(setting.budget, 10_000) - 200:
        (seen, _), played, over = env.reset(seed=None if strokes else setting.seed), [], False
        while not over:
            stroke = int(rng.choice(np.flatnonzero(seen["action_mask"])))
            incoming = seen["observation"][27:40]
            played.append((int(incoming.argmax()) if incoming.any() else 13, stroke))
            seen, reward, over, _, _ = env.step(stroke)
        for shot, stroke in played:
            won[shot, stroke] += float(reward) > 0
            tried[shot, stroke] += 1
        strokes += len(played)
    return Trained(player=Player((won / tried)[:, : game.n_strokes]), strokes=strokes)


class Player:
    """The legal stroke with the largest fraction of rallies won."""

    def __init__(self, worth: Any) -> None:
        self.worth = worth

    def probabilities(self, states: Any) -> Any:
        """One row of probabilities of all strokes for each state."""
        shot = np.append(states.game.catalogue.shot, 13)[states.incoming]
        best = np.where(states.mask, self.worth[shot], -1).argmax(axis=1)
        return np.eye(states.game.n_strokes)[best]
