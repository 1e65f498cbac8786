"""Validation of rallies, and the columns of rally records."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game import default_game
from shuttle_marl.game.court import area_box, service_box
from shuttle_marl.game.rally import OPTIONAL, Rallies, Rally, RallyError, columns_of, stroke_dtype
from shuttle_marl.game.rules import FAULT, HURRIED_ABOVE, HURRIED_BELOW, RETURNED_BELOW, WINNER
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game


def test_wrong_rallies() -> None:
    catalogue = default_game().catalogue
    serve = int(np.flatnonzero(catalogue.is_serve)[0])
    reply = int(np.flatnonzero(~catalogue.is_serve)[0])

    def checked(**changes: object) -> Rally:
        fields: dict[str, Any] = {"catalogue": catalogue, "server": 0, "stroke": np.array([serve]), "ending": WINNER, **changes}
        none = np.zeros(np.shape(fields["stroke"]), np.int64)
        return Rally(**{"hurried": none > 0, "waited": none - 1, **fields}).checked()

    checked()
    checked(server=1, hands=("left", "right"), waited=np.array([8]), ending=0)
    checked(stroke=np.array([serve, reply]), waited=np.array([0, 8]), hurried=np.array([False, True]), ending=5)
    assert checked(stroke=np.array([], dtype=np.int64), ending=2).open
    checked(stroke=np.array([serve, len(catalogue) - 1]))
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({"stroke": np.array([], dtype=np.int64)}, "without strokes"),
        *(({"stroke": np.array(strokes)}, "starts with a serve") for strokes in ([reply], [serve, serve], [reply, serve])),
        *(({"stroke": np.array([stroke])}, "the catalogue has") for stroke in (-1, len(catalogue))),
        *(({"server": server}, "expected seat 0 or 1") for server in (-1, 2)),
        *(({"ending": ending}, "expected 0 to 5") for ending in (-1, 6)),
        *(({"hurried": np.array(hurried)}, "none for the serve") for hurried in ([True], [False, False])),
        ({"hands": ("right", "both")}, "expected right or left"),
        *(
            ({"waited": np.array(waited)}, "expected 0 to 8, or -1 where it is not known, for each of 1 strokes")
            for waited in ([9], [-2], [4, 4])
        ),
    )
    for changes, message in cases:
        with pytest.raises(RallyError, match=message):
            checked(**changes)


def test_columns_are_those_that_are_asked_for_and_positions_with_recovery() -> None:
    asked = ("value", "update")
    assert columns_of(default_game(), *asked) == ("update", "value")
    assert columns_of(load_game("default:recovery"), *asked) == ("update", "waited", "value")
    assert columns_of(load_game("default:recovery"), *OPTIONAL) == OPTIONAL
    assert columns_of(default_game()) == ()


def names_of(game: Game) -> list[int]:
    """A serve to the front, three returns, the last one a net shot."""
    names = (
        "short-serve:front-right:below:backhand",
        "lift:back-left:below:forehand",
        "smash:middle-left:above:forehand",
        "net-shot:front-right:below:forehand",
    )
    return [game.catalogue.index(name) for name in names]


def test_what_a_rally_says_follows_from_its_strokes() -> None:
    game = default_game()
    serve, lift, smash, _ = strokes = names_of(game)
    ends, hurried = [RETURNED_BELOW, HURRIED_ABOVE, HURRIED_BELOW, WINNER], np.array([False, False, True, True])
    waited, stroke = np.array([4, 8, 0, -1]), np.array(strokes)
    rally = Rally(catalogue=game.catalogue, server=1, stroke=stroke, hurried=hurried, waited=waited, ending=WINNER)
    assert rally.striker.tolist() == [1, 0, 1, 0]
    assert rally.outcome.tolist() == ends
    assert (rally.winner, rally.open, len(rally)) == (0, False, 4)
    assert rally.checked() is rally
    assert [dataclasses.replace(rally, ending=FAULT, server=server).winner for server in (0, 1)] == [0, 1]
    unfinished = dataclasses.replace(rally, ending=RETURNED_BELOW)
    assert (unfinished.winner, unfinished.open) == (None, True)
    seen = game.observation(rally.states(game))[:, [0, 1, 2, 3, 6]].tolist()
    n = game.n_strokes
    assert seen == [[n, n, 0, 0, 0], [n, serve, 0, 0, 0], [serve, lift, 1, 0, 1], [lift, smash, 0, 0, 1]]


def test_areas_of_a_rally_are_mirrored_by_hand_and_score() -> None:
    game = default_game()
    serve, lift, *_ = names_of(game)
    rally = Rally(
        catalogue=game.catalogue, server=1, stroke=np.array([serve]), hurried=np.array([False]), ending=WINNER, points=(4, 2),
        hands=("left", "right"), waited=np.array([4]),
    )  # fmt: skip
    assert rally.from_right
    odd = dataclasses.replace(rally, points=(4, 3))
    assert not odd.from_right
    # Seat 0 is left-handed: what seat 1 aims at its backhand flies to the other side.
    assert rally.aim[:, lift].tolist() == [8, 6]
    assert [rally.target(seat, lift) for seat in (0, 1)] == [8, 8]
    assert rally.aim[:, serve].tolist() == [0, 0]
    assert odd.aim[:, serve].tolist() == [2, 2]
    assert [each.target(1, serve) for each in (rally, odd)] == [2, 0]
    assert [each.as_named(1, serve) for each in (rally, odd)] == [False, True]
    assert rally.aim_box(1, lift) == area_box(6)
    assert rally.aim_box(1, serve) == service_box(0, from_right=True)
    assert odd.aim_box(1, serve) == service_box(2, from_right=False)
    assert [rally.facing(seat) for seat in (0, 1)] == [1.0, -1.0]
    assert [dataclasses.replace(rally, ends_changed=True).facing(seat) for seat in (0, 1)] == [-1.0, 1.0]


def three_rallies(game: Game) -> Rallies:
    serve, lift, smash, net = names_of(game)
    stroke = np.array([serve, lift, smash, serve, serve, net], stroke_dtype(game.n_strokes))
    return Rallies(
        pairing=np.array([5, 5, 6], np.uint32), match=np.array([2, 2, 3], np.uint32), rally=np.array([7, 8, 0], np.uint16),
        policy=np.array([[0, 1], [0, 1], [1, 2]], np.uint16), server=np.array([1, 0, 1], np.uint8),
        winner=np.array([1, 1, 1], np.uint8), reason=np.array([WINNER, FAULT, FAULT], np.uint8),
        score=np.array([[3, 4, 1, 0], [3, 5, 1, 0], [0, 0, 0, 0]], np.uint8), length=np.array([3, 1, 2], np.int32),
        stroke=stroke, hurried=np.array([0, 0, 1, 0, 0, 0], np.uint8), waited=np.array([4, 1, 2, 4, 4, 8], np.int8),
    )  # fmt: skip


def test_rows_of_a_record() -> None:
    game = default_game()
    rallies = three_rallies(game)
    assert rallies.optional_columns == ("waited",)
    assert repr(rallies).startswith("Rallies(rallies=3, strokes=6, columns=['pairing', 'match', 'rally', 'policy'")
    assert rallies.striker.tolist() == [1, 0, 1, 0, 1, 0]
    assert rallies.position.tolist() == [0, 1, 2, 0, 0, 1]
    assert rallies.outcome(game.catalogue).tolist() == [RETURNED_BELOW, HURRIED_ABOVE, WINNER, FAULT, RETURNED_BELOW, FAULT]
    some = rallies.select(np.array([2, 0]))
    assert some.stroke.tolist() == rallies.stroke[[4, 5, 0, 1, 2]].tolist()
    assert (some.waited.tolist(), some.match.tolist()) == ([4, 8, 4, 1, 2], [3, 2])
    assert rallies.select(np.array([False, True, True])).stroke.tolist() == rallies.stroke[3:].tolist()
    middle = rallies.slice(1, 2)
    assert (middle.stroke.tolist(), middle.length.tolist(), middle.rally.tolist()) == (rallies.stroke[3:4].tolist(), [1], [8])
    joined = Rallies.concatenate([middle, dataclasses.replace(rallies, update=np.ones(3, np.uint32))])
    assert (joined.rally.tolist(), joined.length.tolist(), joined.update) == ([8, 7, 8, 0], [1, 3, 1, 2], None)
    row = rallies.row(0, game.catalogue, hands=("right", "left"))
    assert (row.server, row.ending, row.points, row.games, row.match, row.number) == (1, WINNER, (3, 4), (1, 0), 2, 7)
    assert (row.ends_changed, row.hands, row.stroke.tolist()) == (True, ("right", "left"), rallies.stroke[:3].tolist())
    assert row.hurried.tolist() == [False, False, True]
    assert row.waited.tolist() == [4, 1, 2]
    assert (rallies.row(2, game.catalogue).ends_changed, rallies.row(2, game.catalogue).stroke.tolist()) == (
        False,
        rallies.stroke[4:].tolist(),
    )
    assert dataclasses.replace(rallies, waited=None).row(0, game.catalogue).waited.tolist() == [-1] * 3


def test_illegal_strokes_of_a_record_have_no_rank() -> None:
    game = default_game()
    rallies = three_rallies(game)
    stroke = rallies.stroke.copy()
    stroke[1] = stroke[0]  # a serve within a rally, and a stroke after it
    state, k = dataclasses.replace(rallies, stroke=stroke).legal(game)
    assert (state[1:3].tolist(), k[1:3].tolist()) == ([-1, -1], [-1, -1])
    kept = [0, 3, 4, 5]
    assert (game.stroke_at(state[kept], k[kept]) == stroke[kept]).all()
    assert (state[kept] == rallies.states(game)[kept]).all()
    assert k[kept].min() >= 0


def test_strokes_of_large_catalogues_take_two_bytes() -> None:
    assert [stroke_dtype(n) for n in (255, 256, 257)] == [np.uint8, np.uint8, np.uint16]
