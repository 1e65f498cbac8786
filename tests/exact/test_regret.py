"""Losses by state, error bounds, and the counts that solvers report."""

import dataclasses
import re

import numpy as np
import pytest

from shuttle_marl.exact import (
    ExactError,
    PairPolicy,
    best_response,
    evaluate,
    holes,
    policy_regret,
    solve,
    solve_robust,
)
from shuttle_marl.exact.fixed_point import (
    FIRST_RALLY_STATE,
    error_bound,
    largest_continuation,
)
from shuttle_marl.exact.match import least_gain, match_table
from shuttle_marl.exact.optimal import limited, restricted_response
from shuttle_marl.exact.profile import induced
from shuttle_marl.exact.solver import ProfileValue
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.shipped import supported
from shuttle_marl.game.tables import Game
from shuttle_marl.game.thresholds import ONE
from tests.exact.exact_games import random_game, random_policy, tiring_game, with_probabilities
from tests.exact.test_hidden_positions_solved import waiting, with_recovery
from tests.reduced import reduced_game

GAME = random_game(4, 3)
"""Two levels of effort, and no duels."""


def test_states_with_small_losses_are_no_holes() -> None:
    game, least = tiring_game(), 1e-3
    policy, solution = random_policy(game, 3, 3.0), solve(game)
    answer = best_response(policy)
    found = holes(policy, top=game.n_states, solution=solution, response=answer, tolerance=least)
    loss = policy_regret(policy, answer.policy, solution=solution, tolerance=least)
    lost = loss.state * loss.weight
    expected = [state for state in np.argsort(-lost, kind="stable").tolist() if lost[state] > least]
    assert [each.state for each in found.holes] == expected
    assert 0 < found.states == len(expected) < (lost > 0).sum()
    assert max(expected) >= game.n_base_states, "states of other efforts too"
    assert found.error_bound == max(
        loss.error_bound,
        policy_regret(answer.policy, policy, solution=solution, tolerance=least).error_bound,
        answer.value.error_bound,
    )
    assert len(holes(policy, solution=solution, response=answer).holes) == 10
    assert found.exploitability == answer.value.odds().value


def test_losses_with_hidden_positions_are_those_of_the_policy_alone() -> None:
    game = with_recovery(random_game(2), 2)
    found = holes(waiting(random_policy(game, 2), 2), top=3)
    assert found.given_up == 0
    assert found.loss == pytest.approx(found.exploitability, abs=1e-6)


def test_the_largest_continuation_of_strokes_and_of_policies() -> None:
    outcome, state = GAME.outcome_probabilities(), GAME.base(GAME.pair_state)
    continues = outcome[:, 2:].sum(axis=1)
    rally = state >= FIRST_RALLY_STATE
    assert largest_continuation(GAME) == pytest.approx(continues[rally].max(), abs=1e-12)
    policy = random_policy(GAME, 1)
    share = np.bincount(GAME.pair_state, policy.pair_probabilities() * continues, GAME.n_states)
    chain = induced(policy)
    assert chain.contraction == pytest.approx(share[GAME.base(np.arange(GAME.n_states)) >= FIRST_RALLY_STATE].max(), abs=1e-12)
    reward = np.bincount(GAME.pair_state, policy.pair_probabilities() * (outcome[:, 1] - outcome[:, 0]), GAME.n_states)
    np.testing.assert_allclose(chain.reward, reward, atol=1e-12)
    value = evaluate(policy, policy)
    assert value.contraction == pytest.approx(chain.contraction**2)
    assert solve(GAME).contraction == pytest.approx(largest_continuation(GAME))
    other = with_probabilities(GAME, 8)
    both = solve(GAME, other)
    assert both.contraction == pytest.approx(largest_continuation(GAME) * largest_continuation(other))
    assert both.error_bound == error_bound(both.residual, both.contraction)


def alike(game: Game) -> PairPolicy:
    """Every legal stroke equally likely, whatever the efforts."""
    return PairPolicy(game=game, probability=1 / np.bincount(game.base_pair_state)[game.base_pair_state])


