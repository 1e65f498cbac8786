"""One position on named players, the same on every page, and pseudonyms in their place."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from shuttle_marl.commands.analysis import main as analysis
from shuttle_marl.commands.data import main as data
from shuttle_marl.data import anonymised, read_matches
from tests.reduced import reduced_model

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "datasets" / "sample" / "strokes.parquet"


def test_pseudonyms_replace_players_and_matches_alone() -> None:
    strokes = read_matches(SAMPLE)
    hidden = anonymised(strokes)
    assert hidden.schema == strokes.schema
    same = [name for name in strokes.schema.names if name not in ("player", "opponent", "match")]
    assert hidden.select(same) == strokes.select(same)
    pairs = set(zip(strokes["player"].to_pylist(), hidden["player"].to_pylist(), strict=True))
    pairs |= set(zip(strokes["opponent"].to_pylist(), hidden["opponent"].to_pylist(), strict=True))
    names = {name for name, _ in pairs}
    assert len(pairs) == len(names) == len({pseudonym for _, pseudonym in pairs}), "one to one"
    assert anonymised(strokes) == hidden
    assert not any(name in json.dumps(hidden.to_pylist()) for name in names if len(name) > 3)


def test_commands_print_and_write_pseudonyms(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert analysis([str(SAMPLE), "--anonymous", "--json", "--game", reduced_model()]) == 0
    assert all(name.startswith("player-") for name in json.loads(capsys.readouterr().out))
    assert data(["template", "--out", str(tmp_path)]) == 0
    source, out = tmp_path / "strokes.csv", tmp_path / "strokes.parquet"
    columns = ["--columns", str(tmp_path / "columns.toml"), "--out", str(out)]
    assert data(["import", str(source), *columns, "--anonymous"]) == 0
    table = pq.read_table(out)
    assert set(table["player"].to_pylist()) == {"player-01", "player-02"}
    assert set(table["match"].to_pylist()) == {"match-001"}
