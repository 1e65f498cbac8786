"""What strokes are worth: consistent with the values of states, also against a receiver who chooses positions."""

import numpy as np
import pytest

from shuttle_marl.exact import evaluate
from shuttle_marl.reports.value import Value
from tests.exact.exact_games import random_game, random_policy
from tests.exact.test_hidden_positions_solved import waiting, with_recovery


@pytest.mark.parametrize("hidden", [False, True])
def test_the_mean_advantage_of_what_a_policy_plays_is_zero(hidden: bool) -> None:
    game = with_recovery(random_game(2), 2) if hidden else random_game(2)
    first, second = random_policy(game, 1), random_policy(game, 2)
    if hidden:
        first, second = waiting(first, 1), waiting(second, 2)
    value = evaluate(first, second)
    for seat, (own, other) in enumerate(((first, second), (second, first))):
        worth = Value(game, value.striking, seat, other)
        pairs = np.arange(game.n_pairs)
        advantage = worth.advantage(pairs, game.pair_state)
        assert np.allclose(worth.win() - worth.before(game.pair_state), advantage, atol=1e-12)
        mean = game.sum_by_state(own.pair_probabilities() * advantage)[game.playable]
        assert np.abs(mean).max() < 1e-7
        assert np.abs(advantage).max() > 0.01
