"""Tables that form no game: each rule of the layout, broken alone; and what a game of a pair and one without positions refuse."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.draws import ONE
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.tables import Game
from tests.exact.exact_games import tiring_game
from tests.recovery import with_recovery
from tests.reduced import reduced_game, reduced_model

GAME = tiring_game()
N, EDGES, REPLIES = GAME.n_strokes, len(GAME.edge_own), len(GAME.reply_edge)
CLEAR, LIFT, NET, SMASH = 1, 4, 5, 7
"""Of the eight strokes: clear, half-smash (3), a net shot from above and smash from above the net, the others from below."""


def changed(name: str, at: Any, value: int) -> dict[str, Any]:
    table = getattr(GAME, name).copy()
    table[at] = value
    return {name: table}


def edge(own: int, incoming: int, duel: int = 0) -> int:
    """Number of an edge."""
    found = (GAME.edge_own == own) & (GAME.edge_incoming == incoming) & (GAME.edge_duel == duel)
    (number,) = np.flatnonzero(found).tolist()
    return int(number)


def replies(y: int, contact: int, longer: int = 0) -> slice:
    """Where the replies to stroke y stand."""
    first = int(GAME.reply_start[y, longer, contact])
    return slice(first, first + int(GAME.reply_count[y, contact]))


def exchanged(first: int, second: int) -> dict[str, Any]:
    """The own last strokes of two edges, exchanged."""
    own = GAME.edge_own.copy()
    own[[first, second]] = own[[second, first]]
    return {"edge_own": own}


def without_rows(y: int, contact: int, count: int) -> dict[str, Any]:
    """No more than so many replies to stroke y from a contact, and their thresholds."""
    state = GAME.base_pair_state
    kept = (GAME.incoming(state) != y) | (GAME.contact(state) != contact) | (GAME.base_pair_rank < count)
    return {**changed("reply_count", (y, contact), count), "threshold": GAME.threshold[kept], "hurry": GAME.hurry[kept]}


def depending_on_the_duel() -> dict[str, Any]:
    """Three of the four replies to a net shot from above: the first three in short duels, the last three in long ones."""
    starts = GAME.reply_start.copy()
    starts[NET, 1, 1] += 1
    return {**without_rows(NET, 1, 3), "reply_start": starts}


def disordered(y: int, contact: int, order: list[int]) -> dict[str, Any]:
    listed = GAME.reply_edge.copy()
    listed[replies(y, contact)] = listed[replies(y, contact)][order]
    return {"reply_edge": listed}


NO_EDGES = {name: getattr(GAME, name)[:0] for name in ("edge_own", "edge_incoming", "edge_duel")}
BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "no edges": (NO_EDGES, "edge 0 is not the start of a rally"),
    "own last stroke at the start": (changed("edge_own", 0, 0), "edge 0 is not the start of a rally"),
    "incoming stroke at the start": (changed("edge_incoming", 0, 0), "edge 0 is not the start of a rally"),
    "duel at the start": (changed("edge_duel", 0, 1), "edge 0 is not the start of a rally"),
    "own above": (changed("edge_own", 3, N + 1), f"table edge_own: expected numbers from 0 to {N}"),
    "own below": (changed("edge_own", 3, -1), f"table edge_own: expected numbers from 0 to {N}"),
    "incoming above": (changed("edge_incoming", 3, N + 1), f"table edge_incoming: expected numbers from 0 to {N}"),
    "duel above": (changed("edge_duel", 3, 4), "table edge_duel: expected numbers from 0 to 3"),
    "reply above": (changed("reply_edge", 3, EDGES), f"table reply_edge: expected numbers from 0 to {EDGES - 1}"),
    "reply below": (changed("reply_edge", 3, -1), f"table reply_edge: expected numbers from 0 to {EDGES - 1}"),
    "fall to winner": (changed("threshold", (0, 1), int(GAME.threshold[0, 0]) - 1), "the cumulative probabilities of a legal"),
    "fall to below": (changed("threshold", (-1, 2), int(GAME.threshold[-1, 1]) - 1), "the cumulative probabilities of a legal"),
    "start below": (changed("reply_start", (CLEAR, 0, 0), -1), f"expected replies from 0 to {REPLIES - 1}"),
    "start above": (changed("reply_start", (N, 1, 1), REPLIES + 1), f"expected replies from 0 to {REPLIES - 1}"),
    "end above": (changed("reply_start", (CLEAR, 0, 0), REPLIES - 2), f"expected replies from 0 to {REPLIES - 1}"),
    "count below": (changed("reply_count", (CLEAR, 0), -1), f"expected replies from 0 to {REPLIES - 1}"),
    "count above": (changed("reply_count", (N, 0), N + 1), f"expected replies from 0 to {REPLIES - 1}"),
    "fewer thresholds": ({"threshold": GAME.threshold[1:], "hurry": GAME.hurry[1:]}, "does not count the legal strokes"),
    "no reply": (without_rows(LIFT, 1, 0), "a state other than the serve from above has no legal stroke"),
    "edge twice": (changed("edge_own", edge(CLEAR, LIFT), LIFT), "name an edge twice"),
    "other own": (exchanged(edge(CLEAR, LIFT), edge(SMASH, LIFT)), "do not lead to the replies of a stroke, in their order"),
    "start as reply": (changed("reply_edge", replies(N, 0), 0), "do not lead to the replies of a stroke, in their order"),
    "other contact": (
        changed("reply_edge", replies(CLEAR, 0).stop - 1, edge(CLEAR, SMASH)),
        "do not lead to the replies of a stroke, in their order",
    ),
    "falling order": (disordered(CLEAR, 1, [1, 0, 2, 3]), "do not lead to the replies of a stroke, in their order"),
    "reply twice": (disordered(CLEAR, 1, [0, 1, 2, 2]), "do not lead to the replies of a stroke, in their order"),
    "first net shot": (changed("edge_duel", edge(CLEAR, NET, 1), 2), "table edge_duel does not count the net shots in a row"),
    "no net shot": (changed("edge_duel", edge(CLEAR, SMASH), 1), "table edge_duel does not count the net shots in a row"),
    "replies by duel": (depending_on_the_duel(), "the legal strokes of a state depend on the duel"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_tables_that_break_a_rule_are_refused(name: str) -> None:
    changes, says = BROKEN[name]
    with pytest.raises(GameError, match=says):
        dataclasses.replace(GAME, **changes)


@pytest.mark.parametrize(
    ("odds", "fits"),
    [
        ([ONE], True),
        ([ONE] * 8, True),
        ([ONE] * 9, False),
        ([ONE, 1], True),
        ([ONE, 0], False),
        ([ONE, 1 << 20], True),
        ([ONE, (1 << 20) + 1], False),
        ([ONE + 1, ONE], False),
        ([ONE - 1], False),
    ],
)
def test_odds_of_faults_have_limits(odds: list[int], fits: bool) -> None:
    table = np.array(odds, np.int32)
    if fits:
        assert dataclasses.replace(GAME, fault_odds=table).levels == len(odds)
    else:
        with pytest.raises(GameError, match=f"table fault_odds: expected 1 to 8 odds of 1 to {1 << 20}, the first of them {ONE}"):
            dataclasses.replace(GAME, fault_odds=table)


@pytest.mark.parametrize(
    ("name", "table", "kind"),
    [
        ("threshold", GAME.threshold.astype(np.int32), "int32"),
        ("hurry", GAME.hurry.astype(np.uint16), "uint16"),
        ("edge_own", GAME.edge_own.astype(np.int64), "int64"),
        ("fault_odds", GAME.fault_odds.tolist(), "list"),
    ],
)
def test_tables_have_their_kinds_of_numbers(name: str, table: Any, kind: str) -> None:
    with pytest.raises(GameError, match=f"table {name} of {kind}: expected uint16 for threshold, uint8 for hurry, int32"):
        dataclasses.replace(GAME, **{name: table})


def a_pair() -> Game:
    return pair_game("viktor-axelsen", "kento-momota", game=reduced_model())


def test_the_game_of_a_pair_has_tables_for_each_seat() -> None:
    pair, average = a_pair(), reduced_game()
    for wrong in ({"people": pair.people}, {"threshold": pair.threshold}):
        with pytest.raises(GameError, match="tables of two seats are those of a pair: make them with pair_game"):
            dataclasses.replace(average, **wrong)
    with pytest.raises(GameError, match=r"has the tables of both players; take those of a seat"):
        _ = pair.limits


def test_positions_are_of_one_seat_and_without_recovery_there_is_one() -> None:
    hidden = with_recovery(GAME, 3, 3)
    with pytest.raises(GameError, match="has the tables of both players; take those of a seat"):
        _ = a_pair().waiting
    assert len(hidden.waiting.choices) == GAME.n_base_states
    assert np.array_equal(GAME.waiting.mask(np.arange(GAME.n_base_states)), np.tile(np.arange(9) == 4, (GAME.n_base_states, 1)))
    assert np.array_equal(GAME.waiting.limits, GAME.limits)
    assert (hidden.n_actions, hidden.hides, GAME.n_actions, GAME.hides) == (N + 9, True, N, False)
    assert hidden.action_names[N : N + 2] == ("wait:front-forehand", "wait:front-centre")
    assert GAME.action_names == GAME.catalogue.names
