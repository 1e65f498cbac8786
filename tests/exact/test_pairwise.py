"""Cross-play: against single profiles, against sampled rallies, and the odds of matches that follow."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings

from shuttle_marl.exact import ExactError, crossplay, evaluate
from shuttle_marl.game import default_game
from shuttle_marl.game.scoring import match_win_probability
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import games, random_game, random_policy, seeds

NAMES = ("bc", "attacking", "defensive", "safe", "random")


@settings(max_examples=10, deadline=None)
@given(games, seeds)
def test_crossplay_is_every_profile(game: Game, seed: int) -> None:
    policies = [random_policy(game, seed + i) for i in range(3)]
    solved: list[None] = []
    table = crossplay(policies, progress=lambda: solved.append(None))
    assert len(solved) == 6
    for i, j in itertools.product(range(3), repeat=2):
        odds = evaluate(policies[i], policies[j]).odds()
        assert table.serving[i, j] == pytest.approx(odds.serving, abs=2e-9)
        assert table.receiving[i, j] == pytest.approx(odds.receiving, abs=2e-9)
        assert table.rally[i, j] == pytest.approx(odds.rally, abs=2e-9)
        assert table.match()[i, j] == pytest.approx(odds.match(), abs=1e-7)
    assert table.match() + table.match().T == pytest.approx(np.ones((3, 3)), abs=1e-12)
    assert np.diag(table.rally) == pytest.approx(np.full(3, 0.5), abs=1e-12)


def test_the_same_odds_twice_and_in_any_company(small: Game) -> None:
    tables = [tabulate(resolve(name, small), small) for name in ("bc", "safe")]
    table = crossplay(tables)
    assert np.array_equal(table.serving, crossplay(tables).serving)
    assert table.serving[0, 1] == pytest.approx(crossplay(tables[::-1]).serving[1, 0], abs=table.error_bound)


def test_no_policies_and_other_games_are_refused(small: Game) -> None:
    with pytest.raises(ExactError, match="no policies"):
        crossplay([])
    with pytest.raises(ExactError, match="different catalogues"):
        crossplay([tabulate(resolve("safe", small), small), random_policy(random_game(0), 0)])


def test_matches_follow_from_rallies(small: Game) -> None:
    tables = [tabulate(resolve(name, small), small) for name in NAMES]
    table = crossplay(tables)
    expected = match_win_probability(table.serving, 1 - table.serving.T)
    assert np.array_equal(table.match(), expected)


def test_safe_play_leads_and_every_style_beats_random_play_in_the_shipped_game() -> None:
    game = default_game()
    table = crossplay([tabulate(resolve(name, game), game) for name in NAMES], tolerance=1e-3)
    order = np.argsort(table.match().mean(axis=1))
    assert NAMES[order[-1]] == "safe"
    assert NAMES[order[0]] == "random"
    # Random strokes are among those that people choose there (at least 5 %), so they lose little to a style that seldom attacks.
    assert (table.rally[:-1, NAMES.index("random")] > 0.505).all()
