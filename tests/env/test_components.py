"""Views of the environments: strokes as four components, plain boxes, registration with libraries, and environments as bytes."""

import pickle
import subprocess
import sys
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from pettingzoo import test as conformance
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.errors import ActionError
from shuttle_marl.env.wrappers import component_masks
from shuttle_marl.game import default_game
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.rules import IllegalStrokeError
from tests.exact.exact_games import random_game
from tests.recovery import small_recovery_game


def parts_of(game, action):
    """The components of a stroke; in the game with recovery also a position, and for a position any stroke."""
    c, stroke = game.catalogue, min(action, game.n_strokes - 1)
    parts = [c.shot[stroke], c.area[stroke], c.height[stroke], c.technique[stroke]]
    return np.array([*parts, max(action - game.n_strokes, 0)] if game.hides else parts)


@pytest.mark.parametrize("module", [rally_v0, match_v0])
@pytest.mark.parametrize("recovery", [False, True])
def test_the_game_is_the_same_as_with_catalogue_indices(module, recovery):
    game = small_recovery_game() if recovery else default_game()
    flat, components = module.env(game=game), module.env(game=game, action="components")
    flat.reset(seed=6)
    components.reset(seed=6)
    rng = np.random.default_rng(0)
    for agent, other in zip(flat.agent_iter(300), components.agent_iter(300), strict=True):
        assert agent == other
        seen, seen_in_parts = flat.last(), components.last()
        assert seen[1:] == seen_in_parts[1:]
        assert (seen[0]["observation"] == seen_in_parts[0]["observation"]).all()
        assert components.observation_space(agent).contains(seen_in_parts[0])
        legal = np.flatnonzero(seen[0]["action_mask"])
        masks = component_masks(seen_in_parts[0]["action_mask"])
        assert [len(m) for m in masks] == ([13, 9, 2, 3, 9] if game.hides else [13, 9, 2, 3])
        strokes = legal[legal < game.n_strokes]
        for found, part in zip(masks[:4], np.array([parts_of(game, s)[:4] for s in strokes]).reshape(-1, 4).T, strict=True):
            assert set(np.flatnonzero(found)) == set(part)
        assert not game.hides or (masks[4] == seen[0]["action_mask"][game.n_strokes :]).all()
        if seen[2] or seen[3]:
            flat.step(None)
            components.step(None)
            if not flat.agents:
                flat.reset()
                components.reset()
        else:
            stroke = int(rng.choice(legal))
            flat.step(stroke)
            components.step(parts_of(game, stroke))


@pytest.mark.parametrize("in_catalogue", [False, True])
def test_an_illegal_combination_loses(in_catalogue):
    env = rally_v0.env(action="components")
    env.reset(seed=0)
    game = env.unwrapped.game
    loser = env.agent_selection
    action = tuple(parts_of(game, game.n_strokes - 1)) if in_catalogue else np.argwhere(game.catalogue.by_parts < 0)[0]
    env.step(action)
    assert env.rewards[loser] == -1
    assert sum(env.rewards.values()) == 0
    assert env.infos[loser]["reason"] == "illegal stroke"
    assert env.infos[loser]["stroke"] == (game.catalogue.names[-1] if in_catalogue else None)
    for _ in env.agent_iter():
        assert env.last()[2]
        with pytest.raises(ValueError, match="None"):
            env.step(action)
        env.step(None)
    assert not env.agents


@pytest.mark.parametrize("action", [[13, 0, 0, 0], [0, 0, 0], 3, [0.0, 1.0, 0.0, 0.0], [-1, 0, 0, 0], "push"])
def test_actions_outside_the_space_are_refused(action):
    env = rally_v0.env(action="components")
    env.reset(seed=0)
    with pytest.raises(ActionError, match="expected shot type, area, height and technique") as caught:
        env.step(action)
    assert not isinstance(caught.value, IllegalStrokeError)


both = pytest.mark.parametrize("module", [rally_v0, match_v0])
VIEWS = [("observation", None), ("observation", "none"), ("info", None), ("info", "full"), ("none", None), ("none", "full")]


