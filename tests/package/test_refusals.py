"""Errors for invalid arguments, options and files, with their messages; others are tested beside the code that raises them."""

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.court.server import bind
from shuttle_marl.env.batched import RallyEnv
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import States
from shuttle_marl.policy import registry
from shuttle_marl.reports.rating import Rating


def test_an_option_that_is_nearly_one_is_named() -> None:
    with pytest.raises(TypeError, match="got an unexpected keyword argument 'bach'; did you mean batch"):
        RallyEnv(**cast("Any", {"bach": 4}))


def test_a_policy_of_the_history_needs_it() -> None:
    states = States(game=default_game(), state=np.zeros(1, np.int32))
    with pytest.raises(ValueError, match="states without history"):
        registry.resolve("bc:history", default_game()).probabilities(states)


BOUNDS: dict[str, tuple[Callable[[Any], Any], tuple[Any, ...], tuple[Any, ...]]] = {
    "deviation": (lambda value: Rating(deviation=value), (0.0, 1000.0), (-0.1, 1000.5)),
    "volatility": (lambda value: Rating(volatility=value), (1e-9, 1.0), (0.0, 1.01)),
    "points of a rating": (lambda value: Rating(points=value), (-1e9, 1e9), (math.nan, math.inf)),
    "quality": (lambda value: Rating().after([value]), (0.0, 1.0), (-0.01, 1.01)),
    "port": (lambda value: bind("127.0.0.1", value).close(), (0,), (-1, 1 << 16)),
}
"""For each number: what takes it, the least and the greatest that is accepted, and what is refused beside them."""


@pytest.mark.parametrize("name", BOUNDS)
def test_numbers_are_accepted_up_to_their_bounds(name: str) -> None:
    act, accepted, refused = BOUNDS[name]
    for value in accepted:
        act(value)
    for value in refused:
        with pytest.raises(ShuttleError, match="expected"):
            act(value)
