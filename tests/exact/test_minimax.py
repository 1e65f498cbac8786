"""Minimax values against hand-solved games, policy iteration, and plain value iteration."""

import copy
import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings

from shuttle_marl.exact import ExactError, Solution, best_response, nash_conv, solve
from shuttle_marl.exact.fixed_point import largest_continuation
from shuttle_marl.game.tables import ROOT, Game
from tests.exact.exact_games import (
    THREE_STROKES,
    games,
    hand_made,
    minimax_by_policy_iteration,
    random_game,
    seeds,
    with_probabilities,
)


def test_three_strokes_solved_by_hand() -> None:
    """A the smash, from above; L the lift, from below: A = 1/4 - L/4 - A/4, L = -1/4 - L/4 - A/2, so A = 6/23, L = -7/23.

    The serve is a fault one time in eight, else met from either height: -1/8 - 7/16 (A + L) = -39/368.
    """
    game = hand_made()
    solution = solve(game, tolerance=1e-12)
    above, below = Fraction(6, 23), Fraction(-7, 23)
    assert solution.value_at_serve == pytest.approx(float(Fraction(-39, 368)), abs=2e-12)
    assert solution.value[0][4::2] == pytest.approx(float(below), abs=2e-12)
    assert solution.value[0][5::2] == pytest.approx(float(above), abs=2e-12)


def test_a_worse_stroke_changes_nothing_and_is_not_played() -> None:
    """A clear in place of the smash is worth -1/16 - 3/4 L - 3/16 A = 0.117 < 6/23."""
    game = hand_made((*THREE_STROKES, "clear:back-centre:above:forehand"))
    solution = solve(game, tolerance=1e-12)
    assert solution.value_at_serve == pytest.approx(float(Fraction(-39, 368)), abs=2e-12)
    played = game.catalogue.shot[game.pair_stroke[solution.policy[0].pair_probabilities() > 0]]
    assert set(played) == {game.catalogue.shot[i] for i in range(3)}


@settings(max_examples=15, deadline=None)
@given(games)
def test_value_iteration_equals_policy_iteration(game: Game) -> None:
    solution = solve(game, tolerance=1e-10)
    expected, _ = minimax_by_policy_iteration((game, game))
    assert np.abs(solution.value[0] - expected).max() <= solution.error_bound


@settings(max_examples=8, deadline=None)
@given(games, seeds)
def test_players_with_tables_of_their_own(game: Game, seed: int) -> None:
    other = with_probabilities(game, seed + 1)
    solution = solve(game, other, tolerance=1e-10)
    for found, expected in zip(solution.value, minimax_by_policy_iteration((game, other)), strict=True):
        assert np.abs(found - expected).max() <= solution.error_bound
    swapped = solve(other, game, tolerance=1e-10)
    assert swapped.value[1] == pytest.approx(solution.value[0], abs=2e-10)
    assert nash_conv(*solution.policy).nash_conv <= 1e-8


@settings(max_examples=15, deadline=None)
@given(games)
def test_coarse_values_are_within_their_bound(game: Game) -> None:
    exact = solve(game, tolerance=1e-11)
    for tolerance in (1.0, 1e-1, 1e-3):
        coarse = solve(game, tolerance=tolerance)
        assert coarse.error_bound <= tolerance
        assert np.abs(coarse.value[0] - exact.value[0]).max() <= coarse.error_bound + exact.error_bound


def test_the_bound_is_that_of_the_contraction(solution: Solution, small: Game) -> None:
    good, returned, _ = small.stroke_probabilities()
    rally = small.base(small.pair_state) >= 4
    d = float((good * returned)[rally].max())
    assert solution.contraction == pytest.approx(d, abs=1e-12)
    assert solution.error_bound == pytest.approx(solution.residual * d / (1 - d), abs=1e-9)
    assert solution.error_bound <= 1e-9


def test_two_equal_tables_are_the_symmetric_game(solution: Solution, small: Game) -> None:
    copy = dataclasses.replace(small, threshold=small.threshold.copy())
    asymmetric = solve(small, copy)
    assert asymmetric.value_at_serve == pytest.approx(solution.value_at_serve, abs=2e-9)
    assert np.abs(asymmetric.value[0] - asymmetric.value[1]).max() < 2e-9


def test_no_policy_gains_against_minimax(solution: Solution) -> None:
    policy = solution.policy[0]
    answer = best_response(policy)
    assert abs(answer.value.odds().value) <= answer.value.error_bound
    found = nash_conv(policy)
    assert 0 - found.error_bound <= found.nash_conv <= 1e-5
    assert found.exploitability == found.nash_conv / 2


def test_the_same_values_twice(solution: Solution, small: Game) -> None:
    again = solve(small)
    assert np.array_equal(again.value[0], solution.value[0])
    assert np.array_equal(again.policy[0].cumulative, solution.policy[0].cumulative)


def test_the_minimax_policy_plays_one_legal_stroke_in_every_state(solution: Solution, small: Game) -> None:
    p = solution.policy[0].pair_probabilities()
    assert set(np.unique(p)) == {0.0, 1.0}
    assert np.array_equal(np.bincount(small.pair_state, p, small.n_states), small.legal_count(np.arange(small.n_states)) > 0)


def test_a_stroke_that_never_ends_the_rally_is_refused() -> None:
    game = hand_made()
    threshold = game.threshold.copy()
    pair = int(np.flatnonzero(game.catalogue.names[2] == np.array(game.catalogue.names)[game.pair_stroke])[3])
    threshold[pair, :2] = 0
    endless = dataclasses.replace(game, threshold=threshold)
    with pytest.raises(ExactError, match="lift:back-centre:below:forehand never ends the rally in state: own"):
        solve(endless)
    threshold = game.threshold.copy()
    threshold[:1, :2] = 0
    assert largest_continuation(dataclasses.replace(game, threshold=threshold)) < 1, "a serve may always continue"
    serve_always_good = solve(dataclasses.replace(game, threshold=threshold), tolerance=1e-12)
    expected = -(threshold[0, 2] / 65536 * -7 / 23 + (1 - threshold[0, 2] / 65536) * 6 / 23)
    assert serve_always_good.value[0][ROOT] == pytest.approx(expected, abs=2e-12)


def test_games_of_different_layouts_are_refused(small: Game) -> None:
    first, second = random_game(1, rallies=5), random_game(2, rallies=5)
    with pytest.raises(ExactError, match=r"different catalogues|differ in"):
        solve(first, second)
    with pytest.raises(ExactError, match="different catalogues"):
        solve(small, first)
    moved = copy.copy(first)
    object.__setattr__(moved, "reply_start", first.reply_start + 1)  # no such game can be made
    with pytest.raises(ExactError, match="differ in reply_start"):
        solve(first, moved)
