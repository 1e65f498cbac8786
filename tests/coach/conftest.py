"""A small model with all refits, two imitated players in it, and the shipped sample."""

from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa
import pytest

from shuttle_marl.analysis.advice import Refitted, refitted
from shuttle_marl.data import load_strokes
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.shipped import REFITS
from tests.reduced import reduced_model

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
A, B = "viktor-axelsen", "kento-momota"


def with_hand(strokes: pa.Table, hand_of: Mapping[str, int | None]) -> pa.Table:
    """Strokes of players of these hands."""
    place = strokes.schema.get_field_index("hand")
    hands = [hand_of[name] for name in strokes["player"].to_pylist()]
    return strokes.set_column(place, strokes.schema.field(place), pa.array(hands, pa.int8()))


@pytest.fixture(scope="session")
def model() -> str:
    return reduced_model(tuple(str(k + 1) for k in range(REFITS)))


@pytest.fixture(scope="session")
def found(model: str) -> Refitted:
    return refitted(pair_game(A, B, game=model, discipline="men"))


@pytest.fixture(scope="session")
def sample() -> pa.Table:
    return load_strokes(SAMPLE)
