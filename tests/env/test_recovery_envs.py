"""The game with recovery in the environments of one rally at a time: conformance, rules, draws, forks, illegal positions."""

import copy
import pickle
import warnings
from collections.abc import Callable
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo import test as conformance

from shuttle_marl import match_v0, rally_v0
from shuttle_marl.base.errors import ActionError
from shuttle_marl.env.single import SingleMatchEnv, SingleRallyEnv
from shuttle_marl.game.draws import choice_draw, draw, outcome_draw, position_draw, stream
from shuttle_marl.game.observation import SWAP
from shuttle_marl.game.policy import PolicyError, States, UniformPolicy
from shuttle_marl.game.rally.stepper import RallyDraws, choose_position, stepper_of
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.rules import HURRIED_BELOW, OUTCOMES, RETURNED_BELOW, IllegalStrokeError, strike
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import tabulate
from tests.recovery import Prefers, small_recovery_game

both = pytest.mark.parametrize("module", [rally_v0, match_v0])


@pytest.fixture(scope="module")
def game() -> Game:
    return small_recovery_game()


@both
@pytest.mark.parametrize("raw", [False, True])
def test_pettingzoos_conformance(module: ModuleType, raw: bool, game: Game) -> None:
    make = module.raw_env if raw else module.env
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        conformance.api_test(make(game=game), num_cycles=1000)
    conformance.seed_test(lambda: make(game=game), num_cycles=300)
