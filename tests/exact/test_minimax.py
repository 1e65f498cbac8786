"""Minimax values against hand-solved games and strategy iteration; also with hurried strikers, and without some strokes."""

import copy
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.exact import ExactError, Solution, least_gain, nash_conv, solve
from shuttle_marl.exact.odds import match_table
from shuttle_marl.game import default_game
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.scoring import Rules, match_win_probability
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import games, hand_made, minimax_by_policy_iteration, random_game, seeds, with_probabilities
from tests.reduced import reduced_game


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


def test_games_of_different_layouts_are_refused(small: Game) -> None:
    first, second = random_game(1, rallies=5), random_game(2, rallies=5)
    with pytest.raises(ExactError, match="differ in"):
        solve(first, second)
    with pytest.raises(ExactError, match=r"differ in catalogue\.names"):
        solve(small, first)
    moved = copy.copy(first)
    object.__setattr__(moved, "reply_start", first.reply_start + 1)  # no such game can be made
    with pytest.raises(ExactError, match="differ in reply_start"):
        solve(first, moved)


GAME = reduced_game()
SHOT_OF = np.array([name.partition(":")[0] for name in GAME.catalogue.names])


@pytest.mark.parametrize("names", [("cross-court-net-shot",), ("smash", "half-smash"), ("lift:middle-left:below:forehand",)])
def test_only_the_named_strokes_are_missing(names: tuple[str, ...]) -> None:
    smaller = GAME.without(*names)
    removed = np.isin(SHOT_OF, names) | np.isin(GAME.catalogue.names, names)
    states = GAME.state_of(*smaller.observation(np.arange(smaller.n_states)).T)
    assert not removed[GAME.incoming(states[4:])[GAME.incoming(states[4:]) < GAME.n_strokes]].any()
    for state in np.flatnonzero(smaller.playable).tolist():
        strokes = [stroke for stroke in GAME.legal_strokes(states[state]).tolist() if not removed[stroke]]
        assert smaller.legal_strokes(state).tolist() == strokes
    pairs = GAME.pair(states[smaller.pair_state], smaller.pair_stroke)
    assert np.array_equal(smaller.outcome_probabilities(), GAME.outcome_probabilities(pairs))
    assert np.array_equal(smaller.observation(smaller.arrivals()), GAME.observation(GAME.arrivals(pairs)))
    assert smaller.hash != GAME.hash


def test_what_cannot_be_removed() -> None:
    with pytest.raises(GameError, match="no stroke 'nets'; shot types are: short-serve"):
        GAME.without("nets")
    with pytest.raises(GameError, match=r"no legal reply to lift:\S+ from contact 0"):
        GAME.without("drop")
    serves = {shot for shot in SHOT_OF.tolist() if shot.endswith("serve")}
    with pytest.raises(GameError, match="no legal reply to the start of a rally from contact 0"):
        GAME.without(*serves)
    assert GAME.without().hash == GAME.hash


SHORT = Rules(points=3, clear=2, cap=5, games=2)


@settings(max_examples=10, deadline=None)
@given(st.floats(0, 1), st.floats(0, 1))
def test_the_table_holds_the_exact_odds_at_every_score(serving: float, receiving: float) -> None:
    table = match_table(serving, receiving, SHORT)
    assert len(table) == 2 * 4 * (3 * 3 + 6)  # two servers, four scores in games; up to 2-2, then 3-2, 2-3, 3-3, 4-3, 3-4, 4-4
    for (own, other, i, j, server), (won, lost) in table.items():
        p = serving if server == 0 else receiving
        exact = match_win_probability(serving, receiving, games=(own, other), points=(i, j), first_server=server, rules=SHORT)
        assert lost + p * (won - lost) == pytest.approx(float(exact), abs=1e-12)


def test_perfect_rallies_are_a_perfect_match() -> None:
    value = solve(default_game()).value_at_serve
    assert least_gain((1 + value) / 2, (1 - value) / 2) > 0
    assert least_gain((1 + value) / 2, (1 - value) / 2, Rules(points=11)) > 0


@settings(max_examples=60, deadline=None)
@given(st.floats(0, 1), st.floats(0, 1), st.sampled_from([SHORT, Rules(points=5, clear=1, cap=5, games=3)]))
def test_it_holds_for_all_odds_although_the_winner_may_have_to_serve(serving: float, receiving: float, rules: Rules) -> None:
    assert least_gain(serving, receiving, rules) >= -1e-12


def test_the_least_gain_of_a_match_of_single_rallies() -> None:
    """Best of three rallies, odds one half: a rally won adds one half at every score but at the last one, where it adds 1."""
    single = Rules(points=1, clear=1, cap=1, games=2)
    table = match_table(0.5, 0.5, single)
    assert {key[:2]: won - lost for key, (won, lost) in table.items()} == {(0, 0): 0.5, (1, 0): 0.5, (0, 1): 0.5, (1, 1): 1.0}
    assert least_gain(0.5, 0.5, single) == 0.5
