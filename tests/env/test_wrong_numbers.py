"""Options, seeds and actions that are no whole numbers are refused: none is cut off, and none ends in an error of numpy."""

import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.errors import ActionError, OptionError, ShuttleError
from shuttle_marl.env.batched import RallyEnv, VersusEnv
from shuttle_marl.env.single import SingleMatchEnv, SingleRallyEnv
from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.game.rules import IllegalStrokeError
from shuttle_marl.kernel import KernelError, RallyBatch

RAW = [rally_v0.raw_env, match_v0.raw_env]
ALL = [*RAW, rally_v0.env, match_v0.env]


@pytest.mark.parametrize("make", ALL)
@pytest.mark.parametrize("limit", [2.5, 2.0, "2", 0, -1])
def test_a_limit_of_strokes_is_a_whole_number(make, limit):
    with pytest.raises(OptionError, match=f"max_strokes {limit!r}: expected a whole number, 1 or more"):
        make(max_strokes=limit)
    assert make(max_strokes=np.int64(2)).unwrapped.max_strokes == 2


@pytest.mark.parametrize("make", ALL)
@pytest.mark.parametrize("seed", [1.5, 1.0, "1", np.float64(1)])
def test_a_seed_is_a_whole_number(make, seed):
    with pytest.raises(OptionError, match=r"seed .*: expected a whole number"):
        make().reset(seed=seed)


@pytest.mark.parametrize("make", [RallyEnv, VersusEnv])
def test_a_seed_of_a_batched_environment_is_a_whole_number(make):
    with pytest.raises(OptionError, match=r"seed 1\.5: expected a whole number"):
        make(2, seed=1.5)
    with pytest.raises(OptionError, match=r"seed 1\.5: expected a whole number"):
        make(2)._set_seed(1.5)


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
def test_batched_environments_refuse_strokes_that_are_not_whole(make):
    env = make(2)
    td = env.reset()
    td["action"] = torch.tensor([0.5, 1.5])
    with pytest.raises(KernelError, match=r"strokes: float32 of shape \(2,\); expected int64"):
        env.step(td)


@pytest.mark.parametrize("type_", [float, bool, complex, object, str])
def test_the_vector_environment_refuses_actions_that_are_not_whole(type_):
    env = RallyVectorEnv(3)
    env.reset(seed=1)
    with pytest.raises(ActionError, match=r"expected 3 integers from 0 to \d+"):
        env.step(np.zeros(3).astype(type_))


@pytest.mark.parametrize("make", [SingleRallyEnv, SingleMatchEnv])
@pytest.mark.parametrize("action", [1.5, "1", np.float32(1), [0]])
def test_environments_of_one_player_refuse_actions_that_are_not_whole(make, action):
    env = make(opponent="random")
    env.reset(seed=1)
    with pytest.raises(ActionError, match="is not a stroke"):
        env.step(action)


def test_there_is_one_error_of_an_illegal_stroke():
    env = rally_v0.raw_env(server=0)
    env.reset(seed=1)
    illegal = int(np.flatnonzero(env.observe("player_0")["action_mask"] == 0)[0])
    with pytest.raises(IllegalStrokeError) as caught:
        env.step(illegal)
    assert (caught.value.stroke, caught.value.row) == (illegal, None)
    with pytest.raises(IllegalStrokeError) as caught:
        RallyBatch(env.game, 2).step(np.array([0, illegal]))
    assert (caught.value.stroke, caught.value.row) == (illegal, 1)
    assert issubclass(IllegalStrokeError, ShuttleError)
