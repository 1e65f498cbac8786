"""Exact values against OpenSpiel's own algorithms, on small games; and the game in OpenSpiel's terms."""

import dataclasses
import importlib
import sys
from types import ModuleType

import numpy as np
import pyspiel
import pytest
from open_spiel.python import rl_environment
from open_spiel.python.algorithms import best_response, expected_game_score

from shuttle_marl import exact, rally_v0
from shuttle_marl.env.open_spiel import NAME, RallyGame, open_spiel_policy
from shuttle_marl.exact import solve
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import UniformPolicy
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import layout
from shuttle_marl.game.thresholds import ONE
from tests.exact.exact_games import game_without_outcomes, hand_made, random_game, random_policy, with_probabilities

LADDER = (
    "short-serve:front-centre:below:backhand",
    "lift:back-centre:below:forehand",
    "clear:back-left:above:forehand",
    "smash:middle-left:above:forehand",
    "block:front-centre:below:forehand",
    "net-kill:middle-centre:above:forehand",
)
"""Each stroke is answered only by those that stand behind it; the last two end nearly all rallies."""


def ladder(seed: int) -> Game:
    """A game whose rallies climb the ladder; its probabilities are drawn at random."""
    catalogue = Catalogue.from_names(LADDER)
    order = [catalogue.names.index(name) for name in LADDER]
    last = order[-2:]
    replies = np.zeros((len(LADDER) + 1, len(LADDER)), np.bool_)
    for i, incoming in enumerate(order):
        replies[incoming, [*order[i + 1 :], *last]] = True
    replies[-1] = catalogue.is_serve
    tables = layout(catalogue, replies)
    game = with_probabilities(game_without_outcomes(catalogue, tables), seed)
    threshold = game.threshold.copy()
    threshold[np.isin(game.base_pair_stroke, last), 1:] = ONE - 1
    return dataclasses.replace(game, threshold=threshold)


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
    game = RallyGame({"server": 0}, tables)
    expected = value_iteration.value_iteration(game, depth_limit=-1, threshold=1e-12, cyclic_game=True)
    solution = solve(tables, tolerance=1e-11)
    names = (
        (f"player {player} to strike: {tables.describe(s)}", (player, s)) for player in (0, 1) for s in range(tables.n_states)
    )
    decisions, seen = dict(names), 0
    for name, value in expected.items():
        if name.startswith("won"):
            continue
        striker, state = decisions[name]
        own = solution.value[striker][state]
        assert (own if striker == 0 else -own) == pytest.approx(value, abs=1e-8), tables.describe(state)
        seen += 1
    assert seen > len(tables.catalogue)


@pytest.fixture(scope="module")
def reduced() -> tuple[Game, RallyGame]:
    """A game that ends after a few strokes but for one rally in 65,536^3, so that trees of it are finite."""
    tables = ladder(5)
    return tables, RallyGame({"server": 0, "max_strokes": 7}, tables)


def test_best_responses_equal_those_of_open_spiel(reduced: tuple[Game, RallyGame]) -> None:
    tables, game = reduced
    policy = random_policy(tables, 2)
    theirs = open_spiel_policy(policy, game)
    ours = exact.best_response(policy, tolerance=1e-12)
    for player in (0, 1):
        value = best_response.BestResponsePolicy(game, player, theirs).value(game.new_initial_state())
        # Player 0 serves: the response itself, or the policy that it answers.
        expected = ours.value.striking[player][ROOT] * (1 if player == 0 else -1)
        assert value == pytest.approx(expected, abs=1e-6), player


def test_values_of_policies_equal_those_of_open_spiel(reduced: tuple[Game, RallyGame]) -> None:
    tables, game = reduced
    first, second = random_policy(tables, 2), random_policy(tables, 3)
    policies = [open_spiel_policy(first, game), open_spiel_policy(second, game)]
    expected = expected_game_score.policy_value(game.new_initial_state(), policies)[0]
    assert exact.evaluate(first, second, tolerance=1e-12).striking[0][ROOT] == pytest.approx(expected, abs=1e-6)


def test_the_shipped_game_is_registered_and_plays_by_its_rules() -> None:
    game = pyspiel.load_game(NAME, {"server": 0, "profile": ""})
    tables = default_game()
    assert game.num_distinct_actions() == tables.n_strokes
    env = rally_v0.env(server=0)
    env.reset(seed=1)
    state = game.new_initial_state()
    observer = game.make_py_observer()
    while not state.is_terminal():
        legal = state.legal_actions()
        assert str(state).startswith(f"player {state.current_player()} to strike: ")
        assert legal == np.flatnonzero(env.observe(env.agent_selection)["action_mask"]).tolist()
        for player in (0, 1):
            observer.set_from(state, player)
            assert np.array_equal(observer.dict["rally"], env.observe(f"player_{player}")["observation"])
            assert observer.dict["turn"] == (player == state.current_player())
        state.apply_action(legal[0])
        env.step(legal[0])
        assert sum(p for _, p in state.chance_outcomes()) == pytest.approx(1)
        outcome = env.infos["player_0"]["outcome"]
        state.apply_action(next(i for i, _ in state.chance_outcomes() if state.action_to_string(i) == outcome))
    assert state.returns() == [env.rewards["player_0"], env.rewards["player_1"]]


def test_learners_of_open_spiel_get_tensors() -> None:
    env = rl_environment.Environment(pyspiel.load_game(NAME), seed=3)
    step = env.reset()
    while not step.last():
        player = step.observations["current_player"]
        assert len(step.observations["info_state"][player]) == 61
        step = env.step([step.observations["legal_actions"][player][0]])
    assert sorted(step.rewards) == [-1, 1]


def test_policies_of_this_package_play_in_open_spiel() -> None:
    game = RallyGame({"server": 0}, hand_made())
    probabilities = open_spiel_policy(UniformPolicy(), game).action_probabilities(game.new_initial_state())
    assert probabilities == {0: 1.0}