@pytest.mark.parametrize(("serving", "receiving"), [(0.25, -0.5), (1 + 1e-12, -1 - 1e-12), (-1 - 1e-12, 1 + 1e-12)])
def test_odds_are_probabilities(serving: float, receiving: float) -> None:
    """A value v is a probability of (1 + v) / 2, that of the other player's serve the opposite; rounding is cut off."""
    striking = tuple(np.full(5, value) for value in (serving, receiving))
    value = ProfileValue(striking=striking, residual=0.0, contraction=0.5, error_bound=0.02)  # type: ignore[arg-type]
    first, second = value.odds(), value.odds(1)
    assert first.serving == pytest.approx((1 + serving) / 2, abs=1e-9)
    assert first.receiving == pytest.approx((1 - receiving) / 2, abs=1e-9)
    assert second.serving == pytest.approx((1 + receiving) / 2, abs=1e-9)
    assert second.receiving == pytest.approx((1 - serving) / 2, abs=1e-9)
    for odds in (first, second):
        assert 0 <= min(odds.serving, odds.receiving) <= max(odds.serving, odds.receiving) <= 1
        assert odds.error_bound == 0.01


@pytest.mark.parametrize(("serving", "receiving"), [(0.3, 0.6), (0.02, 0.99), (0.9, 0.9)])
def test_what_a_rally_is_worth_in_a_match(serving: float, receiving: float) -> None:
    """In every situation the chance before a rally is the mean of those after it, and the winner serves next."""
    rules = Rules(points=2, clear=2, cap=3, games=2)
    table = match_table(serving, receiving, rules)

    def chance(situation: tuple[int, int, int, int, int]) -> float:
        won, lost = table[situation]
        p = receiving if situation[4] else serving
        return p * won + (1 - p) * lost

    for (mine, theirs, points, against, server), (won, lost) in table.items():
        for winner, after in ((0, won), (1, lost)):
            score, games = [points, against], [mine, theirs]
            score[winner] += 1
            if score[winner] == 3 or (score[winner] >= 2 and score[winner] - score[1 - winner] >= 2):
                games[winner] += 1
                score = [0, 0]
            expected = float(winner == 0) if games[winner] == 2 else chance((games[0], games[1], score[0], score[1], winner))
            assert after == pytest.approx(expected)
        assert table[mine, theirs, points, against, 1 - server] == (won, lost)
    assert least_gain(serving, receiving, rules) == min(won - lost for won, lost in table.values())


@pytest.mark.parametrize("p", [-1e-9, 1 + 1e-9, float("nan"), 2.0])
def test_restrictions_are_from_0_to_1(p: float) -> None:
    with pytest.raises(ExactError, match="expected a number from 0 to 1"):
        restricted_response(random_policy(GAME, 0), p)


def test_refusals_of_solvers() -> None:
    with pytest.raises(ExactError, match="robust play over no games: give one or more"):
        solve_robust([])
    with pytest.raises(ExactError, match="differ in"):
        solve_robust([GAME, random_game(7)])
    game = with_recovery(random_game(2), 2)
    policy = waiting(random_policy(game, 2), 2)
    chain = induced(dataclasses.replace(policy, game=dataclasses.replace(game, recovery=None), waits=None))
    with pytest.raises(ExactError, match="a best response with recovery needs the policy, not its chain"):
        best_response(dataclasses.replace(chain, game=game))


def test_limits_make_rare_strokes_faults() -> None:
    game = reduced_game()
    allowed, found = supported(game, 50), limited(game, 50)
    assert 0 < (~allowed).sum() < game.n_base_pairs
    assert (found.threshold[~allowed] == ONE - 1).all()
    np.testing.assert_array_equal(found.threshold[allowed], game.threshold[allowed])
    assert limited(GAME, 0) is limited(GAME, -1) is GAME


def test_endless_states_are_named() -> None:
    """The only state whose only stroke never ends the rally; a serve may always go on."""
    single = np.flatnonzero(np.diff(GAME.base_pair_start) == 1)
    state = int(single[single >= FIRST_RALLY_STATE][2])
    threshold = GAME.threshold.copy()
    threshold[int(GAME.base_pair_start[state]), :2] = 0
    endless = dataclasses.replace(GAME, threshold=threshold)
    stroke = GAME.catalogue.names[int(GAME.base_pair_stroke[GAME.base_pair_start[state]])]
    with pytest.raises(ExactError, match=re.escape(f"{stroke} never ends the rally in state: {GAME.describe(state)};")):
        solve(endless)
    with pytest.raises(ExactError, match="never ends the rally against some position"):
        solve(with_recovery(endless, 2))
    with pytest.raises(ExactError, match=re.escape(f"ever ends the rally in state: {GAME.describe(state)}")):
        evaluate(random_policy(endless, 0), random_policy(GAME, 0))
    threshold = GAME.threshold.copy()
    threshold[:1, :2] = 0
    assert solve(dataclasses.replace(GAME, threshold=threshold)).error_bound < 1e-8
