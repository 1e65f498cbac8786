"""Errors for invalid arguments, options and files, with their messages; others are tested beside the code that raises them."""

import importlib.util
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from shuttle_marl.analysis.decisions import Rating, rated
from shuttle_marl.base.errors import ShuttleError, seed_number
from shuttle_marl.base.programs import Program, ProgramError
from shuttle_marl.commands import suite
from shuttle_marl.env.batched import RallyEnv
from shuttle_marl.exact import restricted_response
from shuttle_marl.exact.meta_games import alpha_rank
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import States, TemperedPolicy
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy import registry
from shuttle_marl.suite.registry import write_data
from shuttle_marl.watch.server import bind, check_video
from tests.reduced import reduced_game

GAME = reduced_game()
REFUSED = (ShuttleError, TypeError, ValueError)


def a_dead_program(_: Path) -> None:
    program = Program([sys.executable, "-c", ""], 30.0)
    program.write(b"{}\n")
    with pytest.raises(ProgramError, match="exited"):
        program.read_line()
    program.write(b"{}\n")


def states_without_history(_: Path) -> None:
    registry.resolve("bc:history", default_game()).probabilities(States(game=default_game(), state=np.zeros(1, np.int32)))


REFUSALS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "option": (lambda _: RallyEnv(**cast("Any", {"bach": 4})), r"got an unexpected keyword argument 'bach'; did you mean batch"),
    "program": (a_dead_program, "it is not asked again"),
    "board": (lambda _: suite.board(()), "nothing to show: name run folders"),
    "history": (states_without_history, "states without history"),
    "key": (lambda _: registry.register("bc", lambda *_: None), "'bc' is registered already; choose another"),
    "data": (lambda folder: write_data("exploit-v0", folder, "dev", "default", None), "exploit-v0 has no data; offline-v0"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_what_is_refused_is_said(name: str, tmp_path: Path) -> None:
    act, says = REFUSALS[name]
    with pytest.raises(REFUSED, match=says):
        act(tmp_path)


def of_alpha_rank(**options: float) -> None:
    alpha_rank([[0.5, 0.6], [0.4, 0.5]], **cast("Any", options))


BOUNDS: dict[str, tuple[Callable[[Any], Any], tuple[Any, ...], tuple[Any, ...]]] = {
    "seed": (seed_number, (0, (1 << 64) - 1), (-1, 1 << 64)),
    "deviation": (lambda value: Rating(deviation=value), (0.0, 1000.0), (-0.1, 1000.5)),
    "volatility": (lambda value: Rating(volatility=value), (1e-9, 1.0), (0.0, 1.01)),
    "points of a rating": (lambda value: Rating(points=value), (-1e9, 1e9), (math.nan, math.inf)),
    "quality": (lambda value: rated(Rating(), [value]), (0.0, 1.0), (-0.01, 1.01)),
    "points of a game": (lambda value: Rules(points=value), (2, 30), (1, 31)),
    "lead": (lambda value: Rules(clear=value), (1, 21), (0, 22)),
    "cap": (lambda value: Rules(cap=value), (21, 127), (20, 128)),
    "games": (lambda value: Rules(games=value), (1, 63), (0, 64)),
    "temperature": (
        lambda value: TemperedPolicy(base=registry.resolve("bc", GAME), temperature=value),
        (0.0, 1e9),
        (-0.01, math.inf),
    ),
    "alpha": (lambda value: of_alpha_rank(alpha=value), (1e-9, math.inf), (0.0, -1.0)),
    "population": (lambda value: of_alpha_rank(population=value), (2, 50), (1, 0)),
    "noise": (lambda value: of_alpha_rank(noise=value, alpha=math.inf), (1e-9, 0.99), (0.0, 1.0)),
    "share": (lambda value: restricted_response(tabulate(registry.resolve("bc", GAME), GAME), value), (0.0, 1.0), (-0.01, 1.01)),
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


def test_a_video_needs_its_libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "av" else object())
    with pytest.raises(REFUSED, match=r"--video needs av: "):
        check_video(tmp_path / "a.mp4")
    with pytest.raises(REFUSED, match=r"expected a name that ends in \.mp4 or \.webm"):
        check_video(tmp_path / "a.avi")
