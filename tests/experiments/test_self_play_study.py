"""The experiment that compares variants of self-play, at a small size."""

import json
from pathlib import Path

import pytest

from experiments.self_play import main


@pytest.mark.slow
def test_a_study_is_resumed_with_more_variants_and_budgets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--seeds", "2", "--out", str(tmp_path / "study"), "--json"]
    assert main([*flags, "--variants", "plain", "--strokes", "20000"]) == 0
    first = json.loads(capsys.readouterr().out)["rows"]
    assert main([*flags, "--resume", "--variants", "plain", "pool", "--strokes", "20000", "40000"]) == 0
    result = json.loads(capsys.readouterr().out)
    asked = [(way, strokes) for way in ("plain", "pool") for strokes in (20_000, 40_000)]
    assert [(row["variant"], row["strokes"]) for row in result["rows"]] == asked
    assert [row["each"] for row in result["rows"][:1]] == [row["each"] for row in first]
    for row in result["rows"]:
        assert row["seeds"] == len(row["each"]) == 2
        assert 0 < row["exploitability_of_the_best"]["worst"] <= row["exploitability"]["worst"] == max(row["each"]) < 1
