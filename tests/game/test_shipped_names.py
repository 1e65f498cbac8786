"""Names of models and variants, drawn games, and the real strokes behind a stroke."""

import dataclasses
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.game import shipped
from shuttle_marl.game.layout import GameError
from shuttle_marl.game.shipped import (
    Estimate,
    default_game,
    hands_of_variant,
    is_refit,
    is_shipped,
    least_support,
    load_positions,
    origin_named,
    origin_of,
    supported,
    variant_of,
)
from tests.exact.exact_games import tiring_game
from tests.reduced import reduced_game, reduced_model

GAME = tiring_game()


@pytest.mark.parametrize(
    ("name", "opposite", "variant"),
    [
        (None, False, None),
        (None, True, "opposite"),
        ("men", False, "men"),
        ("men", True, "men-opposite"),
        ("3", True, "3-opposite"),
    ],
)
def test_variants_are_named_by_discipline_or_refit_and_hands(name: str | None, opposite: bool, variant: str | None) -> None:
    assert variant_of(name, opposite=opposite) == variant
    assert hands_of_variant(variant) == (name, opposite)


def test_refits_are_numbers() -> None:
    assert [is_refit(name) for name in ("1", "12", "men", "1-opposite", "")] == [True, True, False, False, False]


@pytest.mark.skipif(sys.platform == "win32", reason="needs a folder with a colon in its name")
def test_models_are_named_by_folder_or_by_name(tmp_path: Path) -> None:
    folder = tmp_path / "with:colon"
    folder.mkdir()
    (folder / shipped.GAME).write_bytes(b"")
    for name, expected in (
        (str(folder), (folder, None, False)),
        (f"{folder}:men", (folder, "men", False)),
        (f"{folder}:recovery", (folder, None, True)),
        (f"{folder}:men-recovery", (folder, "men", True)),
        (f"{folder}:men-opposite-recovery", (folder, "men-opposite", True)),
    ):
        assert tuple(origin_named(name)) == expected
    for wrong in ("nothing", "", ":men", f"{tmp_path}"):
        with pytest.raises(GameError, match=rf"no model {wrong!r}: neither shipped \(there: .*default.*\) nor a folder with"):
            origin_named(wrong)
    assert [is_shipped(name) for name in ("default", "nothing", str(folder))] == [True, False, False]
    with pytest.raises(GameError, match="a model without positions of receivers; fit it to strokes that have them"):
        load_positions(folder)
    shutil.copy(Path(reduced_model()) / shipped.CARD, folder)
    (folder / shipped.POSITIONS).write_bytes(b"damaged")
    with pytest.raises(GameError, match="no readable positions"):
        load_positions(folder)


def test_estimates_may_be_turned_round() -> None:
    assert Estimate(0.5, 0.25, 1.0).scaled(-2.0) == (-1.0, -2.0, -0.5)
    assert Estimate(0.5, 0.25, 1.0).scaled(2.0) == (1.0, 0.5, 2.0)


def test_supported_strokes_are_frequent_or_the_most_frequent_of_their_state() -> None:
    assert supported(GAME, 0).all()
    with pytest.raises(GameError, match="the number of real strokes is not known for this game"):
        supported(GAME, 1)
    game, real = reduced_game(), shipped.real_strokes(reduced_game())
    assert real is not None
    found = supported(game, 20)
    for state in range(0, game.n_base_states, 7):
        pairs = range(int(game.base_pair_start[state]), int(game.base_pair_start[state + 1]))
        behind = [real[game.base_pair_edge[pair]] for pair in pairs]
        assert found[list(pairs)].tolist() == [number >= 20 or number == max(behind) for number in behind]


def test_advice_needs_twenty_real_strokes_in_models_of_own_data() -> None:
    assert [least_support(game) for game in (GAME, default_game(), reduced_game())] == [0, 0, 20]


def test_copies_of_a_game_with_other_tables_come_from_no_model() -> None:
    assert origin_of(GAME) is None
    assert shipped.folder_of(GAME) is None
    changed = dataclasses.replace(reduced_game(), hurry=np.zeros_like(reduced_game().hurry))
    assert origin_of(changed) is None
    assert shipped.folder_of(reduced_game()) == Path(reduced_model())
    assert shipped.refits_of(GAME) == ()
    assert shipped.factor_of(GAME) is None
    assert shipped.real_strokes(GAME) is None
