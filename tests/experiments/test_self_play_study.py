"""The experiment that compares ways of self-play, at a small size."""

import json
from pathlib import Path

import pytest

from experiments.self_play import main


@pytest.mark.slow
def test_a_quick_study_trains_the_last_budget_only_where_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--seeds", "2", "--ways", "plain", "pool", "--strokes", "20000", "40000", "--out", str(tmp_path / "study"), "--json"]
    assert main(flags) == 0
    result = json.loads(capsys.readouterr().out)
    assert [(row["variant"], row["strokes"]) for row in result["rows"]] == [
        ("plain", 20_000), ("plain", 40_000), ("pool", 20_000),
    ]  # fmt: skip
    for row in result["rows"]:
        assert row["seeds"] == len(row["each"]) == 2
        assert 0 < row["exploitability_of_the_best"]["worst"] <= row["exploitability"]["worst"] == max(row["each"]) < 1


def test_a_study_of_one_seed_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--seeds", "1"]) == 1
    assert "2 seeds" in capsys.readouterr().err
