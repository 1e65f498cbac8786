"""Validation of rallies, and the columns of rally records."""

from typing import Any

import numpy as np
import pytest

from shuttle_marl.game import default_game
from shuttle_marl.game.rally.record import OPTIONAL, Rally, RallyError, columns_of
from shuttle_marl.game.rules import WINNER
from shuttle_marl.game.shipped import load_game


def test_wrong_rallies() -> None:
    catalogue = default_game().catalogue
    serve = int(np.flatnonzero(catalogue.is_serve)[0])
    reply = int(np.flatnonzero(~catalogue.is_serve)[0])

    def checked(**changes: object) -> None:
        fields: dict[str, Any] = {"catalogue": catalogue, "server": 0, "stroke": np.array([serve]), "ending": WINNER, **changes}
        Rally(**{"hurried": np.zeros(np.shape(fields["stroke"]), np.bool_), **fields}).checked()

    checked()
    for changes, message in (
        ({"stroke": np.array([], dtype=np.int64)}, "without strokes"),
        ({"stroke": np.array([reply])}, "starts with a serve"),
        ({"stroke": np.array([serve, serve])}, "starts with a serve"),
        ({"stroke": np.array([len(catalogue)])}, "the catalogue has"),
        ({"server": 2}, "expected seat 0 or 1"),
        ({"ending": 6}, "expected 0 to 5"),
        ({"hurried": np.array([True])}, "none for the serve"),
    ):
        with pytest.raises(RallyError, match=message):
            checked(**changes)
    with pytest.raises(RallyError, match="take turns"):
        Rally.from_strokes(catalogue, [(0, serve, 2), (0, reply, 1)])
    wrong = 3 - int(catalogue.height[reply])
    with pytest.raises(RallyError, match="heights of the strokes"):
        Rally.from_strokes(catalogue, [(0, serve, wrong), (1, reply, WINNER)])


def test_columns_are_those_that_are_asked_for_and_positions_with_recovery() -> None:
    asked = ("value", "update")
    assert columns_of(default_game(), *asked) == ("update", "value")
    assert columns_of(load_game("default:recovery"), *asked) == ("update", "waited", "value")
    assert columns_of(load_game("default:recovery"), *OPTIONAL) == OPTIONAL
    assert columns_of(default_game()) == ()
