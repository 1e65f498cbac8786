"""Cross-play: against single profiles, against sampled rallies, and the odds of matches that follow."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings

from shuttle_marl.exact import ExactError, crossplay, evaluate
from shuttle_marl.game import default_game
from shuttle_marl.game.draws import choice_draw, draw, outcome_draw, stream
from shuttle_marl.game.rules import WINNER, strike
from shuttle_marl.game.scoring import match_win_probability
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import games, random_game, random_policy, seeds

NAMES = ("bc", "attacking", "defensive", "safe", "random")
Z = 4.4172
"""Standard errors. Both tails hold 1e-5."""


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


def sampled_wins(server: TabulatedPolicy, receiver: TabulatedPolicy, rallies: int, key: int) -> int:
    """Rallies that the server wins, played stroke by stroke with the rules of the rally."""
    cumulative = [policy.padded for policy in (server, receiver)]
    wins, block = 0, 125_000
    for first in range(0, rallies, block):
        keys = stream(key, np.arange(first, min(first + block, rallies)))
        state = np.full(len(keys), ROOT, dtype=np.int32)
        for number in itertools.count():
            bits = draw(keys, number)
            k = (cumulative[number % 2].take(state, axis=0) <= choice_draw(bits)[:, None]).sum(axis=1)
            outcome, state = strike(server.game, state, k, outcome_draw(bits))
            # On even strokes the server strikes: a winner there, or the receiver's fault, is the server's rally.
            wins += int((outcome[state < 0] == (WINNER if number % 2 == 0 else 0)).sum())
            alive = state >= 0
            if not alive.any():
                break
            keys, state = keys[alive], state[alive]
    return wins


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second"), [("bc", "attacking"), ("defensive", "safe"), ("bc", "random")])
def test_exact_odds_lie_inside_the_interval_of_a_million_rallies(small: Game, first: str, second: str) -> None:
    policies = [tabulate(resolve(name, small), small) for name in (first, second)]
    odds = evaluate(*policies).odds()
    rallies = 500_000
    serving = sampled_wins(policies[0], policies[1], rallies, NAMES.index(first)) / rallies
    receiving = 1 - sampled_wins(policies[1], policies[0], rallies, 100 + NAMES.index(second)) / rallies
    for exact, sampled in ((odds.serving, serving), (odds.receiving, receiving)):
        assert abs(exact - sampled) < Z * (exact * (1 - exact) / rallies) ** 0.5
    spread = (odds.serving * (1 - odds.serving) + odds.receiving * (1 - odds.receiving)) ** 0.5 / 2
    assert abs(odds.rally - (serving + receiving) / 2) < Z * spread / rallies**0.5


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
