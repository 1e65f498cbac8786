"""The experiments on the annotated matches (where SHUTTLESET names their folder), and what they say without."""

import json
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from experiments import next_stroke, realism, same_results
from experiments.imitation.imitator import Imitator, ImitatorConfig
from experiments.imitation.networks import NetworksConfig
from experiments.imitation.trees import TreesConfig
from shuttle_marl.data import load_strokes
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.game import model_folder

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
MATCHES = os.environ.get("SHUTTLESET")
needs_matches = pytest.mark.skipif(not MATCHES, reason="SHUTTLESET names no folder with the annotated matches")


@pytest.mark.parametrize("command", [next_stroke.main, realism.main])
def test_data_without_the_split_is_named(command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(["--data", str(SAMPLE)]) == 1
    assert "no match of the split" in capsys.readouterr().err


@needs_matches
def test_play_is_realistic(capsys: pytest.CaptureFixture[str]) -> None:
    assert realism.main(["--data", str(MATCHES), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["mean rally"]["simulated"] == pytest.approx(figures["mean rally"]["value"], rel=0.05)
    assert figures["fault share"]["simulated"] == pytest.approx(figures["fault share"]["value"], abs=0.02)


ROOT = Path(__file__).parents[2]


def test_a_checkout_equals_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same_results.main(ROOT, ROOT, out=tmp_path / "out", only=("solve",))
    assert "the same: 1 commands, 1 files" in capsys.readouterr().out
    assert "value" in (tmp_path / "out" / "before" / "solve" / "printed.txt").read_text(encoding="utf-8")


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
