"""Draws that equal a limit: the stroke has the outcome above it, in the kernel, the rule for batches and the stepper."""

import numpy as np

from shuttle_marl.game import UniformPolicy, default_game, tabulate
from shuttle_marl.game.draws import draw, outcome_draw, stream
from shuttle_marl.game.rally.stepper import stepper_of
from shuttle_marl.game.rules import strike
from shuttle_marl.kernel import play_rallies


def test_draws_that_equal_a_limit_lie_above() -> None:
    game, seed = default_game(), 3
    rallies = play_rallies(game, (tabulate(UniformPolicy(), game),) * 2, 100_000, seed=seed)
    draws = outcome_draw(draw(stream(seed, rallies.match)[rallies.row_of_stroke], rallies.position))
    state, k = rallies.legal(game)
    pair = game.pair_at(state, k)
    fault, winner, below = game.limits_of(pair).T
    low, hurries = draws & 0xFFFF, (draws >> 16)[:, None] < 256 * game.hurry_of(pair)
    returned = np.where(low < below, 2 + 2 * hurries[:, 0], 3 + 2 * hurries[:, 1])
    expected = np.where(low < fault, 0, np.where(low < winner, 1, returned))
    np.testing.assert_array_equal(rallies.outcome(game.catalogue), expected)
    equal = np.flatnonzero(
        (low == fault) | (low == winner) | (low == below) | ((draws >> 16) == 256 * game.hurry_of(pair).max(axis=1))
    )
    for limit in (fault, winner, below):
        assert (low == limit).sum() > 5
    np.testing.assert_array_equal(strike(game, state[equal], k[equal], draws[equal])[0], expected[equal])
    stepper, stroke = stepper_of(game), game.stroke_at(state, k)
    for i in equal[:500].tolist():
        played, _ = stepper.step(int(state[i]), 0, int(stroke[i]), int(draws[i]))
        assert played.outcome == expected[i]
