"""Robust play against a hand-solved game, plain value iteration over several games, and nature at its worst."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.exact import best_response, solve, solve_robust
from shuttle_marl.exact.profile import moved
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import games, seeds, with_probabilities

Floats = np.ndarray


@settings(max_examples=20, deadline=None)
@given(games)
def test_one_game_is_minimax(game: Game) -> None:
    found, perfect = solve_robust([game]), solve(game)
    assert np.array_equal(found.policy[0].cumulative, perfect.policy[0].cumulative)
    assert np.abs(found.striking[0] - perfect.value[0]).max() <= found.error_bound + perfect.error_bound


def over_strokes(game: Game, values: Floats) -> Floats:
    best = np.zeros(game.n_states)
    best[game.playable] = np.maximum.reduceat(values, game.pair_start[:-1][game.playable])
    return best


def by_value_iteration(several: Sequence[Game]) -> tuple[Floats, Floats]:
    """Values of the robust player and of the opponent by plain sweeps in numpy."""
    own = np.zeros(several[0].n_states)
    for _ in range(5000):
        theirs = over_strokes(several[0], np.max([game.stroke_values(own) for game in several], axis=0))
        before, own = own, over_strokes(several[0], np.min([game.stroke_values(theirs) for game in several], axis=0))
        if np.abs(own - before).max() < 1e-13:
            return own, theirs
    raise ArithmeticError("value iteration did not converge")


@settings(max_examples=15, deadline=None)
@given(games, seeds, st.integers(2, 4))
def test_equal_to_value_iteration(game: Game, seed: int, count: int) -> None:
    several = [game, *(with_probabilities(game, seed + i) for i in range(1, count))]
    found = solve_robust(several, tolerance=1e-10)
    for mine, expected in zip(found.striking, by_value_iteration(several), strict=True):
        assert np.abs(mine - expected).max() <= 2e-10


@settings(max_examples=15, deadline=None)
@given(games, seeds)
def test_no_opponent_and_no_game_takes_more(game: Game, seed: int) -> None:
    several = [game, *(with_probabilities(game, seed + i) for i in (1, 2))]
    found = solve_robust(several)
    rng = np.random.default_rng(seed)
    mixtures = [np.full(game.n_base_pairs, g) for g in range(3)] + [rng.integers(0, 3, game.n_base_pairs) for _ in range(3)]
    for pick in mixtures:
        tables = np.choose(pick[:, None], [each.threshold for each in several])
        mixed = dataclasses.replace(game, threshold=tables)
        opponent = best_response(moved(found.policy[0], mixed)).value.odds()
        assert 1 - opponent.rally >= found.odds().rally - 1e-8
