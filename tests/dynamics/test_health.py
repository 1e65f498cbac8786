"""Value iteration against a hand-solved game and against play by simulation."""

import numpy as np
import pytest

from shuttle_marl.dynamics import default_game
from shuttle_marl.dynamics.health import Solver, play_statistics
from shuttle_marl.game.draws import draw, outcome_draw, stream
from shuttle_marl.game.rally import FAULT, ROOT, Game, layout, strike, thresholds
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.policy import bc

NAMES = (
    "short-serve:front-centre:below:backhand",
    "clear:back-centre:above:forehand",
    "smash:middle-left:above:forehand",
    "lift:back-centre:below:forehand",
)


def small() -> Game:
    """Serve, then only clears and smashes from above, lifts from below."""
    catalogue = Catalogue.from_names(NAMES)
    replies = np.array([[0, 1, 1, 1]] * 4 + [[1, 0, 0, 0]], dtype=bool)
    tables = layout(catalogue, replies)
    game = Game(catalogue=catalogue, threshold=np.zeros((int(tables["pair_start"][-1]), 3), np.uint16), **tables)
    good = np.array([1.0, 0.9375, 0.75, 0.875])[game.pair_stroke]
    returned = np.array([1.0, 1.0, 0.5, 1.0])[game.pair_stroke]
    above = np.array([0.5, 1.0, 0.0, 1.0])[game.pair_stroke]
    return Game(catalogue=catalogue, threshold=thresholds(good, returned, above), **tables)


def test_minimax_of_a_game_solved_by_hand() -> None:
    """Above: smash gives -0.25 + 0.375 - 0.375 L, clear -0.0625 - 0.9375 A; below: lift L = -0.125 - 0.875 A.

    With A the value above: smash, A = 0.125 - 0.375 L = 0.125 + 0.046875 + 0.328125 A, so A = 0.171875 / 0.671875, and a
    clear is worth less. The serve is met from either height: -(A + L) / 2.
    """
    solver = Solver(small())
    value = solver.minimax()
    a = 0.171875 / 0.671875
    low = -0.125 - 0.875 * a
    assert value[ROOT] == pytest.approx(-(a + low) / 2, abs=2e-4)
    policy = solver.greedy(solver.quality(-value))
    mix = play_statistics(solver, policy)["shot_mix"]
    assert mix["clear"] == 0
    assert mix["smash"] > 0


def test_nobody_beats_the_minimax_policy() -> None:
    solver = Solver(default_game())
    value = solver.minimax()
    policy = solver.greedy(solver.quality(-value))
    share, _ = solver.best_response(policy)
    assert share == pytest.approx(0.5, abs=1e-6)


def test_statistics_agree_with_sampled_rallies() -> None:
    game = default_game()
    policy = bc.load(None, game)
    exact = play_statistics(Solver(game), policy.pair_probabilities())
    cumulative = policy.padded()
    state = np.full(20_000, ROOT, dtype=np.int32)
    key = stream(3, np.arange(len(state)))
    alive = np.arange(len(state))
    strokes = faults = 0
    for n in range(500):
        bits = draw(key[alive], n)
        choice = ((bits >> np.uint64(32)) * np.uint64(65535) >> np.uint64(32)).astype(np.int64)
        k = (cumulative[state[alive]] <= choice[:, None]).sum(axis=1)
        outcome, following = strike(game, state[alive], k, outcome_draw(bits))
        strokes += len(alive)
        faults += int((outcome == FAULT).sum())
        state[alive] = following
        alive = alive[following >= 0]
        if not len(alive):
            break
    assert strokes / 20_000 == pytest.approx(exact["mean_rally"], rel=0.025)
    assert faults / 20_000 == pytest.approx(exact["rallies_ending_on_fault"], abs=0.015)
