"""The simulated sample of the repository, and the script that draws it."""

import json
import runpy
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from shuttle_marl.commands.data import main
from shuttle_marl.data import load_account, load_strokes

DATASETS = Path(__file__).parents[2] / "datasets"
SAMPLE = DATASETS / "sample" / "strokes.parquet"
SCRIPT = runpy.run_path(str(DATASETS / "make_sample.py"))


def test_the_sample_is_sound(capsys: pytest.CaptureFixture[str]) -> None:
    assert SAMPLE.stat().st_size < 1_000_000
    assert main(["validate", str(SAMPLE)]) == 0
    assert main(["summary", str(SAMPLE), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["strokes"]["kept"] == load_strokes(SAMPLE).num_rows > 3000
    assert summary["area_agreement"] is None
    assert set(load_strokes(SAMPLE)["source"].to_pylist()) == {"simulated"}


def test_the_card_tells_of_this_sample() -> None:
    provenance = json.loads(pq.read_schema(SAMPLE).metadata[b"shuttle_marl.provenance"])
    text = SCRIPT["card"](load_strokes(SAMPLE), load_account(SAMPLE), provenance, size=SAMPLE.stat().st_size)
    assert (SAMPLE.parent / "CARD.md").read_text(encoding="utf-8") == text


def test_a_small_one_can_be_drawn_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one", "again"):
        SCRIPT["make_sample"](players=("random", "safe"), matches=1, seed=3, out=tmp_path / name / "strokes.parquet")
    assert (tmp_path / "one/strokes.parquet").read_bytes() == (tmp_path / "again/strokes.parquet").read_bytes()
    assert main(["validate", str(tmp_path / "one/strokes.parquet")]) == 0
    assert "1 matches" in (tmp_path / "one/CARD.md").read_text(encoding="utf-8")
    assert set(load_strokes(tmp_path / "one/strokes.parquet")["player"].to_pylist()) == {"random", "safe"}
