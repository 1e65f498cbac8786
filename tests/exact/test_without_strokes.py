"""Games in which some strokes are illegal: only their pairs are missing, and they are solved exactly."""

import numpy as np
import pytest

from shuttle_marl.exact import best_response, solve
from shuttle_marl.game.tables import GameError
from tests.reduced import reduced_game

GAME = reduced_game()
SHOT_OF = np.array([name.partition(":")[0] for name in GAME.catalogue.names])


@pytest.mark.parametrize("names", [("cross-court-net-shot",), ("smash", "half-smash"), ("lift:back-right:below:forehand",)])
def test_only_the_named_strokes_are_missing(names: tuple[str, ...]) -> None:
    smaller = GAME.without(*names)
    assert smaller.n_states == GAME.n_states
    removed = np.isin(SHOT_OF, names) | np.isin(GAME.catalogue.names, names)
    reachable = ~np.append(removed, False)[GAME.incoming(np.arange(GAME.n_states))]
    for state in np.flatnonzero(GAME.playable & reachable).tolist():
        strokes = [stroke for stroke in GAME.legal_strokes(state).tolist() if not removed[stroke]]
        assert smaller.legal_strokes(state).tolist() == strokes
    pairs = np.flatnonzero(~removed[GAME.pair_stroke] & reachable[GAME.pair_state])
    moved = smaller.pair(GAME.pair_state[pairs], GAME.pair_stroke[pairs])
    assert np.array_equal(smaller.outcome_probabilities(moved), GAME.outcome_probabilities(pairs))
    assert np.array_equal(smaller.arrivals(moved), GAME.arrivals(pairs))
    assert smaller.hash != GAME.hash


def test_its_solution_is_that_of_a_player_whose_removed_strokes_are_faults() -> None:
    """An independent way to forbid strokes: both strike with tables in which these strokes lose the rally."""
    import dataclasses

    removed = np.isin(SHOT_OF, ["smash", "half-smash"])
    faulty = GAME.threshold.copy()
    faulty[removed[GAME.base_pair_stroke]] = np.iinfo(np.uint16).max
    expected = solve(dataclasses.replace(GAME, threshold=faulty))
    solution = solve(GAME.without("smash", "half-smash"))
    bound = solution.error_bound + expected.error_bound
    assert solution.value_at_serve == pytest.approx(expected.value_at_serve, abs=bound)
    # No opponent gains against perfect play of the smaller game.
    assert best_response(solution.policy[0]).value.odds().value == pytest.approx(0, abs=1e-6)


def test_what_cannot_be_removed() -> None:
    with pytest.raises(GameError, match="no stroke 'nets'; shot types are: short-serve"):
        GAME.without("nets")
    with pytest.raises(GameError, match=r"no stroke is legal after short-serve:\S+ without net-shot"):
        GAME.without("net-shot")
    serves = {shot for shot in SHOT_OF.tolist() if shot.endswith("serve")}
    with pytest.raises(GameError, match="no stroke is legal after the start of a rally without"):
        GAME.without(*serves)
    assert GAME.without().hash == GAME.hash
