"""Profiles, best responses, exploitability, visits and regret, on random games and on a small sister of the shipped one."""

import dataclasses
import itertools
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.base.cache import forgotten
from shuttle_marl.exact import ExactError, best_response, crossplay, evaluate, nash_conv, policy_regret, solve, visits
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.tables import ROOT, Game
from tests.exact.exact_games import (
    games,
    hand_made,
    linear_values,
    random_game,
    random_policy,
    response_by_policy_iteration,
    seeds,
    with_probabilities,
)

sharpness = st.sampled_from([0.5, 1.0, 8.0])


@settings(max_examples=15, deadline=None)
@given(games, seeds, sharpness)
def test_profiles_equal_a_linear_system(game: Game, seed: int, sharp: float) -> None:
    other = with_probabilities(game, seed + 7)
    policies = random_policy(game, seed, sharp), random_policy(other, seed + 1, sharp)
    value = evaluate(*policies, tolerance=1e-10)
    expected = linear_values((game, other), (policies[0].pair_probabilities(), policies[1].pair_probabilities()))
    assert value.error_bound <= 1e-10
    for found, true in zip(value.striking, expected, strict=True):
        assert np.abs(found - true).max() <= value.error_bound
    odds = value.odds(0), value.odds(1)
    assert odds[0].serving + odds[1].receiving == pytest.approx(1, abs=1e-12)
    assert odds[0].match() + odds[1].match() == pytest.approx(1, abs=1e-9)


@settings(max_examples=15, deadline=None)
@given(games, seeds, sharpness)
def test_best_response_equals_policy_iteration_and_beats_every_policy(game: Game, seed: int, sharp: float) -> None:
    other = with_probabilities(game, seed + 7)
    policy = random_policy(other, seed, sharp)
    answer = best_response(policy, game=game, tolerance=1e-10)
    expected = response_by_policy_iteration((game, other), policy.pair_probabilities())
    for found, true in zip(answer.value.striking, expected, strict=True):
        assert np.abs(found - true).max() <= answer.value.error_bound
    played = evaluate(answer.policy, policy, tolerance=1e-10)
    assert played.odds().value == pytest.approx(answer.value.odds().value, abs=1e-8)
    for number in range(3):
        rival = evaluate(random_policy(game, seed + number, sharp), policy, tolerance=1e-10)
        assert (rival.striking[0] <= answer.value.striking[0] + 1e-9).all()


