"""Advice with enough real strokes behind it: what a limited best response plays, and that nothing allowed is better."""

import numpy as np
import pytest

from shuttle_marl.exact import best_response, evaluate, holes
from shuttle_marl.game.shipped import least_support, load_game, real_strokes
from shuttle_marl.game.tables import GameError
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import tiring_game
from tests.reduced import reduced_model

GAME = load_game(reduced_model())
BEHIND = real_strokes(GAME)[np.tile(GAME.base_pair_edge, GAME.n_blocks)]
LEAST = 50


def _allowed() -> np.ndarray:
    """``[P]`` whether a pair has enough real strokes, or the most of its state; state by state."""
    allowed = BEHIND >= LEAST
    for state in np.flatnonzero(GAME.playable).tolist():
        pairs = GAME.pairs_of(state)
        allowed[pairs] |= BEHIND[pairs] == BEHIND[pairs].max()
    return allowed


def test_no_allowed_stroke_is_better_than_the_limited_response() -> None:
    opponent = tabulate(resolve("attacking", GAME), GAME, "attacking")
    answer = best_response(opponent, at_least=LEAST)
    played, allowed = answer.policy.pair_probabilities() > 0.5, _allowed()
    assert not allowed.all()
    assert allowed[played].all()
    value = evaluate(answer.policy, opponent)
    assert value.odds().rally == pytest.approx(answer.value.odds().rally, abs=1e-8)
    # Policy improvement: with the values of this profile, the best allowed stroke is the one that is played.
    worth = np.where(allowed, GAME.stroke_values(value.striking[1]), -2)
    best = np.maximum.reduceat(worth, GAME.first_pairs)
    assert np.maximum.reduceat(np.where(played, worth, -2), GAME.first_pairs) == pytest.approx(best, abs=1e-7)
    assert answer.value.odds().rally < best_response(opponent).value.odds().rally


def test_better_strokes_of_holes_have_enough_real_ones_behind_them() -> None:
    policy = tabulate(resolve("attacking", GAME), GAME, "attacking")
    found = holes(policy, top=30, at_least=LEAST)
    assert found.loss - found.given_up == pytest.approx(found.exploitability, abs=3 * found.error_bound + 1e-9)
    for hole in found.holes:
        pairs = GAME.pairs_of(hole.state)
        assert hole.best_real >= min(LEAST, BEHIND[pairs].max())
        names = [GAME.catalogue.names[stroke] for stroke in GAME.legal_strokes(hole.state)]
        assert hole.played_real == BEHIND[pairs][names.index(hole.played)]
    assert any(hole.best_real < LEAST for hole in holes(policy, top=30).holes)


def test_games_without_counts_have_no_such_limit() -> None:
    game = tiring_game()
    policy = tabulate(resolve("random", game), game, "random")
    assert least_support(game) == 0
    assert holes(policy).holes[0].best_real is None
    with pytest.raises(GameError, match="number of real strokes is not known"):
        best_response(policy, at_least=1)
