"""Names of models and variants, drawn games, and the real strokes behind a stroke."""

import dataclasses
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game import shipped
from shuttle_marl.game.shipped import (
    Estimate,
    default_game,
    drawn_game,
    hands_of_variant,
    is_refit,
    is_shipped,
    least_support,
    load_positions,
    origin_named,
    origin_of,
    resolve_game,
    supported,
    variant_of,
)
from shuttle_marl.game.tables import GameError
from shuttle_marl.game.thresholds import ONE
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


def test_profiles_are_of_games_of_a_model() -> None:
    with pytest.raises(GameError, match="profile 'men': expected the game of a model"):
        resolve_game(GAME, "men")
    assert resolve_game(GAME) is GAME
    men = resolve_game(reduced_model(), "men")
    assert origin_of(men) == (Path(reduced_model()), "men", False)
    assert resolve_game(reduced_game(), "men").hash == men.hash
    assert resolve_game(men, "men") is men
    with pytest.raises(GameError, match="profile 'women': expected the game of a model"):
        resolve_game(men, "women")


def test_estimates_may_be_turned_round() -> None:
    assert Estimate(0.5, 0.25, 1.0).scaled(-2.0) == (-1.0, -2.0, -0.5)
    assert Estimate(0.5, 0.25, 1.0).scaled(2.0) == (1.0, 0.5, 2.0)


class Normals:
    """Standard normal numbers that are all alike."""

    def __init__(self, *values: float) -> None:
        self.values = list(values)
        self.sizes: list[Any] = []

    def normal(self, size: tuple[int, ...]) -> np.ndarray:
        self.sizes.append(size)
        return np.full(size, self.values.pop(0))


def test_drawn_games_multiply_probabilities_of_outcomes() -> None:
    class Faults(Normals):
        def normal(self, size: tuple[int, ...]) -> np.ndarray:
            numbers = super().normal(size)
            numbers[..., 1:] = 0  # the log-probability of a fault alone is shifted
            return numbers

    rng: Any = Faults(1.0, 1.0)
    before, after = GAME.threshold[0] / ONE, drawn_game(GAME, rng, 0.5).threshold[0] / ONE
    # Both shifts of a fault are 1, so its weight is multiplied by e^(0.5 * 2 / sqrt 2).
    factor = np.exp(0.5 * np.sqrt(2))
    total = factor * before[0] + 1 - before[0]
    assert after[0] == pytest.approx(factor * before[0] / total, abs=1 / ONE)
    assert 1 - after[1] == pytest.approx((1 - before[1]) / total, abs=1 / ONE)


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
