"""The experiment that compares variants of league training, at a small size."""

import json
from pathlib import Path

import pytest

from experiments.league_training import HEADINGS, main, table_rows
from tests.reduced import reduced_model


@pytest.mark.slow
def test_a_quick_study_is_resumed_and_says_what_it_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, saved = tmp_path / "study", tmp_path / "results.json"
    flags = ["--quick", "--variants", "plain", "psro-exact", "--game", reduced_model(), "--out", str(out), "--json", str(saved)]
    assert main(flags) == 0
    printed = capsys.readouterr().out
    result = json.loads(saved.read_text())
    assert [row["variant"] for row in result["rows"]] == ["plain", "psro-exact"]
    assert [row["seeds"] for row in result["rows"]] == [2, 1]
    for row, cells in zip(result["rows"], table_rows(result), strict=True):
        assert len(cells) == len(HEADINGS)
        assert row["variant"] in printed
        assert 0 < row["exploitability"]["mean"] < 1
        assert row["over_time"]["1.0"] == pytest.approx(row["exploitability"]["mean"])
    runs = sorted(path.name for path in (out / "training").iterdir())
    assert runs == ["plain-0", "plain-1", "psro-exact-0"]
    assert main([*flags, "--resume"]) == 0
    assert json.loads(saved.read_text())["rows"] == result["rows"]
