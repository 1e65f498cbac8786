"""The native vector environment against single ones, and under Gymnasium's own wrappers."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from shuttle_marl.base.errors import ActionError, OptionError
from shuttle_marl.env.single import SingleRallyEnv
from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.game import default_game
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import random_game, random_policy, tiring_game

GAME = default_game()
NAME = "shuttle_marl/Rally-v0"


def make(num_envs: int, **kwargs: Any) -> RallyVectorEnv:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make_vec(NAME, num_envs=num_envs, **kwargs)
    assert isinstance(env, RallyVectorEnv)
    return env


def some_actions(env: RallyVectorEnv, rng: np.random.Generator, illegal: float = 0.0) -> np.ndarray:
    """Mostly legal strokes; some that are not."""
    masks = env.action_masks()
    chosen = np.array([rng.choice(np.flatnonzero(mask)) for mask in masks])
    wrong = np.array([rng.choice(np.flatnonzero(~mask)) for mask in masks])
    return np.where(rng.random(len(masks)) < illegal, wrong, chosen)


def test_spaces_are_those_of_the_single_environment_in_batches() -> None:
    env, single = make(5, opponent="bc"), gymnasium.make(NAME)
    assert env.single_observation_space == single.observation_space
    assert env.single_action_space == single.action_space
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    seen, infos = env.reset(seed=1)
    assert env.observation_space.contains(seen)
    assert infos["unseen"].shape == (5, 2)
    for _ in range(20):
        seen, rewards, terminated, truncated, _ = env.step(env.random_actions())
        assert env.observation_space.contains(seen)
        assert (rewards.dtype, terminated.dtype, truncated.dtype) == (np.float32, np.bool_, np.bool_)
        assert not truncated.any()
    sync = gymnasium.make_vec(NAME, num_envs=5, vectorization_mode="sync")
    assert sync.observation_space == env.observation_space
    assert sync.action_space == env.action_space


@pytest.mark.parametrize("seat", [0, 1])
@pytest.mark.parametrize("illegal", [0.0, 0.1])
@pytest.mark.parametrize("game", [random_game(3, 8, 0.5), tiring_game()], ids=["short", "tiring"])
def test_one_row_is_the_single_environment(seat: int, illegal: float, game: Game) -> None:
    """Observations, rewards, ends, last observations, reasons and counts: where serves often end the rally, and in long ones."""
    opponent = random_policy(game, 1)
    single = SingleRallyEnv(opponent=opponent, seat=seat, game=game)  # type: ignore[arg-type]
    vector = RallyVectorEnv(1, opponent=opponent, seat=seat, game=game)
    rng = np.random.default_rng(2)
    seen, info = single.reset(seed=4)
    rows, infos = vector.reset(seed=4)
    ends = 0
    for _ in range(600):
        assert all(np.array_equal(rows[key][0], seen[key]) for key in seen)
        assert np.array_equal(infos["unseen"][0], info["unseen"])
        actions = some_actions(vector, rng, illegal)
        seen, reward, over, _, info = single.step(actions[0])
        rows, rewards, terminated, _, infos = vector.step(actions)
        assert (rewards[0], terminated[0]) == (reward, over)
        assert ("final_obs" in infos) == over
        if over:
            ends += 1
            assert infos["_final_obs"].tolist() == infos["_final_info"].tolist() == [True]
            final = infos["final_obs"][0]
            assert all(np.array_equal(final[key], seen[key]) for key in seen)
            assert infos["final_info"]["reason"].tolist() == [info["reason"]]
            seen, info = single.reset()
    assert ends > 30
    assert single.unseen == vector.unseen
    assert game.levels > 1 or min(single.unseen) > 5


def test_seeds_and_masks_of_reset() -> None:
    env = make(6, server=0)
    first, _ = env.reset(seed=2)
    rally = env.versus.rows.rally
    assert rally.tolist() == list(range(6))
    env.reset()
    assert rally.tolist() == list(range(6, 12))
    env.reset(options={"reset_mask": np.array([True, False, False, False, False, True])})
    assert rally.tolist() == [12, 7, 8, 9, 10, 17]
    again, _ = env.reset(seed=2)
    assert all(np.array_equal(first[key], again[key]) for key in first)
    with pytest.raises(OptionError, match="give either seed"):
        env.reset(seed=1, options={"reset_mask": np.ones(6, np.bool_)})
    for mask in (np.ones(5, np.bool_), np.ones(6, np.int8), [True] * 6):
        with pytest.raises(OptionError, match=r"bool array of shape \(6,\)"):
            env.reset(options={"reset_mask": mask})


def test_calls_out_of_order_and_range() -> None:
    env = make(3)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(3, int))
    with pytest.raises(ResetNeeded):
        env.reset(options={"reset_mask": np.ones(3, np.bool_)})
    env.reset(seed=1)
    state = env.versus.rows.state.copy()
    wrong: list[Any] = [[0, 0, GAME.n_strokes], [0, -1, 0], [0, 0], [0.0, 0.0, 0.0], [False, False, False]]
    for actions in map(np.array, wrong):
        with pytest.raises(ActionError, match="expected 3 integers from 0 to"):
            env.step(actions)
    assert np.array_equal(env.versus.rows.state, state)