@settings(max_examples=15, deadline=None)
@given(games, seeds, sharpness)
def test_nash_conv_is_never_negative(game: Game, seed: int, sharp: float) -> None:
    first, second = random_policy(game, seed, sharp), random_policy(game, seed + 1, sharp)
    found = nash_conv(first, second)
    value = evaluate(first, second).odds().value
    gains = (best_response(second).value.odds().value - value, best_response(first).value.odds().value + value)
    assert min(gains) >= -1e-8
    assert found.nash_conv == pytest.approx(sum(gains), abs=1e-8)
    both = nash_conv(first)
    assert both.nash_conv >= -both.error_bound
    assert both.exploitability == pytest.approx(best_response(first).value.odds().value, abs=1e-12)
    assert both.nash_conv == pytest.approx(nash_conv(first, dataclasses.replace(first)).nash_conv, abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(games, seeds)
def test_coarse_profiles_are_within_their_bound(game: Game, seed: int) -> None:
    first, second = random_policy(game, seed), random_policy(game, seed + 1)
    exact = evaluate(first, second, tolerance=1e-12)
    for tolerance in (1.0, 1e-2, 1e-4):
        for coarse, true in (
            (evaluate(first, second, tolerance=tolerance), exact),
            (best_response(second, tolerance=tolerance).value, best_response(second, tolerance=1e-12).value),
        ):
            assert coarse.error_bound <= tolerance
            for found, expected in zip(coarse.striking, true.striking, strict=True):
                assert np.abs(found - expected).max() <= coarse.error_bound + true.error_bound


@settings(max_examples=20, deadline=None)
@given(games, seeds, st.sampled_from([0, 1, None]))
def test_visits_give_the_odds_and_add_up(game: Game, seed: int, server: Literal[0, 1] | None) -> None:
    other = with_probabilities(game, seed + 7)
    first, second = random_policy(game, seed), random_policy(other, seed + 1)
    seen = visits(first, second, server=server, tolerance=1e-10)
    ends = seen.endings()
    assert sum(ends.values()) == pytest.approx(1, abs=1e-9)
    odds = evaluate(first, second).odds()
    won = ends["winner of player 0"] + ends["fault of player 1"]
    assert won == pytest.approx({0: odds.serving, 1: odds.receiving, None: odds.rally}[server], abs=1e-8)
    starts = {0: (1, 0), 1: (0, 1), None: (0.5, 0.5)}[server]
    assert (seen.states[0][ROOT], seen.states[1][ROOT]) == starts
    for player in (0, 1):
        assert seen.base_pairs(player).sum() == pytest.approx(seen.states[player].sum(), abs=1e-12)
        assert seen.shot_mix(player).sum() == pytest.approx(1)
    coarse = visits(first, second, server=server, tolerance=1e-2)
    assert sum(np.abs(a - b).sum() for a, b in zip(coarse.states, seen.states, strict=True)) <= 1e-2 + 1e-10


@settings(max_examples=20, deadline=None)
@given(games, seeds, sharpness)
def test_regrets_add_up_to_what_is_lost(game: Game, seed: int, sharp: float) -> None:
    policy, solution = random_policy(game, seed, sharp), solve(game)
    loss = policy_regret(policy, solution=solution)
    against_perfect = evaluate(policy, solution.policy[1]).odds().value
    assert loss.per_rally == pytest.approx(-against_perfect, abs=1e-7)
    assert loss.state.min() >= -1e-8
    top = loss.largest(3)
    assert (loss.state * loss.weight)[top[0]] == (loss.state * loss.weight).max()


def test_visits_are_expected_numbers_of_strokes() -> None:
    """On the three strokes, probabilities of continuing are 14/16 for the serve, 8/16 for the smash and 12/16 for the lift."""
    game = hand_made()
    policy = random_policy(game, 0)
    # Expected strokes from above a and below b: a = 1 + b/4 + a/4, b = 1 + b/4 + a/2.
    a, b = np.linalg.solve([[3 / 4, -1 / 4], [-1 / 2, 3 / 4]], [1, 1])
    assert visits(policy, policy, tolerance=1e-12).rally_length == pytest.approx(1 + 7 / 16 * (a + b), abs=1e-10)


def test_policies_of_other_games_are_refused(small: Game, bc: TabulatedPolicy) -> None:
    policy = random_policy(random_game(5), 0)
    for call in (lambda: evaluate(bc, policy), lambda: visits(policy, bc), lambda: best_response(policy, game=small)):
        with pytest.raises(ExactError, match="differ in catalogue"):
            call()


def test_the_bound_of_a_match_follows_from_that_of_a_rally(bc: TabulatedPolicy) -> None:
    odds = evaluate(bc, bc, tolerance=1e-3).odds()
    low, high = (dataclasses.replace(odds, serving=odds.serving + e, receiving=odds.receiving + e) for e in (-1e-4, 1e-4))
    wide = dataclasses.replace(odds, error_bound=1e-4)
    assert wide.match_error_bound() == pytest.approx(max(high.match() - odds.match(), odds.match() - low.match()), abs=1e-12)
    sure = dataclasses.replace(odds, serving=1.0, receiving=1.0, error_bound=0.3)
    assert 0 < sure.match_error_bound() < 1, "probabilities end at 1"


@settings(max_examples=10, deadline=None)
@given(games, seeds)
def test_crossplay_is_every_profile(game: Game, seed: int) -> None:
    policies = [random_policy(game, seed + i) for i in range(3)]
    with pytest.raises(ExactError, match="crossplay of no policies"):
        crossplay([])
    with forgotten():
        table = crossplay(policies)
    for i, j in itertools.product(range(3), repeat=2):
        odds = evaluate(policies[i], policies[j]).odds()
        assert table.serving[i, j] == pytest.approx(odds.serving, abs=2e-9)
        assert table.receiving[i, j] == pytest.approx(odds.receiving, abs=2e-9)
        assert table.rally[i, j] == pytest.approx(odds.rally, abs=2e-9)
        assert table.match()[i, j] == pytest.approx(odds.match(), abs=1e-7)
    assert table.match() + table.match().T == pytest.approx(np.ones((3, 3)), abs=1e-12)
    assert np.diag(table.rally) == pytest.approx(np.full(3, 0.5), abs=1e-12)
