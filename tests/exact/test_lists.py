"""Lists that read little of the state, and what a policy plays."""

import dataclasses

import numpy as np
import pytest

from shuttle_marl.exact import best_response, evaluate, solve
from shuttle_marl.exact.lists import averaged, cells_of, lists
from shuttle_marl.exact.play import impossible, play, unusual
from shuttle_marl.game.court import BACK, third_of
from shuttle_marl.game.policy import UniformPolicy
from shuttle_marl.game.shipped import default_game
from shuttle_marl.game.stroke import FRONT_COURT, SHOTS
from shuttle_marl.game.tabulated import tabulate
from tests.reduced import reduced_game


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
    assert alike.pair_probabilities() == pytest.approx(perfect.pair_probabilities(), abs=1e-4)


def test_no_stroke_of_the_shipped_game_is_impossible() -> None:
    """Counted here stroke by stroke: no net kill or net shot is legal after a stroke that is met in the back third."""
    game = default_game()
    assert not impossible(game).any()
    names = np.array(SHOTS)[game.catalogue.shot]
    for incoming in np.flatnonzero(third_of(game.catalogue.area) == BACK):
        assert not np.isin(names[game.reply_mask[incoming].any(axis=0)], FRONT_COURT).any()


def test_impossible_strokes_are_found() -> None:
    game = default_game()
    catalogue = dataclasses.replace(game.catalogue, area=np.full(len(game.catalogue), 8, np.int8))
    moved = object.__new__(type(game))
    moved.__dict__.update({**vars(game), "catalogue": catalogue})
    front = np.isin(np.array(SHOTS)[game.catalogue.shot[game.base_pair_stroke]], FRONT_COURT)
    assert (impossible(moved) == front).all()


def test_play_counts_strokes_and_rare_ones() -> None:
    game = reduced_game()
    uniform, perfect = tabulate(UniformPolicy(), game), solve(game).policy[0]
    own = play(uniform, perfect, unusual(uniform))
    assert sum(own["shots"].values()) == pytest.approx(1)
    assert own["rare"] == 0, "a uniform player plays every legal shot type in more than 1 % of cases"
    assert own["types"] == sum(share > 0.02 for share in own["shots"].values())
    # Everything but its own single stroke is rare for a player who always plays the same one.
    assert play(uniform, uniform, unusual(perfect))["rare"] > 0.3
    assert play(perfect, perfect, unusual(perfect))["rare"] == 0
