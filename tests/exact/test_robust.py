"""Robust play against a hand-solved game, plain value iteration over several games, and nature at its worst."""

import dataclasses
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.exact import best_response, solve, solve_robust
from shuttle_marl.exact.profile import moved
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.game.thresholds import ONE
from tests.exact.exact_games import THREE_STROKES, games, hand_made, seeds, with_probabilities

Floats = np.ndarray


def two_games() -> tuple[Game, Game]:
    """Three strokes and a clear; in the second game every second smash is a fault, 6 of 16 win, and the rest comes back."""
    first = hand_made((*THREE_STROKES, "clear:back-centre:above:forehand"))
    threshold = first.threshold.copy()
    smash = first.catalogue.shot[first.base_pair_stroke] == SHOTS.index("smash")
    threshold[smash] = np.array([8, 14, 15]) * (ONE // 16)
    return first, dataclasses.replace(first, threshold=threshold)


def test_two_games_solved_by_hand() -> None:
    """The smash is best if it is as in the first game, and the clear if nature may take the second one.

    A and L are values above and below the net, of the robust player (a, l) and of the opponent (A, L), for whom nature takes the
    first game: a = -1/16 - 3/4 L - 3/16 A, l = -1/4 - L/4 - A/2, A = 1/4 - l/4 - a/4, L = -1/4 - l/4 - a/2. So
    a = -10/421, l = -165/421, A = 149/421, L = -59/421; a smash in the second game is worth -1/8 - (A + L)/16 = -0.138 < a.
    """
    a_own, l_own, a_theirs, l_theirs = (Fraction(k, 421) for k in (-10, -165, 149, -59))
    found = solve_robust(two_games(), tolerance=1e-12)
    own, theirs = found.value.striking
    assert own[5::2] == pytest.approx(float(a_own), abs=2e-12)
    assert own[4::2] == pytest.approx(float(l_own), abs=2e-12)
    assert theirs[5::2] == pytest.approx(float(a_theirs), abs=2e-12)
    assert theirs[4::2] == pytest.approx(float(l_theirs), abs=2e-12)
    assert own[ROOT] == pytest.approx(float(Fraction(-1, 8) - Fraction(7, 16) * (a_theirs + l_theirs)), abs=2e-12)
    assert theirs[ROOT] == pytest.approx(float(Fraction(-1, 8) - Fraction(7, 16) * (a_own + l_own)), abs=2e-12)
    shots = {
        name: played_shots(policy) for name, policy in (("robust", found.policy), ("minimax", solve(two_games()[0]).policy[0]))
    }
    assert shots == {"robust": {"short-serve", "lift", "clear"}, "minimax": {"short-serve", "lift", "smash"}}


def played_shots(policy: TabulatedPolicy) -> set[str]:
    game = policy.game
    return {SHOTS[shot] for shot in game.catalogue.shot[game.pair_stroke[policy.pair_probabilities() > 0]]}


@settings(max_examples=20, deadline=None)
@given(games)
def test_one_game_is_minimax(game: Game) -> None:
    found, perfect = solve_robust([game]), solve(game)
    assert np.array_equal(found.policy.cumulative, perfect.policy[0].cumulative)
    assert np.abs(found.value.striking[0] - perfect.value[0]).max() <= found.value.error_bound + perfect.error_bound


def over_strokes(game: Game, values: Floats) -> Floats:
    best = np.zeros(game.n_states)
    best[game.playable] = np.maximum.reduceat(values, game.first_pairs)
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
    for mine, expected in zip(found.value.striking, by_value_iteration(several), strict=True):
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
        opponent = best_response(moved(found.policy, mixed)).value.odds()
        assert 1 - opponent.rally >= found.odds().rally - 1e-8
