"""Analysis of a rally: values of the exact solvers, and the match from the table of all scores."""

import dataclasses

import numpy as np
import pytest

from shuttle_marl.exact import evaluate, solve
from shuttle_marl.exact.odds import match_table
from shuttle_marl.game.rally import Rally
from shuttle_marl.game.rules import FAULT, RETURNED_ABOVE, RETURNED_BELOW, WINNER, IllegalStrokeError
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.tables import ROOT
from shuttle_marl.reports import Players, analyse_rally, decision
from shuttle_marl.reports.rally import match_win_after
from tests.exact.exact_games import random_policy, tiring_game

GAME = tiring_game()
TABLES = (random_policy(GAME, 1), random_policy(GAME, 2))
PLAYERS = Players(tables=TABLES, value=evaluate(*TABLES))
SOLUTION = solve(GAME)
UNKNOWN = Players(tables=(None, TABLES[1]), value=None)


def random_rally(seed: int, length: int, ending: int = WINNER) -> Rally:
    """Legal strokes; the contact of each is drawn, and who is hurried."""
    rng = np.random.default_rng(seed)
    strokes: list[int] = []
    hurried: list[bool] = []
    state = ROOT
    for _ in range(length):
        strokes.append(int(rng.choice(GAME.legal_strokes(state))))
        hurried.append(bool(GAME.hurried(state)))
        state = int(GAME.arrivals(GAME.pair(state, np.array([strokes[-1]])))[0][int(rng.integers(4))])
    stroke = np.array(strokes, np.int64)
    late, unknown = np.array(hurried), np.full(len(stroke), -1)
    return Rally(catalogue=GAME.catalogue, server=seed % 2, stroke=stroke, hurried=late, waited=unknown, ending=ending)


@pytest.mark.parametrize("seed", range(8))
def test_values_are_those_of_the_exact_solvers(seed: int) -> None:
    rally = random_rally(seed, 6)
    found = analyse_rally(rally, GAME, PLAYERS, solution=SOLUTION)
    state = rally.states(GAME)
    for i, choice in enumerate(found.decisions):
        seat, pairs = int(rally.striker[i]), np.arange(GAME.n_pairs)[GAME.pairs_of(int(state[i]))]
        assert (choice.state, choice.seat) == (state[i], seat)
        assert choice.stroke[found.rank[i]] == rally.stroke[i]
        np.testing.assert_array_equal(choice.pair, pairs)
        np.testing.assert_array_equal(choice.probability, TABLES[seat].pair_probabilities()[pairs])
        assert choice.value == pytest.approx((1 + PLAYERS.value.striking[seat][state[i]]) / 2, abs=1e-12)
        assert choice.probability @ choice.win == pytest.approx(choice.value, abs=1e-6)
        assert choice.optimal.max() == pytest.approx((1 + SOLUTION.value[0][state[i]]) / 2, abs=1e-6)
        assert choice.regret.min() == 0
        assert np.isnan(choice.support).all(), "this game belongs to no model"
        assert found.rally_win[i] == pytest.approx(choice.value if seat == 0 else 1 - choice.value)
    assert found.rally_win[-1] == (rally.winner == 0)
    regret = [choice.regret[k] for choice, k in zip(found.decisions, found.rank, strict=True)]
    np.testing.assert_array_equal(found.of_strokes("regret"), regret)


@pytest.mark.parametrize("score", [((0, 0), (0, 0)), ((2, 1), (0, 1)), ((2, 2), (1, 0)), ((3, 2), (1, 1)), ((1, 2), (1, 1))])
def test_match_win_probability_follows_from_the_table_of_all_scores(score: tuple[tuple[int, int], tuple[int, int]]) -> None:
    rules = Rules(points=3, clear=2, cap=4, games=2)
    odds = PLAYERS.value.odds(0)
    expected = match_table(odds.serving, odds.receiving, rules)[(*score[1], *score[0], 0)]
    assert match_win_after(PLAYERS.value, *score, rules) == pytest.approx(expected, abs=1e-12)
    rally = dataclasses.replace(random_rally(3, 4, FAULT), points=score[0], games=score[1])
    found = analyse_rally(rally, GAME, PLAYERS, rules=rules)
    assert rally.winner is not None
    assert found.match_win[-1] == pytest.approx(expected[rally.winner], abs=1e-12)
    expected_before = [p * expected[0] + (1 - p) * expected[1] for p in found.rally_win[:-1]]
    np.testing.assert_allclose(found.match_win[:-1], expected_before, atol=1e-12)


def test_values_after_an_open_rally_are_not_known() -> None:
    rally = random_rally(5, 4, RETURNED_BELOW)
    found = analyse_rally(rally, GAME, PLAYERS)
    assert np.isfinite(found.rally_win[:-1]).all()
    assert np.isnan([found.rally_win[-1], found.match_win[-1]]).all()
    assert np.isnan(found.of_strokes("optimal")).all(), "without the solved game"
    nothing = dataclasses.replace(
        rally, stroke=rally.stroke[:0], hurried=rally.hurried[:0], waited=rally.waited[:0], ending=RETURNED_ABOVE
    )
    assert len(analyse_rally(nothing, GAME, PLAYERS).rally_win) == 1


def test_a_policy_that_is_not_known_leaves_the_probabilities_of_the_game() -> None:
    rally = random_rally(2, 4)
    found = analyse_rally(rally, GAME, UNKNOWN)
    assert np.isfinite(found.of_strokes("p_succ")).all()
    np.testing.assert_array_equal(np.isnan(found.of_strokes("probability")), rally.striker == 0)
    assert np.isnan(found.of_strokes("win")).all()
    assert np.isnan(found.rally_win[:-1]).all()
    assert np.isnan(found.match_win).all()
    assert np.isnan(decision(GAME, ROOT, 1, UNKNOWN).value)


def test_illegal_strokes_are_refused() -> None:
    rally = random_rally(4, 3)
    wrong = dataclasses.replace(rally, stroke=np.array([rally.stroke[0], rally.stroke[0], rally.stroke[2]]))
    with pytest.raises(IllegalStrokeError, match=r"stroke 2, .* is not legal there") as raised:
        analyse_rally(wrong, GAME, PLAYERS)
    assert raised.value.row == 1
