"""Lists that read little of the state, advice with enough real strokes behind it, and holes of a policy."""

import numpy as np
import pytest
from hypothesis import given, settings

from shuttle_marl.exact import best_response, evaluate, holes, solve, visits
from shuttle_marl.exact.play import averaged, cells_of, lists
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.policy import UniformPolicy, tabulate
from shuttle_marl.game.shipped import least_support, load_game, real_strokes
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import games, random_policy, seeds, tiring_game
from tests.reduced import reduced_game, reduced_model


def test_a_list_for_every_state_is_the_best_response() -> None:
    game = reduced_game()
    opponent = tabulate(UniformPolicy(), game)
    best = best_response(opponent).value.odds().rally
    *_, found = lists(opponent, np.arange(game.n_states))
    assert evaluate(found, opponent).odds().rally == pytest.approx(best, abs=1e-5)


def test_lists_that_read_less_win_less() -> None:
    game = reduced_game()
    opponent = tabulate(UniformPolicy(), game)
    won = [best_response(opponent).value.odds().rally]
    for parts in (("incoming", "contact"), ()):
        *_, found = lists(opponent, cells_of(game, *parts))
        won.append(evaluate(found, opponent).odds().rally)
    assert won[0] > won[1] > won[2] > 0.5


def test_cells_read_the_parts_and_nothing_else() -> None:
    game = reduced_game()
    state = np.arange(game.n_states)
    cell = cells_of(game, "hurried", "contact")
    assert len(np.unique(cell)) == 4
    for a in range(4):
        assert len({(int(game.hurried(s)), int(game.contact(s))) for s in state[cell == a]}) == 1
    everything = cells_of(game, "own", "incoming", "contact", "duel", "effort", "opponent_effort", "hurried")
    assert len(np.unique(everything)) == game.n_states
    assert not cells_of(game).any()


def test_the_mean_over_every_state_is_the_policy_itself() -> None:
    game = reduced_game()
    perfect = solve(game).policy[0]
    alike = averaged(perfect, perfect, np.arange(game.n_states))
    np.testing.assert_allclose(alike.pair_probabilities(), perfect.pair_probabilities(), atol=1e-4)


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
    opponent = tabulate(resolve("attacking", GAME), GAME)
    answer = best_response(opponent, at_least=LEAST)
    played, allowed = answer.policy.pair_probabilities() > 0.5, _allowed()
    assert not allowed.all()
    assert allowed[played].all()
    value = evaluate(answer.policy, opponent)
    assert value.odds().rally == pytest.approx(answer.value.odds().rally, abs=1e-8)
    # Policy improvement: with the values of this profile, the best allowed stroke is the one that is played.
    worth = np.where(allowed, GAME.stroke_values(value.striking[1]), -2)
    best = np.maximum.reduceat(worth, GAME.pair_start[:-1][GAME.playable])
    assert np.maximum.reduceat(np.where(played, worth, -2), GAME.pair_start[:-1][GAME.playable]) == pytest.approx(best, abs=1e-7)
    assert answer.value.odds().rally < best_response(opponent).value.odds().rally


def test_better_strokes_of_holes_have_enough_real_ones_behind_them() -> None:
    policy = tabulate(resolve("attacking", GAME), GAME)
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
    policy = tabulate(resolve("random", game), game)
    assert least_support(game) == 0
    assert holes(policy).holes[0].best_real is None
    with pytest.raises(GameError, match="number of real strokes is not known"):
        best_response(policy, at_least=1)


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
