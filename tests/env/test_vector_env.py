"""The native vector environments against single ones, bit for bit, and under Gymnasium's own wrappers."""

import dataclasses
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from shuttle_marl.base.errors import ActionError
from shuttle_marl.env.single import SingleMatchEnv, SingleRallyEnv
from shuttle_marl.env.vector import MatchVectorEnv, RallyVectorEnv
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import random_game, random_policy, tiring_game
from tests.kernel.recovery import with_positions
from tests.recovery import small_recovery_game, with_recovery

GAME = default_game()
NAME = "shuttle_marl/Rally-v0"
GAMES = {
    "short": random_game(3, 8, 0.5),
    "tiring": tiring_game(),
    "recovery": with_recovery(random_game(3, 8, 0.5), 3, 3),
    "people's positions": dataclasses.replace(random_game(4, 8, 0.5), recovery=small_recovery_game().recovery),
}


def player(game: Game, seed: int) -> TabulatedPolicy:
    """A random policy, which waits at random too."""
    policy = random_policy(game, seed)
    return with_positions(policy, seed) if game.hides else policy


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
@pytest.mark.parametrize("game", GAMES.values(), ids=GAMES)
def test_one_row_is_the_single_environment(seat: int, illegal: float, game: Game) -> None:
    opponent = player(game, 1)
    single = SingleRallyEnv(opponent=opponent, seat=seat, game=game)  # type: ignore[arg-type]
    vector = RallyVectorEnv(1, opponent=opponent, seat=seat, game=game)
    rng = np.random.default_rng(2)
    seen, info = single.reset(seed=4)
    rows, infos = vector.reset(seed=4)
    ends = 0
    for _ in range(300):
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
    assert ends > 15
    assert single.unseen == vector.unseen
    assert game.levels > 1 or min(single.unseen) > 2


def test_seeds_of_reset() -> None:
    env = make(6, server=0)
    first, _ = env.reset(seed=2)
    rally = env.versus.rows.rally
    assert rally.tolist() == list(range(6))
    env.reset()
    assert rally.tolist() == list(range(6, 12))
    again, _ = env.reset(seed=2)
    assert all(np.array_equal(first[key], again[key]) for key in first)


def test_calls_out_of_order_and_range() -> None:
    env = make(3)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(3, int))
    env.reset(seed=1)
    state = env.versus.rows.state.copy()
    wrong: list[Any] = [[0, 0, GAME.n_strokes], [0, -1, 0], [0, 0], [0.0, 0.0, 0.0], [False, False, False]]
    for actions in map(np.array, wrong):
        with pytest.raises(ActionError, match="expected 3 integers from 0 to"):
            env.step(actions)
    assert np.array_equal(env.versus.rows.state, state)


SHORT = Rules(points=3, clear=2, cap=5, games=2)
ONE = Rules(points=1, clear=1, cap=1, games=1)
TIRING = tiring_game()


@pytest.mark.parametrize(
    ("rules", "first_server", "reward", "seat", "game"),
    [
        (SHORT, 0, "match", 0, TIRING),
        (SHORT, 0, "rally", 1, TIRING),
        (ONE, None, "rally", 0, TIRING),
        (ONE, None, "match", 1, TIRING),
        (Rules(), 1, "match", 1, TIRING),
        (SHORT, 0, "rally", 0, GAMES["recovery"]),
        (SHORT, 1, "match", 1, GAMES["people's positions"]),
    ],
)
def test_rows_play_the_matches_of_the_environment_of_one(
    reward: str, seat: int, rules: Rules, first_server: int | None, game: Game
) -> None:
    # A learner who serves first comes to every episode; others pass over those that end before.
    rows, options = (
        3 if first_server == seat else 1,
        {"rules": rules, "reward": reward, "first_server": first_server, "game": game},
    )
    opponent = player(game, 3)
    vector = MatchVectorEnv(rows, opponent=opponent, seat=seat, **options)  # type: ignore[arg-type]
    alone = [SingleMatchEnv(opponent=opponent, seat=seat, **options) for _ in range(rows)]  # type: ignore[arg-type]
    assert vector.single_observation_space == alone[0].observation_space
    seen, infos = vector.reset(seed=8)
    expected = []
    for b, env in enumerate(alone):
        env.reset(seed=8)
        env.raw.episode = b - 1
        expected.append(env.reset()[0])
    rng = np.random.default_rng(0)
    over, episodes = np.zeros(rows, bool), 0
    for _ in range(900 if rules == BWF else 150):
        for b, env in enumerate(alone):
            assert seen["observation"][b].tobytes() == expected[b]["observation"].tobytes()
            assert seen["action_mask"][b].tobytes() == expected[b]["action_mask"].tobytes()
            score = env.raw.score_of(seat)
            assert (*infos["points"][b], *infos["games"][b]) == score
        strokes = np.array([rng.choice(np.flatnonzero(mask)) for mask in seen["action_mask"]])
        if rng.random() < 0.02:
            strokes[0] = int(np.flatnonzero(seen["action_mask"][0] == 0)[0])  # not legal
        seen, rewards, over, truncated, infos = vector.step(strokes)
        assert not truncated.any()
        for b, env in enumerate(alone):
            last, paid, ended, _, info = env.step(int(strokes[b]))
            assert (rewards[b], over[b]) == (paid, ended)
            expected[b] = last
            if ended:
                episodes += 1
                assert infos["final_info"]["reason"][b] == info["reason"]
                assert infos["final_obs"][b]["observation"].tobytes() == last["observation"].tobytes()
                assert not infos["final_obs"][b]["action_mask"].any()
                env.raw.episode += rows - 1  # in one row of B episodes b, b + B, … are played
                expected[b] = env.reset()[0]
    assert episodes > 2
