"""The experiments on the annotated matches (where SHUTTLESET names their folder), and what they say without."""

import json
import os
from pathlib import Path

import pytest

from experiments import next_stroke, realism

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
