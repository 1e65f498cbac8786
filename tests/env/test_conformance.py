"""PettingZoo's own conformance tests."""

import importlib
import random
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from pettingzoo import test as conformance
from pettingzoo.utils import wrappers

from shuttle_marl import match_v0, rally_v0
from tests.recovery import small_recovery_game

both = pytest.mark.parametrize("module", [rally_v0, match_v0])


@pytest.fixture(autouse=True)
def _quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    random.seed(0)


def expected(message: str) -> bool:
    """Warnings that PettingZoo gives for every environment with an action mask, its own included."""
    texts = ("Observation is not a NumPy array", "Observation space for each agent probably", "no legal actions")
    return any(text in message for text in texts)


@both
@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("recovery", [False, True])
def test_api(module: ModuleType, raw: bool, recovery: bool) -> None:
    make = module.raw_env if raw else module.env
    options = {"game": small_recovery_game()} if recovery else {}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        conformance.api_test(make(**options), num_cycles=1000)
    assert not [str(w.message) for w in caught if not expected(str(w.message))]


def test_api_of_whole_matches_with_rewards_by_rally() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        conformance.api_test(match_v0.env(reward="rally"), num_cycles=3000)


@pytest.mark.parametrize(
    "make",
    [
        rally_v0.env,
        match_v0.env,
        rally_v0.raw_env,
        lambda: match_v0.env(reward="rally"),
        lambda: rally_v0.env(server=1),
        lambda: match_v0.env(game=small_recovery_game()),
    ],
)
def test_seed(make: Callable[[], Any]) -> None:
    conformance.seed_test(make, num_cycles=500)


@both
def test_state(module: ModuleType) -> None:
    state_test = importlib.import_module("pettingzoo.test.state_test")  # the package has a function of this name
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        state_test.test_state_space(module.env())
        state_test.test_state(module.raw_env(), 0)


@both
def test_render(module: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(module.raw_env.metadata, "render_fps", 0)  # no waiting between frames
    conformance.render_test(module.env)


@both
def test_save_obs(module: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    conformance.test_save_obs(module.env())
    assert not list(tmp_path.iterdir()), "observations are no pictures, so none are saved"


@both
def test_pettingzoos_own_wrappers_fit_around_the_raw_environment(module: ModuleType) -> None:
    env = wrappers.TerminateIllegalWrapper(module.raw_env(), illegal_reward=-1)
    env = wrappers.OrderEnforcingWrapper(wrappers.AssertOutOfBoundsWrapper(env))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        conformance.api_test(env, num_cycles=500)
    env.reset(seed=0)
    env.last()
    env.step(module.raw_env().game.n_strokes - 1)
    assert set(env.rewards.values()) == {0, -1.0}
