"""The compiled collector and the collector of TorchRL over the environment play the same rallies."""

import numpy as np
import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs.utils import ExplorationType

from shuttle_marl.env.batched import VersusEnv
from shuttle_marl.game import default_game, tabulate
from shuttle_marl.policy import resolve
from shuttle_marl.training import PPOConfig
from shuttle_marl.training.networks import make_actor, set_temperature
from shuttle_marl.training.ppo import PPO

GAME = default_game()
SEED, STROKES = 7, 400


@pytest.mark.parametrize("opponent", ["bc", "minimax"])
def test_training_collects_the_rallies_of_a_torchrl_collector_over_the_environment(opponent: str) -> None:
    torch.manual_seed(1)
    learner = PPO(PPOConfig(batch=STROKES), GAME, [tabulate(resolve(opponent, GAME), GAME)])
    actor = make_actor(GAME, width=learner.config.width, hidden=learner.config.hidden, log_prob=False)
    actor.load_state_dict(learner.actor.state_dict())
    # So sharp that it plays its likeliest stroke: whose random number chooses then makes no difference.
    for network in (actor, learner.actor):
        set_temperature(network, 1e-6)
    ours = learner.collector
    ours.set_seed(SEED)
    ours.collect()
    played = ours.sampler.record(ours.sampler.numbers)
    env = VersusEnv(1, opponents=opponent, game=GAME, seed=SEED)
    options = {"frames_per_batch": STROKES, "total_frames": STROKES, "auto_register_policy_transforms": False}
    theirs = Collector(env, actor, exploration_type=ExplorationType.DETERMINISTIC, **options)
    data = next(iter(theirs)).squeeze(0)
    theirs.shutdown()
    own, won = [], []
    for server, winner, strokes in zip(
        played.server, played.winner, np.split(played.stroke, np.cumsum(played.length)[:-1]), strict=True
    ):
        of_learner = strokes[server::2].tolist()
        own += of_learner
        won += [2.0 * (winner == 0) - 1.0] if of_learner else []
    assert data["action"].ravel().tolist() == own[:STROKES]
    rewards = data["next", "reward"].ravel()[data["next", "done"].ravel()].tolist()
    assert len(rewards) > 50
    assert rewards == won[: len(rewards)]
    assert len(set(own)) > 10
