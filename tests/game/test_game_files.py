"""Saving and loading a game; damaged files, and tables with indices out of range, are refused."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from shuttle_marl.base.errors import OptionError, ShuttleError
from shuttle_marl.game import default_game, model_folder
from shuttle_marl.game.draws import stream
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.stroke import Catalogue, UnknownStrokeError
from shuttle_marl.game.tables import Game
from tests.game.test_rally_layout import random_game
from tests.reduced import reduced_game


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A saved game; the shipped one takes seconds to pack."""
    path = tmp_path_factory.mktemp("saved") / "new folder" / "game.safetensors"
    reduced_game().save(path, {"note": "for tests"})
    return path.read_bytes()


@pytest.fixture
def saved(tmp_path: Path, content: bytes) -> Path:
    path = tmp_path / "game.safetensors"
    path.write_bytes(content)
    return path


def test_a_game_survives_saving(saved: Path) -> None:
    game, again = reduced_game(), Game.load(saved)
    assert again.hash == game.hash
    assert again.catalogue.names == game.catalogue.names
    for field in dataclasses.fields(Game):
        before, after = getattr(game, field.name), getattr(again, field.name)
        if isinstance(before, np.ndarray):
            assert before.dtype == after.dtype
            assert (before == after).all()


@pytest.mark.parametrize("name", ["threshold", "hurry", "edge_own", "reply_start", "reply_edge"])
def test_the_hash_covers_every_table(name: str) -> None:
    game = default_game()
    table = getattr(game, name).copy()
    table.flat[-1] ^= 1
    changed = object.__new__(Game)
    fields = {field.name: getattr(game, field.name) for field in dataclasses.fields(Game)}
    changed.__dict__.update({**fields, name: table})  # some such games cannot be made
    assert changed.hash != game.hash


def test_the_hash_covers_the_names() -> None:
    game = default_game()
    names = list(game.catalogue.names)
    i, j = np.flatnonzero(game.catalogue.height == game.catalogue.height[-1])[-2:]
    names[i], names[j] = names[j], names[i]
    renamed = dataclasses.replace(game, catalogue=type(game.catalogue).from_names(names))
    assert renamed.hash != game.hash


def test_a_flipped_bit_is_found(saved: Path) -> None:
    content = bytearray(saved.read_bytes())
    content[-5] ^= 4
    saved.write_bytes(content)
    with pytest.raises(GameError, match="install the model again"):
        Game.load(saved)


def test_a_file_cut_short_is_found(saved: Path) -> None:
    saved.write_bytes(saved.read_bytes()[:500])
    with pytest.raises(GameError, match=r"game\.safetensors"):
        Game.load(saved)


@pytest.mark.parametrize(
    "header", [None, {"strokes": "no list"}, {"strokes": '["smash:moon:above:forehand"]'}, {"strokes": "[]"}]
)
def test_other_safetensors_are_no_game(tmp_path: Path, header: dict[str, str] | None) -> None:
    path = tmp_path / "other.safetensors"
    save_file({"threshold": np.zeros((1, 3), np.uint16)}, path, metadata=header)
    with pytest.raises(GameError, match="no readable game tables"):
        Game.load(path)


def test_models_are_found_by_name_and_by_folder(saved: Path) -> None:
    assert model_folder("default").is_dir()
    assert model_folder(str(saved.parent)) == saved.parent
    with pytest.raises(GameError, match=r"no model 'typo'.*shipped"):
        model_folder("typo")


GAME, _ = random_game(5)


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
