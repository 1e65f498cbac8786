"""Holes: where a policy loses to its best response, and that the losses add up to its exploitability."""

import numpy as np
import pytest
from hypothesis import given, settings

from shuttle_marl.exact import best_response, holes, solve, visits
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import games, random_policy, seeds, tiring_game


@settings(max_examples=25, deadline=None)
@given(games, seeds)
def test_losses_add_up_to_the_exploitability(game: Game, seed: int) -> None:
    policy = random_policy(game, seed, 3.0)
    found = holes(policy, top=game.n_states)
    assert found.loss - found.given_up == pytest.approx(found.exploitability, abs=3 * found.error_bound + 1e-9)
    assert sum(hole.loss for hole in found.holes) == pytest.approx(found.loss, abs=1e-9 * game.n_states)
    assert found.share * found.loss == pytest.approx(found.loss, abs=1e-9 * game.n_states)
    assert found.loss >= found.exploitability - 1e-9
    assert found.given_up >= -1e-9


def test_a_hole_says_what_is_played_and_what_is_better() -> None:
    game = tiring_game()
    solution = solve(game)
    policy = random_policy(game, 3, 3.0)
    answer = best_response(policy)
    found = holes(policy, top=4, solution=solution, response=answer)
    assert len(found.holes) == 4
    assert [hole.loss for hole in found.holes] == sorted((hole.loss for hole in found.holes), reverse=True)
    alone, met = visits(policy, policy).states[0], visits(policy, answer.policy).states[0]
    probability = policy.pair_probabilities()
    for hole in found.holes:
        assert hole.description == game.describe(hole.state)
        assert hole.in_self_play == pytest.approx(alone[hole.state])
        assert hole.against_best_response == pytest.approx(met[hole.state])
        pairs, names = game.pairs_of(hole.state), [game.catalogue.names[k] for k in game.legal_strokes(hole.state)]
        values = game.stroke_values(solution.value[1])[pairs]
        assert hole.regret == pytest.approx(solution.value[0][hole.state] - probability[pairs] @ values, abs=1e-8)
        assert names[int(values.argmax())] == hole.best
        assert hole.best_share == pytest.approx(probability[pairs][int(values.argmax())])
        assert names[int(probability[pairs].argmax())] == hole.played


def test_perfect_play_has_no_holes() -> None:
    game = tiring_game()
    found = holes(solve(game).policy[0])
    assert found.holes == ()
    assert found.share == 1.0
    assert np.isclose(found.exploitability, 0, atol=1e-8)
