"""``history=K``: the last K strokes of each player, the same in every environment."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from pettingzoo.test import api_test, seed_test
from torchrl.envs.utils import check_env_specs

from shuttle_marl import RallyEnv, VersusEnv, default_game, match_v0, rally_v0
from shuttle_marl.game.layout import stroke_features
from shuttle_marl.game.scoring import Rules

GAME = default_game()
GYM = "shuttle_marl:shuttle_marl/"
K, N = 3, GAME.n_strokes


def padded(strokes: list[int]) -> list[int]:
    """The last K strokes, latest first."""
    return [*strokes[::-1], *[N] * K][:K]


@pytest.mark.parametrize("module", [rally_v0, match_v0])
@pytest.mark.parametrize("game", ["default", "default:recovery"])
def test_pettingzoo_conforms_and_sees_the_last_strokes_of_both(module: Any, game: str) -> None:
    usual, env = module.env(game=game), module.env(game=game, history=8)
    width = usual.observation_space("player_0")["observation"].shape[0]
    assert env.observation_space("player_0")["observation"].shape == (width + 8 * 54,)
    api_test(env, num_cycles=100)
    seed_test(lambda: module.env(game=game, history=8), num_cycles=50)
    env, rng, end, table = (
        module.env(game=game, history=K),
        np.random.default_rng(0),
        width - (game != "default"),
        stroke_features(GAME),
    )
    for seed in range(6):
        played: dict[str, list[int]] = {"player_0": [], "player_1": []}
        usual.reset(seed=seed)
        env.reset(seed=seed)
        for _ in range(80):
            if any(env.terminations.values()):
                break
            for agent, other in (("player_0", "player_1"), ("player_1", "player_0")):
                seen, plain = env.observe(agent)["observation"], usual.observe(agent)["observation"]
                assert np.array_equal(np.r_[seen[:end], seen[end + 54 * K :]], plain)
                expected = table[[*padded(played[agent]), *padded(played[other])]]
                assert np.array_equal(seen[end : end + 54 * K], expected.ravel())
            agent, before = env.agent_selection, len(env.unwrapped.strokes)
            action = int(rng.choice(np.flatnonzero(env.observe(agent)["action_mask"])))
            for one in (env, usual):
                one.step(action)
            if action < N:
                played[agent].append(action)
            if before and not env.unwrapped.strokes:
                played = {"player_0": [], "player_1": []}  # the next rally of a match


@pytest.mark.filterwarnings("ignore:.*an action was illegal")
@pytest.mark.parametrize("name", ["Rally-v0", "Match-v0", "RallyRecovery-v0", "MatchRecovery-v0"])
def test_vectors_see_what_one_environment_sees(name: str) -> None:
    options: dict[str, Any] = {"opponent": "bc", "history": K, "mask": "observation"}
    options |= {"rules": Rules(points=3, clear=1, cap=3, games=1)} if name.startswith("Match") else {}
    one, many = gymnasium.make(f"{GYM}{name}", **options), gymnasium.make_vec(f"{GYM}{name}", num_envs=1, **options)
    assert many.single_observation_space == one.observation_space
    rng = np.random.default_rng(1)
    seen, rows = one.reset(seed=5)[0], many.reset(seed=5)[0]
    for _ in range(400):
        assert rows["observation"] in many.observation_space["observation"]  # type: ignore[index]
        assert np.array_equal(seen["observation"], rows["observation"][0])
        legal = np.flatnonzero((seen["action_mask"] != 0) ^ (rng.random() < 0.02))
        action = int(rng.choice(legal))
        seen, _, over, _, _ = one.step(action)
        rows, _, _, _, infos = many.step(np.array([action]))
        if over:
            assert np.array_equal(seen["observation"], infos["final_obs"][0]["observation"])
            seen = one.reset()[0]


def test_torchrl_has_the_catalogue_indices() -> None:
    env = VersusEnv(6, opponents="bc", history=K, seed=3)
    tokens = gymnasium.make_vec(f"{GYM}Rally-v0", num_envs=6, opponent="bc", history=K, observation="tokens")
    check_env_specs(env)
    env.set_seed(3)
    here, rows = env.reset(), tokens.reset(seed=3)[0]
    for _ in range(60):
        assert np.array_equal(here["history"].reshape(6, -1), rows["observation"][:, 7:])
        assert torch.equal(here["history"][:, :, 0], here["observation"][:, :2])
        action = env.rand_action()["action"]
        _, here = env.step_and_maybe_reset(here.set("action", action))
        rows = tokens.step(action.numpy())[0]


def test_self_play_swaps_the_players() -> None:
    env = RallyEnv(4, history=K, seed=1)
    check_env_specs(env)
    env.set_seed(1)
    here = env.reset()
    played: list[list[list[int]]] = [[[], []] for _ in range(4)]  # of each row: those of the striker, of the receiver
    for _ in range(60):
        assert here["history"].tolist() == [[padded(own), padded(other)] for own, other in played]
        action = env.rand_action()["action"]
        step, here = env.step_and_maybe_reset(here.set("action", action))
        for row, stroke in enumerate(action.tolist()):
            own, other = played[row]
            played[row] = [[], []] if step["next", "done"][row] else [other, [*own, stroke]]
