"""Tables with indices out of range are refused: compiled code reads them without bounds checks."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from shuttle_marl.base.errors import OptionError, ShuttleError
from shuttle_marl.game import UniformPolicy, default_game, tabulate
from shuttle_marl.game.draws import stream
from shuttle_marl.game.stroke import Catalogue, UnknownStrokeError
from shuttle_marl.game.tables import GameError
from tests.rally.test_rally_layout import random_game

GAME, _ = random_game(5)


def with_last(name: str, value: int) -> np.ndarray:
    table = getattr(GAME, name).copy()
    table.flat[-1] = value
    return table


@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("edge_own", with_last("edge_own", GAME.n_strokes + 1)),
        ("edge_incoming", with_last("edge_incoming", -1)),
        ("reply_start", with_last("reply_start", 1 << 30)),
        ("reply_start", GAME.reply_start - 1),
        ("reply_count", with_last("reply_count", 1 << 30)),
        ("reply_edge", with_last("reply_edge", 1 << 30)),
        ("reply_edge", GAME.reply_edge[:-1]),
        ("edge_duel", with_last("edge_duel", 3 - int(GAME.edge_duel[-1]))),
        ("fault_odds", with_last("fault_odds", 0)),
        ("fault_odds", GAME.fault_odds + 1),
        ("hurry", GAME.hurry[:-1]),
        ("hurry", GAME.hurry[:, :1]),
        ("hurry", GAME.hurry.astype(np.uint16)),
        ("threshold", GAME.threshold[:, :2]),
        ("threshold", GAME.threshold.astype(np.int32)),
        ("threshold", GAME.threshold.tolist()),
        ("edge_own", GAME.edge_own.astype(np.int64)),
        ("edge_own", GAME.edge_own.astype(float)),
        ("reply_start", GAME.reply_start.ravel()),
    ],
)
def test_tables_that_do_not_fit_are_refused(name: str, table: Any) -> None:
    with pytest.raises(GameError, match=name.split("_", maxsplit=1)[0]):
        dataclasses.replace(GAME, **{name: table})


def test_probabilities_of_fewer_pairs_than_are_legal_are_refused() -> None:
    with pytest.raises(GameError, match="threshold does not count the legal strokes"):
        dataclasses.replace(GAME, threshold=GAME.threshold[:-1], hurry=GAME.hurry[:-1])


@pytest.mark.parametrize("seed", [1.5, "1", None, np.float64(3)])
def test_a_seed_is_a_whole_number(seed: Any) -> None:
    with pytest.raises(OptionError, match=r"seed .*: expected a whole number"):
        stream(seed)
    three: Any = np.int64(3)
    assert (stream(three) == stream(3)).all()


def test_an_unknown_stroke_is_a_shuttle_error() -> None:
    assert issubclass(UnknownStrokeError, ShuttleError)
    with pytest.raises(ShuttleError, match="unknown shot type"):
        Catalogue.from_names(["slice:front-left:below:forehand"])


def test_short_texts_of_objects_that_hold_tables() -> None:
    game = default_game()
    expected = (
        f"Game(hash='{game.hash[:12]}', n_strokes={game.n_strokes}, n_states={game.n_states}, n_pairs={game.n_pairs}, levels=2)"
    )
    assert str(game) == repr(game) == expected
    assert repr(tabulate(UniformPolicy(), GAME)).startswith("TabulatedPolicy(hash='")
    assert repr(game.catalogue) == f"Catalogue(version='{game.catalogue.version}', n_strokes={game.n_strokes})"
