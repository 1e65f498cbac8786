"""Fits to matches of one's own: splits by share, and the least that is needed."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import data, dynamics, league
from shuttle_marl.data.upstream import matches_of
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.dynamics.make import MIN_STROKES, require_enough, train_and_validation
from shuttle_marl.game.shipped import load_game, read_model_card, variants
from shuttle_marl.policy import registry
from tests.data.club_matches import strokes_of_club, write_club


@pytest.fixture(scope="module")
def club() -> Rows:
    return rows_from_strokes(strokes_of_club(5, seed=1))


def matches(rows: Rows) -> set[str]:
    return {rows.matches[i] for i in np.unique(rows.match)}


def renamed(rows: Rows, *names: str) -> Rows:
    """The same strokes under other names for the first matches."""
    return dataclasses.replace(rows, matches=(*names, *rows.matches[len(names) :]))


@pytest.mark.parametrize(("share", "aside"), [(0.2, 1), (0.21, 2), (0.4, 2), (0.01, 1), (0.99, 4)])
def test_a_share_of_the_matches_is_set_aside(club: Rows, share: float, aside: int) -> None:
    train, validation = train_and_validation(club, share)
    assert len(matches(validation)) == aside
    assert matches(train) == set(club.matches) - matches(validation)
    # The order of the rows and other matches change nothing about which come first.
    turned = club.take(np.argsort(-club.match, kind="stable"))
    assert matches(train_and_validation(turned, share)[1]) == matches(validation)


def test_published_matches_keep_their_split(club: Rows) -> None:
    published = {split: matches_of(split)[0] for split in ("train", "validation", "test")}
    train, validation = train_and_validation(renamed(club, *published.values()), 0.5)
    own = set(club.matches[3:])
    assert matches(train) - own == {published["train"]}
    assert matches(validation) - own == {published["validation"]}
    assert len(matches(train) & own) == len(matches(validation) & own) == 1


@pytest.mark.parametrize(
    ("share", "says"), [(None, "--validation-share 0.2 takes a fifth"), (0.0, "between 0 and 1"), (1.0, "between")]
)
def test_a_share_is_needed_for_own_matches(club: Rows, share: float | None, says: str) -> None:
    with pytest.raises(ShuttleError, match=says):
        train_and_validation(club, share)


def test_a_share_without_own_matches(club: Rows) -> None:
    published = renamed(club, *matches_of("train")[:5])
    with pytest.raises(ShuttleError, match="all matches are published"):
        train_and_validation(published, 0.2)
    with pytest.raises(ShuttleError, match="no match of the split 'validation'"):
        train_and_validation(published, None)


def test_too_few_strokes_are_refused_with_the_reason(club: Rows) -> None:
    train, validation = train_and_validation(club, 0.2)
    few = train.take(np.arange(len(train)) % (len(train) // 200) == 0)
    with pytest.raises(
        ShuttleError, match=rf"{len(few)} strokes in 4 train matches, at least {MIN_STROKES} needed: .* 117 kinds"
    ):
        require_enough(few, validation)
    require_enough(train, validation)


@pytest.mark.slow
def test_from_a_file_to_the_league(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, columns = write_club(tmp_path, strokes_of_club(4))
    table, model = tmp_path / "club.parquet", tmp_path / "model"
    assert data.main(["import", str(file), "--columns", str(columns), "--out", str(table)]) == 0
    assert data.main(["validate", str(table)]) == 0
    flags = ["--data", str(table), "--out", str(model)]
    assert dynamics.main(["fit", *flags]) == 1
    assert "--validation-share 0.2" in capsys.readouterr().err
    assert dynamics.main(["fit", *flags, "--validation-share", "0.2"]) == 0
    assert dynamics.main(["fit", *flags, "--validation-share", "0.2"]) == 1
    assert "already exists" in capsys.readouterr().err
    card = read_model_card(model)
    assert card["data"]["sources"] == ["our club"]
    assert variants(str(model)) == card["variants"] == []
    assert dynamics.main(["card", "--model", str(model)]) == 0
    printed = capsys.readouterr().out
    for name in ("largest shot share", "shot types above 2 percent", "minimax mean rally", "minimax thin"):
        assert f"{name}: " in printed
    assert dynamics.main(["evaluate", "--data", str(table), "--model", str(model), "--json"]) == 0
    game = load_game(str(model))
    assert not any("axelsen" in name for name in registry.names(game))
    assert league.main(["--game", str(model), "--matches", "2", "--out", str(tmp_path / "run")]) == 0