def played(env: OrderEnforcingWrapper, mask: str, strokes: int) -> list[tuple[Any, ...]]:
    """Observations of agents over a number of strokes; each is the first legal one, taken from a plain twin."""
    twin = env.unwrapped
    env.reset(seed=5)
    found: list[tuple[Any, ...]] = []
    while len(found) < strokes:
        agent = env.agent_selection
        seen, reward, terminated, truncated, info = env.last()
        legal = twin.observe(agent)["action_mask"]
        vector = seen["observation"] if mask == "observation" else seen
        if mask == "info":
            assert np.array_equal(info["action_mask"], legal)
        assert env.observation_space(agent).contains(seen)
        found.append((agent, vector.tobytes(), reward, terminated))
        if terminated or truncated:
            env.reset()
        else:
            env.step(int(legal.argmax()))
    return found


@both
@pytest.mark.parametrize(("mask", "info"), VIEWS)
def test_every_view_plays_the_same_rallies(module: ModuleType, mask: str, info: str | None) -> None:
    assert played(module.env(mask=mask, info=info), mask, 200) == played(module.env(), "observation", 200)


@both
@pytest.mark.parametrize("view", [{"mask": "info"}, {"mask": "none"}, {"mask": "none", "action": "components"}])
def test_plain_views_pass_pettingzoos_tests(module: ModuleType, view: dict[str, Any]) -> None:
    conformance.api_test(module.env(**view), num_cycles=300)
    conformance.seed_test(lambda: module.env(**view), num_cycles=20)


def test_infos_before_the_first_reset() -> None:
    with pytest.raises(AttributeError, match="before reset"):
        _ = rally_v0.env(mask="info").infos


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", ["shuttle_marl/Rally-v0", "shuttle_marl/Match-v0"])
@pytest.mark.parametrize("mask", ["info", "none"])
def test_gymnasium_has_the_same_views(name: str, mask: str) -> None:
    from stable_baselines3.common.env_checker import check_env

    env = gymnasium.make(name, mask=mask)
    check_env(env)
    plain = gymnasium.make(name)
    seen, info = env.reset(seed=4)
    expected, _ = plain.reset(seed=4)
    for _ in range(50):
        assert np.array_equal(seen, expected["observation"])
        assert all(isinstance(value, np.ndarray) for value in info.values())
        if mask == "info":
            assert np.array_equal(info["action_mask"], expected["action_mask"])
        stroke = int(expected["action_mask"].argmax())
        seen, reward, over, _, info = env.step(stroke)
        expected, reward_there, over_there, _, _ = plain.step(stroke)
        assert (reward, over) == (reward_there, over_there)
        if over:
            (seen, info), (expected, _) = env.reset(), plain.reset()


def test_pettingzoo_knows_the_environments() -> None:
    code = "import pettingzoo, shuttle_marl; print(*(name for name in pettingzoo.aec_registry if 'shuttle' in name))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["shuttle_marl/rally-v0", "shuttle_marl/match-v0"]


@pytest.mark.parametrize(
    "make",
    [rally_v0.env, lambda: match_v0.env(mask="info"), lambda: gymnasium.make("shuttle_marl/Match-v0", opponent="bc").unwrapped],
)
def test_an_environment_of_the_shipped_game_is_a_few_bytes(make: Any) -> None:
    env = make()
    env.reset(seed=2)
    content = pickle.dumps(env)
    assert len(content) <= 10_000
    again = pickle.loads(content)
    assert again.unwrapped.game.hash == default_game().hash


def test_a_pickle_of_another_version_of_the_shipped_game() -> None:
    game = default_game()
    content = pickle.dumps(game)
    assert game.hash.encode() in content
    with pytest.raises(GameError, match="make it again"):
        pickle.loads(content.replace(game.hash.encode(), b"0" * len(game.hash)))


def test_a_game_of_ones_own_is_pickled_whole() -> None:
    game = random_game(3)
    assert pickle.loads(pickle.dumps(game)).hash == game.hash
