"""Options that are not there, and seeds and strokes that are no whole numbers: none is cut off or ends in an error of numpy."""

import functools
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.errors import OptionError
from shuttle_marl.env.batched import RallyEnv, VersusEnv
from shuttle_marl.env.open_spiel import RallyGame
from shuttle_marl.env.single import SingleMatchEnv, SingleRallyEnv
from shuttle_marl.env.vector import MatchVectorEnv
from shuttle_marl.game.policy import PolicyError, States
from shuttle_marl.kernel import KernelError
from tests.exact.exact_games import random_game, random_policy

RAW = [rally_v0.raw_env, match_v0.raw_env]
ALL = [*RAW, rally_v0.env, match_v0.env]


class ReadsScore:
    """A policy for matches alone."""

    reads_score = True

    def probabilities(self, states: States) -> np.ndarray:
        return states.mask / states.mask.sum(axis=1, keepdims=True)


rows = functools.partial(gymnasium.make_vec, "shuttle_marl/Rally-v0", num_envs=2)
single = functools.partial(gymnasium.make, "shuttle_marl/Rally-v0")


@pytest.mark.parametrize(
    ("make", "options", "error", "message"),
    [
        *((make, {"max_strokes": n}, OptionError, f"max_strokes {n!r}: expected a whole") for make in RAW for n in (2.0, "2", 0)),
        (rally_v0.env, {"server": 2}, OptionError, "server 2"),
        (rally_v0.env, {"render_mode": "video"}, OptionError, "human, rgb_array, ansi"),
        (rally_v0.env, {"action": "multi"}, OptionError, "'flat' or 'components'"),
        *((make, {"mask": "nowhere"}, OptionError, "expected '") for make in (rally_v0.env, match_v0.env, single)),
        *((make, {"info": "some"}, OptionError, "expected '") for make in (rally_v0.env, match_v0.env, single)),
        (match_v0.env, {"first_server": -1}, OptionError, "first_server -1"),
        (match_v0.env, {"reward": "game"}, OptionError, "'rally'"),
        (SingleRallyEnv, {"seat": 2}, OptionError, "seat 2: expected 0 or 1"),
        (SingleRallyEnv, {"opponent": "none such"}, PolicyError, "no policy 'none such'"),
        (SingleRallyEnv, {"opponent": ReadsScore()}, OptionError, "'ReadsScore' reads the score, which a rally does not have"),
        (SingleRallyEnv, {"opponent": random_policy(random_game(1), 0)}, PolicyError, "tabulated for another game"),
        (SingleMatchEnv, {"first_server": 2}, OptionError, "first_server 2"),
        (rows, {"observation": "pixels"}, OptionError, "observation 'pixels'"),
        (rows, {"seat": 7}, KernelError, "seat 7"),
        (functools.partial(MatchVectorEnv, 2), {"reward": "game"}, OptionError, "reward 'game'"),
        (functools.partial(MatchVectorEnv, 2), {"opponent": ReadsScore()}, PolicyError, "reads the score"),
        (VersusEnv, {"batch": 4, "opponents": "bcc"}, PolicyError, "no policy 'bcc'; did you mean bc"),
        (VersusEnv, {"batch": 4, "opponents": ["bc", ReadsScore()]}, PolicyError, "'ReadsScore' reads the score"),
        (VersusEnv, {"batch": 4, "opponents": []}, KernelError, "no policy: expected one or more"),
        (VersusEnv, {"batch": 4, "threads": 0}, KernelError, "threads 0"),
        *((RallyGame, {"params": wrong}, OptionError, "expected") for wrong in ({"server": 2}, {"max_strokes": -1})),
    ],
)
def test_options_that_are_not_there(make: Any, options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make(**options)


@pytest.mark.parametrize("make", ALL)
@pytest.mark.parametrize("seed", [1.0, "1"])
def test_a_seed_is_a_whole_number(make, seed):
    with pytest.raises(OptionError, match=r"seed .*: expected a whole number"):
        make().reset(seed=seed)


@pytest.mark.parametrize("make", RAW)
def test_nothing_is_played_before_the_first_reset(make):
    for play in (lambda env: env.step(0), lambda env: env.step(None), lambda env: env.forfeit()):
        env = make()
        with pytest.raises(ResetNeeded, match="no episode has started; call reset"):
            play(env)
    seen, reward, terminated, truncated, info = make().last()
    assert not seen["action_mask"].any()
    assert (reward, terminated, truncated, info) == (0.0, False, False, {})


@pytest.mark.parametrize("make", [RallyEnv, VersusEnv])
def test_batched_environments_refuse_what_is_not_whole(make):
    with pytest.raises(OptionError, match=r"seed 1\.5: expected a whole number"):
        make(2, seed=1.5)
    env = make(2)
    td = env.reset()
    td["action"] = torch.tensor([0.5, 1.5])
    with pytest.raises(KernelError, match=r"strokes: float32 of shape \(2,\); expected int64"):
        env.step(td)
