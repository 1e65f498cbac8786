"""Losses by state, error bounds, and the counts that solvers report."""

import dataclasses
import re

import numpy as np
import pytest

from shuttle_marl.exact import ExactError, PairPolicy, best_response, evaluate, holes, policy_regret, solve, solve_robust
from shuttle_marl.exact.fixed_point import FIRST_RALLY_STATE
from shuttle_marl.exact.optimal import limited, restricted_response
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.shipped import supported
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import random_game, random_policy, tiring_game
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


def alike(game: Game) -> PairPolicy:
    """Every legal stroke equally likely, whatever the efforts."""
    return PairPolicy(game=game, probability=1 / np.bincount(game.base_pair_state)[game.base_pair_state])


@pytest.mark.parametrize("p", [-1e-9, 1 + 1e-9, float("nan"), 2.0])
def test_restrictions_are_from_0_to_1(p: float) -> None:
    with pytest.raises(ExactError, match="expected a number from 0 to 1"):
        restricted_response(random_policy(GAME, 0), p)


def test_refusals_of_solvers() -> None:
    with pytest.raises(ExactError, match="robust play over no games: give one or more"):
        solve_robust([])
    with pytest.raises(ExactError, match="differ in"):
        solve_robust([GAME, random_game(7)])


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
    with pytest.raises(ExactError, match=re.escape(f"never ends the rally in state: {GAME.describe(state)}")):
        solve(with_recovery(endless, 2))
    with pytest.raises(ExactError, match=re.escape(f"ever ends the rally in state: {GAME.describe(state)}")):
        evaluate(random_policy(endless, 0), random_policy(GAME, 0))
    threshold = GAME.threshold.copy()
    threshold[:1, :2] = 0
    assert solve(dataclasses.replace(GAME, threshold=threshold)).error_bound < 1e-8
