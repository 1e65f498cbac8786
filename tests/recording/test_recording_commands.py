"""``python -m shuttle_marl.recording``."""

import re
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from shuttle_marl.commands.recording import main
from shuttle_marl.game.stroke import parse
from shuttle_marl.recording import RallyLog


def test_check_and_recover(played: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(played)]) == 0
    assert "replayed with equal outcomes" in capsys.readouterr().out
    assert main(["check", str(played), "--no-replay"]) == 0
    assert "not replayed" in capsys.readouterr().out
    part = tmp_path / "a.mcap.part"
    part.write_bytes(played.read_bytes()[:-2000])
    assert main(["check", str(part)]) == 1
    advice = re.search(r"recover ([^`]+)`", capsys.readouterr().err)
    assert advice is not None
    assert main(["recover", advice[1]]) == 0
    assert "recovered" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "a.mcap")]) == 0
    assert main(["recover", str(part)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert main(["recover", str(part), "--out", str(tmp_path / "b.mcap")]) == 0


@pytest.mark.parametrize("rows", ["rallies", "strokes"])
def test_export(played: Path, tmp_path: Path, rows: str, capsys: pytest.CaptureFixture[str]) -> None:
    for suffix in ("parquet", "csv", "arrow"):
        assert main(["export", str(played), str(tmp_path / f"t.{suffix}"), "--rows", rows]) == 0
    with RallyLog(played) as log:
        expected = log.rally_table() if rows == "rallies" else log.stroke_table()
    parquet = pyarrow.parquet.read_table(tmp_path / "t.parquet")
    arrow = pa.ipc.open_file(tmp_path / "t.arrow").read_all()
    csv = pyarrow.csv.read_csv(tmp_path / "t.csv")
    assert parquet.num_rows == arrow.num_rows == csv.num_rows == expected.num_rows
    for name in expected.column_names:
        values = expected[name].to_pylist()
        assert parquet[name].to_pylist() == arrow[name].to_pylist() == values
        if name == "strokes":
            names = expected["length"].to_pylist()
            assert [len([parse(s) for s in text.split()]) for text in csv[name].to_pylist()] == names
        elif name == "hurried" and rows == "rallies":
            assert [text.split() for text in csv[name].to_pylist()] == [[str(each).lower() for each in row] for row in values]
        else:
            assert csv[name].to_pylist() == values
    assert sorted(path.name for path in tmp_path.iterdir()) == ["t.arrow", "t.csv", "t.parquet"]
    assert f"{expected.num_rows:,} rows" in capsys.readouterr().out


def test_show_a_rally(played: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with RallyLog(played) as log:
        rally = log.rally(70)
        names = [log.header.policies[i].name for i in rally.policy[0]]
    assert main(["show", str(played), "--rally", "70"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"rally 70: {names[0]} v {names[1]}, match {rally.match[0]}, rally {rally.rally[0]}, ")
    assert len(lines) == len(rally.stroke) + 2
    assert "-serve to " in lines[1]
    assert lines[1].split()[1] == names[rally.server[0]]
    assert lines[-1].strip().startswith(f"{names[rally.winner[0]]} wins the rally")


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        ([], "either --rally NUMBER or --match NUMBER"),
        (["--rally", "1", "--match", "1"], "either --rally NUMBER or --match NUMBER"),
        (["--rally", "99999999"], "no rally 99999999"),
        (["--match", "77"], "no match 77 of pairing 0"),
    ],
)
def test_show_what_is_not_there(played: Path, flags: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", str(played), *flags]) == 1
    assert says in capsys.readouterr().err
