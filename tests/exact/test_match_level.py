"""From perfect rallies to perfect matches: the condition of Walker, Wooders and Amir."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.exact import least_gain, solve
from shuttle_marl.exact.match import match_table
from shuttle_marl.game import default_game
from shuttle_marl.game.scoring import Rules, match_win_probability

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
    """In the shipped game a rally won never lowers the probability of winning the match, at any score and with either server."""
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
