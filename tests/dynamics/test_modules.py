"""The outcome models as PyTorch modules, and rallies that they decide."""

import pickle
from typing import Any

import numpy as np
import pytest
import torch

from shuttle_marl import load_models
from shuttle_marl.base.errors import OptionError
from shuttle_marl.dynamics.features import codes_of_pairs
from shuttle_marl.dynamics.network import attributes
from shuttle_marl.env import match_v0, rally_v0
from shuttle_marl.game import default_game
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import random_game


def test_m_succ_and_m_ret_are_torch_modules_that_can_be_called() -> None:
    models, game = load_models(), default_game()
    pairs = np.random.default_rng(0).integers(0, game.n_base_pairs, 300)
    arrays = codes_of_pairs(game, pairs, opposite=False) | {"discipline": np.ones(len(pairs), np.int16)}
    codes = attributes(arrays)
    for module, chance in ((models.m_succ, 1 - models.fault(arrays)), (models.m_ret, models.returned(arrays))):
        assert isinstance(module, torch.nn.Module)
        found = module(codes)
        assert found.shape == (300,)
        assert found.dtype == torch.float64
        assert np.abs(found.numpy() - chance).max() < 1e-12
        # A row does not depend on the others.
        assert torch.allclose(module(codes[:7]), found[:7], rtol=0, atol=1e-12)
    assert models.m_contact(codes).shape == (300,)
    assert models.m_hurried(codes).shape == (300, 2)


def test_a_shift_moves_the_log_odds_of_a_fault() -> None:
    models, game = load_models(), default_game()
    codes = attributes(codes_of_pairs(game, np.arange(50), opposite=False))
    plain, moved = models.m_succ(codes), models.m_succ(codes, 0.5)
    assert torch.allclose(torch.logit(plain) - torch.logit(moved), torch.full((50,), 0.5, dtype=torch.float64))
    assert torch.allclose(models.m_succ.shifted(0.5)(codes), moved)
    assert torch.equal(models.m_succ(codes), plain)


def rallies(env: Any, seeds: range) -> list[tuple[int, str, float]]:
    """Number of the stroke, reason and reward of the server at every step of random rallies."""
    seen = []
    for seed in seeds:
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        while not any(env.terminations.values()):
            mask = env.observe(env.agent_selection)["action_mask"]
            action = int(rng.choice(np.flatnonzero(mask)))
            env.step(action)
            seen.append((action, env.agent_selection, env.rewards["player_0"]))
    return seen


def test_rallies_of_the_modules_are_those_of_the_tables() -> None:
    tables, models = rally_v0.env(), rally_v0.env(outcomes="models")
    assert rallies(models, range(12)) == rallies(tables, range(12))
    again = pickle.loads(pickle.dumps(rally_v0.raw_env(outcomes="models")))
    assert rallies(again, range(3)) == rallies(tables, range(3))


@pytest.mark.parametrize("game", ["default:men", "default:recovery", random_game(0)])
def test_games_without_models_are_refused(game: Game | str) -> None:
    with pytest.raises(OptionError, match="only the game of a model"):
        match_v0.env(game=game, outcomes="models")


def test_unknown_outcomes_are_refused() -> None:
    with pytest.raises(OptionError, match="tables, models"):
        rally_v0.env(outcomes="torch")
