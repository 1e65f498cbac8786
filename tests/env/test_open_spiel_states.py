"""States and observers of the rally in OpenSpiel, one action at a time, and what the game says of itself."""

import numpy as np
import pyspiel
import pytest

from shuttle_marl.env.open_spiel import RallyGame, RallyObserver, RallyState
from shuttle_marl.game import default_game
from shuttle_marl.game.layout import SWAP, observations
from shuttle_marl.game.rules import FAULT, RETURNED_ABOVE, RETURNED_BELOW, WINNER
from shuttle_marl.game.shipped import load_game
from tests.exact.exact_games import hand_made, tiring_game
from tests.recovery import with_recovery

GAME = hand_made()
SERVE, SMASH, LIFT = range(3)
HIDDEN = with_recovery(tiring_game(), 3, 3)
CHANCE, TERMINAL = int(pyspiel.PlayerId.CHANCE), int(pyspiel.PlayerId.TERMINAL)


def after(game: RallyGame, *actions: int) -> RallyState:
    state = game.new_initial_state()
    for action in actions:
        state.apply_action(action)
    return state


def test_a_server_may_be_drawn() -> None:
    game = RallyGame(tables=GAME)
    state = game.new_initial_state()
    assert (state.current_player(), state.chance_outcomes(), str(state)) == (
        CHANCE, [(0, 0.5), (1, 0.5)], "who serves is not decided",
    )  # fmt: skip
    assert state.action_to_string(CHANCE, 1) == "player 1 serves"
    state.apply_action(1)
    assert (state.current_player(), state.legal_actions()) == (1, [SERVE])
    assert str(state) == "player 1 to strike: own none, incoming none, contact below"


@pytest.mark.parametrize(
    ("actions", "returns", "name"),
    [
        ((SERVE, FAULT), [-1, 1], "won by 1"),
        ((SERVE, RETURNED_ABOVE, SMASH, FAULT), [1, -1], "won by 0"),
        ((SERVE, RETURNED_ABOVE, SMASH, WINNER), [-1, 1], "won by 1"),
        ((SERVE, RETURNED_BELOW, LIFT, RETURNED_ABOVE, SMASH, WINNER), [1, -1], "won by 0"),
        ((SERVE, RETURNED_BELOW, LIFT, RETURNED_ABOVE, SMASH, RETURNED_BELOW), [0, 0], "cut off"),
    ],
)
def test_rallies_end(actions: tuple[int, ...], returns: list[float], name: str) -> None:
    game = RallyGame({"server": 0, "max_strokes": 3}, GAME)
    state = after(game, *actions)
    assert (state.is_terminal(), state.current_player(), state.returns(), str(state)) == (True, TERMINAL, returns, name)
    before = after(game, *actions[:-1])
    assert (before.is_terminal(), before.returns()) == (False, [0, 0])
    assert str(before).endswith(f"; stroke {len(actions) // 2}")


def test_games_are_named_by_model_and_profile() -> None:
    assert RallyGame().tables is RallyGame({"profile": ""}).tables
    assert RallyGame().tables.hash == default_game().hash
    assert RallyGame({"profile": "men"}).tables is load_game("default:men")
    assert RallyGame({"server": 1}, GAME).new_initial_state().current_player() == 1


def waiting_state() -> RallyState:
    """After a serve of player 0 and its return: who served has to choose a position."""
    return after(RallyGame({"server": 0}, HIDDEN), 0, RETURNED_ABOVE)


def test_observers_say_whose_turn_it_is_and_who_waits() -> None:
    plain, state = RallyGame(tables=GAME).make_py_observer(), after(RallyGame({"server": 1}, GAME))
    assert (plain.tensor.shape, set(plain.dict)) == ((61,), {"rally", "turn"})
    for player in (0, 1):
        plain.set_from(state, player)
        assert plain.dict["turn"].tolist() == [player]
        assert plain.string_from(state, player) == str(state)
    hidden, waiting = RallyObserver(HIDDEN), waiting_state()
    assert (hidden.tensor.shape, set(hidden.dict)) == ((62,), {"rally", "turn", "waits"})
    for player, ends in ((0, [0, 1]), (1, [1, 0])):
        hidden.set_from(waiting, player)
        assert hidden.tensor[60:].tolist() == ends
        seen = observations(HIDDEN, np.array([waiting.number]))[0]
        assert np.array_equal(hidden.dict["rally"], seen if player else seen[SWAP])
        assert [hidden.dict[name].tolist() for name in ("turn", "waits")] == [[ends[0]], [ends[1]]]
    waiting.apply_action(waiting.legal_actions()[0])
    hidden.set_from(waiting, 0)
    assert hidden.tensor[60:].tolist() == [0, 0]
