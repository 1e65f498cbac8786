"""A small model with all refits, two imitated players in it, and the shipped sample."""

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


@pytest.fixture(scope="session")
def model() -> str:
    return reduced_model(tuple(str(k + 1) for k in range(REFITS)))


@pytest.fixture(scope="session")
def found(model: str) -> Refitted:
    return refitted(pair_game(A, B, game=model, discipline="men"))


@pytest.fixture(scope="session")
def sample() -> pa.Table:
    return load_strokes(SAMPLE)
