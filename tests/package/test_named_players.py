"""One position on named players, the same on every page, and pseudonyms in their place."""

import json
from pathlib import Path

import pyarrow.parquet as pq

from shuttle_marl.commands.data import main as data
from shuttle_marl.data import anonymised, read_matches

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


def test_the_import_writes_pseudonyms(tmp_path: Path) -> None:
    assert data(["template", "--out", str(tmp_path)]) == 0
    source, out = tmp_path / "strokes.csv", tmp_path / "strokes.parquet"
    columns = ["--columns", str(tmp_path / "columns.toml"), "--out", str(out)]
    assert data(["import", str(source), *columns, "--anonymous"]) == 0
    table = pq.read_table(out)
    assert set(table["player"].to_pylist()) == {"player-01", "player-02"}
    assert set(table["match"].to_pylist()) == {"match-001"}
