"""Libraries as they come, unmodified, on the environments: sb3-contrib, TorchRL's wrappers."""

from types import ModuleType

import gymnasium
import numpy as np
import pytest

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.game import default_game

NAMES = ("shuttle_marl/Rally-v0", "shuttle_marl/Match-v0")


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", NAMES)
def test_stable_baselines_finds_the_environment_in_order(name: str) -> None:
    from sb3_contrib.common.maskable.utils import is_masking_supported
    from stable_baselines3.common.env_checker import check_env
    from stable_baselines3.common.env_util import make_vec_env

    env = gymnasium.make(name)
    check_env(env, warn=True)
    assert is_masking_supported(env)
    vector = make_vec_env(name, n_envs=2)
    assert is_masking_supported(vector)
    assert not np.any(vector.env_method("action_masks")), "no rally has begun"
    vector.reset()
    masks = np.stack(vector.env_method("action_masks"))
    assert masks.shape == (2, default_game().n_strokes)
    assert masks.any(axis=1).all()


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("module", [rally_v0, match_v0])
def test_torchrl_rolls_pettingzoo_out(module: ModuleType) -> None:
    import torch
    from torchrl.envs.libs.pettingzoo import PettingZooWrapper

    env = PettingZooWrapper(module.env(), use_mask=True)
    env.set_seed(3)
    rewards: dict[str, list[float]] = {"player_0": [], "player_1": []}
    for _ in range(20 if module is rally_v0 else 4):  # many short rallies, or parts of long matches
        rollout = env.rollout(100)
        for player, found in rewards.items():
            now, following = rollout[player], rollout["next", player]
            acts = now["mask"].squeeze(-1)
            legal = now["action_mask"].squeeze(1).gather(1, now["action"]).squeeze(1)
            assert legal[acts].all()
            found.append(float(following["reward"].sum()))
        acting = torch.cat([rollout[player]["mask"] for player in rewards], dim=1)
        assert (acting.sum(dim=1) == 1).all(), "one of the two strikes"
    if module is rally_v0:
        assert rewards["player_0"] == [-reward for reward in rewards["player_1"]]
        assert set(rewards["player_0"]) == {-1.0, 1.0}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("wrapped", [False, True])
def test_torchrl_rolls_gymnasium_out(wrapped: bool, name: str) -> None:
    import torch
    from torchrl.envs.libs.gym import GymEnv, GymWrapper
    from torchrl.envs.utils import check_env_specs

    env = GymWrapper(gymnasium.make(name, opponent="bc")) if wrapped else GymEnv(name, opponent="bc")
    check_env_specs(env, seed=0)
    rollout = env.rollout(100, break_when_any_done=False)
    assert rollout.batch_size == torch.Size([100])
    assert rollout["action_mask"].shape == (100, default_game().n_strokes)
    over = rollout["next", "terminated"]
    assert over.any()
    assert torch.equal(rollout["next", "reward"] != 0, over)
