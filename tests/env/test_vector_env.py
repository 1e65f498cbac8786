"""The native vector environment against single ones, and under Gymnasium's own wrappers."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

from shuttle_marl.base.errors import ActionError, OptionError
from shuttle_marl.env.single import SingleRallyEnv
from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.game import default_game
from shuttle_marl.game.observation import SWAP, observations, stroke_features
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import KernelError
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


def assert_same(features: np.ndarray, tokens: np.ndarray, game: Game) -> None:
    """The 60 numbers and the seven tokens of a state say the same."""
    assert tokens.dtype == np.int32
    own, incoming, contact, duel, effort, other, hurried = tokens
    hot, highest = stroke_features(game), max(1, game.levels - 1)
    assert np.array_equal(features[:54], np.concatenate([hot[own], hot[incoming]]))
    assert features[54] == contact
    np.testing.assert_allclose(features[56:], [duel / 3, effort / highest, other / highest, hurried], rtol=1e-6)


@pytest.mark.parametrize("observation", ["features", "tokens"])
@pytest.mark.parametrize("tiring", [False, True])
def test_rows_are_the_episodes_of_single_environments(observation: str, tiring: bool) -> None:
    """Row b plays the episodes b, b + B, … of the seed; tokens say the same as features."""
    batch, game = 7, tiring_game() if tiring else GAME
    opponents: Any = [random_policy(game, 1), random_policy(game, 2)] if tiring else ["bc", "random"]
    vector = RallyVectorEnv(batch, opponent=opponents, seat=1, observation=observation, threads=2, game=game)  # type: ignore[arg-type]
    singles = [SingleRallyEnv(opponent=opponent, seat=1, game=game) for opponent in opponents]
    rng = np.random.default_rng(3)
    rows, _ = vector.reset(seed=5)
    logs: list[list[tuple[int, dict[str, np.ndarray], int, float, bool]]] = [[] for _ in range(batch)]
    for _ in range(60):
        actions, numbers = some_actions(vector, rng), vector.versus.rows.rally.copy()
        before = rows
        rows, rewards, terminated, _, _ = vector.step(actions)
        for row in range(batch):
            seen = {key: value[row] for key, value in before.items()}
            logs[row].append((int(numbers[row]), seen, int(actions[row]), float(rewards[row]), bool(terminated[row])))
    for row, log in enumerate(logs):
        single = singles[row % 2]
        seen, _ = single.reset(seed=5)
        for rally, expected, action, reward, over in log:
            while single.raw.episode < rally:
                seen, _ = single.reset()
            assert single.raw.episode == rally
            if observation == "features":
                assert np.array_equal(expected["observation"], seen["observation"])
            else:
                assert_same(seen["observation"], expected["observation"], game)
            assert np.array_equal(expected["action_mask"], seen["action_mask"])
            seen, got, ended, _, _ = single.step(action)
            assert (got, ended) == (reward, over)


@pytest.mark.parametrize("game", [GAME, tiring_game()], ids=["default", "tiring"])
def test_last_observations_as_tokens_say_the_same_as_features(game: Game) -> None:
    opponent = random_policy(game, 1)
    one = RallyVectorEnv(200, opponent=opponent, game=game)
    other = RallyVectorEnv(200, opponent=opponent, game=game, observation="tokens")
    one.reset(seed=1)
    other.reset(seed=1)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(12):
        actions = some_actions(one, rng, 0.05)
        *_, infos = one.step(actions)
        seen, *_, infos_too = other.step(actions)
        assert other.observation_space.contains(seen)
        for a, b in zip(infos["final_obs"][infos["_final_obs"]], infos_too["final_obs"][infos["_final_obs"]], strict=True):
            assert_same(a["observation"], b["observation"], game)
            ends += 1
    assert ends > 100


def test_features_are_those_of_every_state() -> None:
    env = RallyVectorEnv(300)
    env.reset(seed=0)
    for _ in range(5):
        seen, *_ = env.step(env.random_actions())
        assert np.array_equal(seen["observation"], observations(GAME, env.versus.rows.state))
    assert not np.array_equal(seen["observation"], seen["observation"][:, SWAP])


def test_statistics_of_gymnasium() -> None:
    env = RecordEpisodeStatistics(make(64), buffer_length=10_000)
    env.reset(seed=3)
    lengths, returns = [], []
    running = np.zeros(64, int)
    for _ in range(100):
        _, rewards, terminated, _, infos = env.step(env.unwrapped.random_actions())  # type: ignore[attr-defined]
        running += 1
        for row in np.flatnonzero(terminated):
            assert infos["episode"]["l"][row] == running[row]
            lengths.append(int(running[row]))
            returns.append(float(rewards[row]))
        running[terminated] = 0
    assert list(env.length_queue) == lengths
    assert list(env.return_queue) == returns
    assert len(lengths) > 1000


def test_infos_as_a_list() -> None:
    env = DictInfoToList(make(8))
    env.reset(seed=3)
    reasons = []
    for _ in range(20):
        _, _, terminated, _, infos = env.step(env.unwrapped.random_actions())  # type: ignore[attr-defined]
        for row, info in enumerate(infos):
            assert info["unseen"].shape == (2,)
            assert ("final_obs" in info) == terminated[row]
            if terminated[row]:
                reasons.append(info["final_info"]["reason"])
    assert set(reasons) == {"fault", "winner"}


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


def test_without_a_seed_every_environment_plays_other_rallies() -> None:
    keys = set()
    for _ in range(3):
        env = make(2)
        env.reset()
        keys.add(int(env.versus.rows.key[0]))
    assert len(keys) == 3


def test_calls_out_of_order_and_range() -> None:
    env = make(3)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(3, int))
    with pytest.raises(ResetNeeded):
        env.reset(options={"reset_mask": np.ones(3, np.bool_)})
    env.reset(seed=1)
    state = env.versus.rows.state.copy()
    for actions in (np.array([0, 0, GAME.n_strokes]), np.array([0, -1, 0]), np.array([0, 0])):
        with pytest.raises(ActionError, match="expected 3 integers from 0 to"):
            env.step(actions)
    assert np.array_equal(env.versus.rows.state, state)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"observation": "pixels"}, OptionError, "observation 'pixels'"),
        ({"opponent": "none such"}, PolicyError, "no policy 'none such'"),
        ({"seat": 7}, KernelError, "seat 7"),
        ({"threads": 0}, KernelError, "threads 0"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        gymnasium.make_vec(NAME, num_envs=2, **options)


def test_matches_are_vectorized_by_gymnasium() -> None:
    env = gymnasium.make_vec("shuttle_marl/Match-v0", num_envs=2, opponent="random")
    seen, _ = env.reset(seed=1)
    actions = np.array([np.flatnonzero(mask)[0] for mask in seen["action_mask"]])
    seen, *_ = env.step(actions)
    assert seen["observation"].shape == (2, 66)
