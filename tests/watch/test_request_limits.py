"""Bounds of what pages may send: the least and the greatest that is accepted, and what is refused beside them."""

import json
from typing import Any

import msgspec
import pytest

from shuttle_marl.court import WatchError, messages
from shuttle_marl.court.messages import decode_request
from shuttle_marl.court.plan import Change, Person, Plan, Side
from shuttle_marl.game.scoring import BWF, Rules

BC = {"policy": "bc"}
PLAN: dict[str, Any] = {"seed": 1, "sides": [BC, {"policy": "random"}]}
RALLY: dict[str, Any] = {"id": 3, "op": "rally", "plan": PLAN, "rally": 0}
STROKE = {"shot": 0, "technique": 0, "height": 0, "area": None}
ROW: dict[str, Any] = {
    **STROKE, "match": "Final", "discipline": "MS", "rules": "21", "game": 1, "rally": 1, "stroke": 1, "player": "Ada",
    "opponent": "Bea",
    "hand": None, "landing_x": None, "landing_y": None, "contact_x": None, "contact_y": None, "seconds": 0.0, "frame": 0,
    "ending": None, "winner": None, "points": None, "points_opponent": None,
}  # fmt: skip
TAG: dict[str, Any] = {"id": 1, "op": "tag", "at": 0, "input": None, "first": 0, "rows": []}
RATING: dict[str, Any] = {"id": 1, "op": "rating", "points": 1500, "deviation": 350, "volatility": 0.06, "scores": [0.5]}
PERSON: dict[str, Any] = {"seat": 0, "rally": 0, "stroke": 0}


def plan(**changes: Any) -> dict[str, Any]:
    return {**RALLY, "plan": {**PLAN, **changes}}


def row(name: str, value: Any) -> dict[str, Any]:
    return {**TAG, "rows": [{**ROW, name: value}]}


LIMITS: dict[str, tuple[Any, tuple[Any, ...], tuple[Any, ...]]] = {
    "rally of a log": (lambda value: {**RALLY, "plan": None, "rally": value}, (0, 1000, (1 << 40) - 1), (-1, 1 << 40)),
    "rally of a plan": (lambda value: {**RALLY, **value}, ({},), ({"rally": -1}, {"op": "run"}, {"more": 1})),
    "player": (lambda value: {**RALLY, "person": {**PERSON, **value}}, ({"seat": 1},), ({"seat": 2}, {"rally": -1})),
    "sides": (lambda value: plan(sides=[BC] * value), (2,), (1, 3)),
    "changes": (lambda value: plan(changes=[{"rally": 1, "seat": 0, "side": BC}] * value), (0, 200), (201,)),
    "choices": (
        lambda value: plan(chosen={"0": {str(k): 0 for k in range(19_990)}}, waited={"1": {str(k): 0 for k in range(value)}}),
        (10,),
        (11,),
    ),
    "token": (
        lambda value: {"id": 1, "op": "friend", "token": value},
        ("a", "aZ_-09", "x" * 64, None),
        ("", "x" * 65, "a/b", "a b"),
    ),
    "key": (lambda value: {**RALLY, "friend": {"token": "a", "key": value}}, ("a", "x" * 64), ("", "x" * 65, "ä", "a\n")),
    "scores": (lambda value: {**RATING, "scores": [1] * value}, (0, 20_000), (20_001,)),
    "input": (lambda value: {**TAG, "input": "x" * value}, (0, 1000), (1001,)),
    "rows": (lambda value: {**TAG, "rows": [ROW] * value}, (0, 400), (401,)),
    "hash of inputs": (lambda value: {**TAG, "after": "x" * value}, (0, 64), (65,)),
    "place": (lambda value: row("landing_x", value), (-30, 30, None), (-30.1, 30.1)),
    "name": (
        lambda value: row("player", value),
        ("A", "x" * 100, "0-1"),
        ("", "x" * 101, "=1", "+1", "-1", "@a", " a", "a\nb", "a\u200b"),
    ),
    "discipline": (lambda value: row("discipline", value), ("MS", "WS"), ("XD", "")),
    "rules": (lambda value: row("rules", value), ("21", "15x5"), ("16", "")),
    "strokes of a line": (lambda value: {"id": 1, "op": "suggest", "line": [STROKE] * value}, (0, 300), (301,)),
}  # fmt: skip
"""For each field: the request with a value, the values that are accepted, and those that are refused."""


@pytest.mark.parametrize("name", LIMITS)
def test_requests_are_accepted_up_to_their_bounds(name: str) -> None:
    request, accepted, refused = LIMITS[name]
    for value in accepted:
        assert isinstance(decode_request(json.dumps(request(value))), messages.Request)
    for value in refused:
        with pytest.raises(WatchError, match="is not understood"):
            decode_request(json.dumps(request(value)))


SIDES = tuple(Side(policy=name) for name in "abcdef")
PAIR = SIDES[0], SIDES[1]


def test_the_players_of_a_rally_are_those_who_came_last() -> None:
    comes = [(5, 0, 3), (2, 1, 2), (5, 1, 4), (0, 0, 5)]
    changes = tuple(Change(rally=rally, seat=seat, side=SIDES[k]) for rally, seat, k in comes)
    found = Plan(seed=1, sides=PAIR, changes=changes)
    names = ["".join(side.policy for side in found.sides_in(rally)) for rally in (0, 1, 2, 4, 5, 9)]
    assert names == ["fb", "fb", "fc", "fc", "de", "de"]


def test_equal_plans_have_equal_keys_whatever_the_order_of_their_choices() -> None:
    one = Plan(seed=1, sides=PAIR, chosen={1: {3: 5, 2: 4}, 0: {7: 8}}, waited={4: {1: 2, 0: 3}})
    two = Plan(seed=1, sides=PAIR, chosen={0: {7: 8}, 1: {2: 4, 3: 5}}, waited={4: {0: 3, 1: 2}})
    assert one.key == two.key
    assert list(one.chosen_in(1)) == [2, 3]
    assert list(one.waited_in(4)) == [0, 1]
    assert (one.chosen_in(4), one.waited_in(1)) == ({}, {})
    others: list[dict[str, Any]] = [{"seed": 2}, {"chosen": {}}, {"waited": {}}, {"points": 7}]
    changed = [msgspec.structs.replace(one, **fields) for fields in others]
    assert len({one.key, *(each.key for each in changed)}) == 5


def test_a_duel_is_one_game_to_its_points() -> None:
    assert Plan(seed=1, sides=PAIR).rules == BWF
    assert Plan(seed=1, sides=PAIR, points=7).rules == Rules(points=7, clear=1, cap=7, games=1)


@pytest.mark.parametrize("friend", [False, True])
def test_a_person_chooses_for_their_seat_from_a_stroke_on(friend: bool) -> None:
    person = Person(seat=1, rally=3, stroke=4, friend=friend)
    moments = [(2, 9), (3, 3), (3, 4), (4, 0)]
    assert [person.chooses(*at, 1) for at in moments] == [False, False, True, True]
    assert [person.chooses(*at, 0) for at in moments] == [False, False, friend, friend]
