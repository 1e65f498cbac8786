"""Exact values against OpenSpiel's own algorithms, on small games; and the game in OpenSpiel's terms."""

import dataclasses
import importlib
import sys
from types import ModuleType

import numpy as np
import pyspiel
import pytest
from open_spiel.python import rl_environment
from open_spiel.python.algorithms import best_response, cfr, expected_game_score, exploitability

from shuttle_marl import exact, rally_v0
from shuttle_marl.env.open_spiel import NAME, RECOVERY_NAME, RallyGame, open_spiel_policy
from shuttle_marl.exact import solve
from shuttle_marl.game import default_game
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.layout import layout
from shuttle_marl.game.policy import TabulatedPolicy, cumulative_positions
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import ROOT, Game
from tests.exact.exact_games import game_without_outcomes, hand_made, random_game, random_policy, with_probabilities
from tests.recovery import with_recovery

LADDER = (
    "short-serve:front-centre:below:backhand",
    "lift:back-centre:below:forehand",
    "clear:back-left:above:forehand",
    "smash:middle-left:above:forehand",
    "block:front-centre:below:forehand",
    "net-kill:middle-centre:above:forehand",
)
"""Each stroke is answered only by those that stand behind it; the last two end nearly all rallies."""


def ladder(seed: int, strokes: tuple[str, ...] = LADDER) -> Game:
    """A game whose rallies climb the ladder; its probabilities are drawn at random."""
    catalogue = Catalogue.from_names(strokes)
    order = [catalogue.names.index(name) for name in strokes]
    last = order[-2:]
    replies = np.zeros((len(strokes) + 1, len(strokes)), np.bool_)
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


@pytest.fixture(scope="module")
def hidden() -> tuple[Game, RallyGame]:
    """A short ladder with hidden positions, in which perfect play mixes."""
    tables = with_recovery(ladder(7, LADDER[:1] + LADDER[3:]), 7, 3)
    return tables, RallyGame({"server": 0, "max_strokes": 3}, tables)


def waiting_at_random(tables: Game, seed: int) -> TabulatedPolicy:
    rng, people = np.random.default_rng(seed), tables.people_positions(np.arange(tables.n_states))
    p = (people > 0) * rng.uniform(0.1, 1, people.shape)
    return dataclasses.replace(random_policy(tables, seed), waits=cumulative_positions(p))


@pytest.mark.parametrize(
    ("name", "options"), [(NAME, {"max_strokes": 4}), (RECOVERY_NAME, {}), (RECOVERY_NAME, {"max_strokes": 4})]
)
def test_open_spiels_conformance(name: str, options: dict[str, int]) -> None:
    game = pyspiel.load_game(name, options)
    pyspiel.random_sim_test(game, num_sims=2, serialize=bool(options), verbose=False)
    assert str(game.get_type().short_name) == name
    perfect = game.get_type().information == pyspiel.GameType.Information.PERFECT_INFORMATION
    assert perfect == (name == NAME)
    assert game.num_distinct_actions() == default_game().n_strokes + (0 if perfect else 9)


def test_perfect_play_with_hidden_positions_is_unexploitable_in_open_spiel(hidden: tuple[Game, RallyGame]) -> None:
    tables, game = hidden
    solution = solve(tables, tolerance=1e-11)
    policy = solution.policy[0]
    assert policy.waits is not None
    assert ((policy.position_probabilities() > 0.01).sum(axis=1) > 1).any(), "perfect play mixes"
    theirs = open_spiel_policy(policy, game)
    # Rounded to 1/65535; and a rally in 65,536 goes on where the tree is cut off.
    assert exploitability.nash_conv(game, theirs, use_cpp_br=False) == pytest.approx(0, abs=1e-5)
    value = expected_game_score.policy_value(game.new_initial_state(), [theirs, theirs])[0]
    assert value == pytest.approx(solution.value_at_serve, abs=1e-5)


def test_best_responses_to_hidden_positions_equal_those_of_open_spiel(hidden: tuple[Game, RallyGame]) -> None:
    tables, game = hidden
    policy = waiting_at_random(tables, 3)
    theirs, ours = open_spiel_policy(policy, game), exact.best_response(policy, tolerance=1e-12)
    for player in (0, 1):
        value = best_response.BestResponsePolicy(game, player, theirs).value(game.new_initial_state())
        expected = ours.value.striking[player][ROOT] * (1 if player == 0 else -1)
        assert value == pytest.approx(expected, abs=5e-5), player
    other = waiting_at_random(tables, 4)
    value = expected_game_score.policy_value(game.new_initial_state(), [theirs, open_spiel_policy(other, game)])[0]
    assert exact.evaluate(policy, other, tolerance=1e-12).striking[0][ROOT] == pytest.approx(value, abs=5e-5)


def test_counterfactual_regret_minimisation_finds_the_exact_value(hidden: tuple[Game, RallyGame]) -> None:
    tables, game = hidden
    solver = cfr.CFRPlusSolver(game)
    for _ in range(20):
        solver.evaluate_and_update_policy()
    average = solver.average_policy()
    value = expected_game_score.policy_value(game.new_initial_state(), [average, average])[0]
    assert value == pytest.approx(solve(tables).value_at_serve, abs=1e-3)


def test_only_the_name_of_the_node_contains_the_position(hidden: tuple[Game, RallyGame]) -> None:
    state = hidden[1].new_initial_state()
    while not state.choosing:
        state.apply_action(state.legal_actions()[0] if not state.is_chance_node() else state.chance_outcomes()[-1][0])
    waiting = state.current_player()
    assert waiting == 1 - state.striker
    assert state.information_state_tensor(waiting)[-2:] == [0, 1]
    assert state.information_state_tensor(1 - waiting)[-2:] == [1, 0]
    first, second = (state.child(action) for action in state.legal_actions()[:2])
    for player in (0, 1):
        for read in ("information_state_string", "observation_string", "information_state_tensor", "observation_tensor"):
            assert getattr(first, read)(player) == getattr(second, read)(player)
    assert first.current_player() == second.current_player() == 1 - waiting
    assert str(first) != str(second)
    assert first.history() != second.history()
    assert first.legal_actions() == second.legal_actions()
