"""Fixed-point probabilities, and strokes decided by them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.game import default_game
from shuttle_marl.game.rules import FAULT, HURRIED_BELOW, OUTCOMES, RETURNED_BELOW, WINNER, strike
from shuttle_marl.game.tables import HURRY_ONE, GameError
from shuttle_marl.game.tabulated import thresholds
from shuttle_marl.game.thresholds import ONE

probability = st.floats(0.0, 1.0)


def test_thresholds_of_round_probabilities() -> None:
    table = thresholds(np.array([0.75, 1.0, 0.0]), np.array([0.5, 0.5, 0.3]), np.array([0.5, 0.25, 0.7]))
    # good 3/4: fault below 1/4; winner 3/8 more; returned 3/8, half of it from below.
    assert table[0].tolist() == [0.25 * ONE, 0.625 * ONE, 0.8125 * ONE]
    assert table[1].tolist() == [0, 0.5 * ONE, 0.875 * ONE]
    assert table[2].tolist() == [ONE - 1, ONE - 1, ONE - 1], "the last outcome keeps the smallest probability there is"


@given(st.lists(st.tuples(probability, probability, probability), min_size=1, max_size=20))
def test_thresholds_are_monotone_and_nearest(probabilities: list[tuple[float, float, float]]) -> None:
    good, returned, above = np.array(probabilities).T
    table = thresholds(good, returned, above).astype(np.int64)
    assert (np.diff(table, axis=1) >= 0).all()
    exact = np.stack([1 - good, 1 - good * returned, 1 - good * returned * above], axis=1)
    error = np.abs(table / ONE - exact)
    assert (error[exact * ONE <= ONE - 1] <= 0.5 / ONE + 1e-12).all()
    assert (error <= 1 / ONE + 1e-12).all()


@pytest.mark.parametrize("position", [0, 1, 2])
def test_thresholds_refuse_nan(position: int) -> None:
    probabilities = [np.array([0.5]), np.array([0.5]), np.array([0.5])]
    probabilities[position] = np.array([np.nan])
    with pytest.raises(GameError, match="not a number"):
        thresholds(*probabilities)


def test_probabilities_invert_thresholds() -> None:
    game = default_game()
    rng = np.random.default_rng(4)
    size = game.n_base_pairs
    wanted = np.concatenate([rng.uniform(0.05, 1, (2, size)), rng.uniform(0, 1, (1, size))])
    found = np.stack(dataclasses.replace(game, threshold=thresholds(*wanted)).stroke_probabilities(game.block_pairs(0)))
    # A conditional probability is a quotient of two rounded numbers: its error grows as what it is conditional on shrinks.
    condition = np.stack([np.ones(size), wanted[0], wanted[0] * wanted[1]])
    assert (np.abs(found - wanted) <= 2.5 / ONE / condition).all()


def test_all_draws_of_a_stroke_give_its_probabilities_exactly() -> None:
    game = default_game()
    rng = np.random.default_rng(5)
    draws = (HURRY_ONE - 1) * ONE + np.arange(ONE)  # of the highest upper part, with which nobody is hurried
    pairs = np.array([0, game.n_pairs - 1, *rng.integers(game.n_pairs, size=30)])
    for pair, good, returned, above in zip(pairs, *game.stroke_probabilities(pairs), strict=True):
        state = game.pair_state[pair]
        k = pair - game.pair_start[state]
        outcome, _ = strike(game, np.full(ONE, state), np.full(ONE, k), draws)
        share = np.bincount(outcome, minlength=4) / ONE
        q = good * returned
        expected = [1 - good, good - q, q * (1 - above), q * above]
        assert share == pytest.approx(expected, abs=1e-12)
        assert (np.diff(outcome) >= 0).all(), "outcomes are ordered by draw"
        for end in set(outcome.tolist()):
            upper = np.arange(HURRY_ONE) * ONE + int((outcome == end).argmax())
            found, _ = strike(game, np.full(HURRY_ONE, state), np.full(HURRY_ONE, k), upper)
            hurried = game.hurry_of(pair)[end - RETURNED_BELOW] if end >= RETURNED_BELOW else 0
            assert (found != end).mean() == hurried
            assert set(found.tolist()) <= {end, end + HURRIED_BELOW - RETURNED_BELOW}


def test_the_receiver_becomes_the_striker_in_the_state_that_follows() -> None:
    game = default_game()
    rng = np.random.default_rng(6)
    pair = rng.integers(game.n_pairs, size=20_000)
    state = game.pair_state[pair]
    outcome, following = strike(game, state, pair - game.pair_start[state], rng.integers(HURRY_ONE * ONE, size=len(pair)))
    over = (outcome == FAULT) | (outcome == WINNER)
    assert (following[over] == -1).all()
    go_on, before, after = ~over, state[~over], following[~over]
    assert (game.own(after) == game.incoming(before)).all()
    assert (game.incoming(after) == game.pair_stroke[pair[go_on]]).all()
    assert (game.effort(after) == game.opponent_effort(before)).all()
    assert (outcome[go_on] == RETURNED_BELOW + 2 * game.hurried(after) + game.contact(after)).all()
    assert set(outcome.tolist()) == set(range(len(OUTCOMES)))
    assert over.any()
    assert go_on.any()
