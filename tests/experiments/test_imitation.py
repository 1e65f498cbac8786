"""The imitator: its inputs, independence of the future, determinism, and learning from a small sample."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from experiments import next_stroke
from experiments.imitation.imitator import Imitator, ImitatorConfig
from experiments.imitation.networks import NetworksConfig
from experiments.imitation.trees import TreesConfig
from shuttle_marl.data import load_strokes
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.game import model_folder

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
SMALL = ImitatorConfig(
    networks=NetworksConfig(members=2, epochs=8, batch=128, learning_rate=0.02, width=32, layers=2),
    trees=TreesConfig(type_rounds=15, area_rounds=5, leaves=7, rate=0.3),
)


@pytest.fixture(scope="module")
def strokes() -> pa.Table:
    return load_strokes(SAMPLE).slice(0, 1000)


@pytest.fixture(scope="module")
def imitator(strokes: pa.Table) -> Imitator:
    return Imitator.fit(strokes, config=SMALL)


def test_table_of_the_next_stroke(strokes: pa.Table, imitator: Imitator) -> None:
    part = strokes.slice(0, 300)
    result = json.loads(json.dumps(next_stroke.table(imitator, FittedModels.load(model_folder()), part)))
    assert list(result["rows"]) == ["all strokes", "rally strokes", "rally strokes, contact height not known"]
    for group in result["rows"].values():
        assert list(group) == ["imitator, match watched", "imitator", "own clone", "average clone"]
        for scores in group.values():
            for key in next_stroke.COLUMNS:
                assert len(scores[key]) == 4
                assert (np.diff(scores[key]) >= 0).all()
    alone, hidden = (result["rows"][name]["average clone"] for name in list(result["rows"])[1:])
    assert result["rows"]["all strokes"]["imitator"]["rows"] == len(part) > alone["rows"] == hidden["rows"]
    assert hidden["shot_type_cross_entropy"] > alone["shot_type_cross_entropy"], "the height tells something"
    lines = next_stroke.table_rows({**result, "paper": next_stroke.PAPER})
    assert len(lines) == 12 + 2 * len(result["players"]) + 2
    assert {len(line) for line in lines} == {len(next_stroke.HEADINGS)}
