"""Minimax values against OpenSpiel's value iteration, on small games written down as OpenSpiel games."""

import importlib
import sys
from types import ModuleType
from typing import Any

import pyspiel
import pytest
from exact_games import hand_made, random_game

from shuttle_marl.exact import solve
from shuttle_marl.game.rally import FAULT, ONE, RETURNED_BELOW, ROOT, WINNER, Game

TYPE = pyspiel.GameType(
    short_name="python_shuttle_marl",
    long_name="A rally",
    dynamics=pyspiel.GameType.Dynamics.SEQUENTIAL,
    chance_mode=pyspiel.GameType.ChanceMode.EXPLICIT_STOCHASTIC,
    information=pyspiel.GameType.Information.PERFECT_INFORMATION,
    utility=pyspiel.GameType.Utility.ZERO_SUM,
    reward_model=pyspiel.GameType.RewardModel.TERMINAL,
    max_num_players=2,
    min_num_players=2,
    provides_information_state_string=False,
    provides_information_state_tensor=False,
    provides_observation_string=False,
    provides_observation_tensor=False,
    parameter_specification={},
)


class SpielRally(pyspiel.Game):
    """A rally served by player 0."""

    def __init__(self, tables: Game, params: dict[str, Any] | None = None) -> None:
        info = pyspiel.GameInfo(
            num_distinct_actions=tables.n_strokes,
            max_chance_outcomes=4,
            num_players=2,
            min_utility=-1.0,
            max_utility=1.0,
            utility_sum=0.0,
            max_game_length=10_000,
        )
        super().__init__(TYPE, info, params or {})
        self.tables = tables

    def new_initial_state(self) -> "SpielState":
        return SpielState(self)


class SpielState(pyspiel.State):
    """Named by who strikes in which state, so that states which play on alike are one."""

    def __init__(self, game: SpielRally) -> None:
        super().__init__(game)
        self.tables = game.tables
        self.striker, self.state, self.pair, self.winner = 0, ROOT, -1, -1

    def current_player(self) -> int:
        if self.winner >= 0:
            return pyspiel.PlayerId.TERMINAL
        return pyspiel.PlayerId.CHANCE if self.pair >= 0 else self.striker

    def _legal_actions(self, player: int) -> list[int]:
        return sorted(self.tables.legal_strokes(self.state).tolist())

    def chance_outcomes(self) -> list[tuple[int, float]]:
        limits = [0, *self.tables.limits_of(self.pair).tolist(), ONE]
        return [(i, (limits[i + 1] - limits[i]) / ONE) for i in range(4) if limits[i + 1] > limits[i]]

    def _apply_action(self, action: int) -> None:
        if self.pair < 0:
            self.pair = int(self.tables.pair_start[self.state]) + self.tables.legal_strokes(self.state).tolist().index(action)
        elif action in (FAULT, WINNER):
            self.winner = self.striker if action == WINNER else 1 - self.striker
        else:
            self.state = int(self.tables.arrivals(self.pair)[action - RETURNED_BELOW])
            self.striker, self.pair = 1 - self.striker, -1

    def is_terminal(self) -> bool:
        return self.winner >= 0

    def returns(self) -> list[float]:
        return [0.0, 0.0] if self.winner < 0 else [1.0 - 2 * self.winner, 2 * self.winner - 1.0]

    def __str__(self) -> str:
        return f"won by {self.winner}" if self.winner >= 0 else f"{self.striker} {self.state} {self.pair}"


@pytest.fixture
def value_iteration(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """OpenSpiel's value iteration, without the linear programs that only simultaneous moves need.

    They import cvxpy, which OpenSpiel's package does not require.
    """
    linear_programs = "open_spiel.python.algorithms.lp_solver"
    monkeypatch.setitem(sys.modules, linear_programs, ModuleType(linear_programs))
    return importlib.import_module("open_spiel.python.algorithms.value_iteration")


@pytest.mark.parametrize(
    "tables", [hand_made(), random_game(3, rallies=2), random_game(4, rallies=3), random_game(11, rallies=4)]
)
def test_minimax_equals_open_spiel(value_iteration: ModuleType, tables: Game) -> None:
    expected = value_iteration.value_iteration(SpielRally(tables), depth_limit=-1, threshold=1e-12, cyclic_game=True)
    solution = solve(tables, tolerance=1e-11)
    seen = 0
    for name, value in expected.items():
        if name.startswith("won"):
            continue
        striker, state, _ = map(int, name.split())
        own = solution.value[striker][state]
        assert (own if striker == 0 else -own) == pytest.approx(value, abs=1e-8), tables.describe(state)
        seen += 1
    assert seen > len(tables.catalogue)
