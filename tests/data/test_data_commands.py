"""The command line of the data."""

import hashlib
import json
from pathlib import Path

import pyarrow as pa
import pytest

from shuttle_marl.base.errors import command
from shuttle_marl.commands.data import main
from shuttle_marl.data import load_account, load_strokes, upstream
from shuttle_marl.data.schema import STROKES
from shuttle_marl.data.table import write_parquet
from tests.data.upstream_layout import Layout, plain_game

NAME = "Viktor_AXELSEN_CHEN_Long_ Finals"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    layout = Layout(tmp_path / "raw")
    rows = plain_game(4)
    rows[0]["type"] = "未知球種"
    layout.match(NAME, [rows])
    return tmp_path / "raw"


@pytest.fixture
def published(root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The data set as if it were the published one, its match in the train split."""
    manifest = {
        path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(root.rglob("*.csv"))
    }
    monkeypatch.setattr(upstream, "manifest", lambda: manifest)
    monkeypatch.setattr("shuttle_marl.data.table.split_of", lambda name: "train" if name == NAME else None)
    return root


SUMMARY = {
    "matches": 1,
    "rallies": {"total": 4, "kept": 4},
    "strokes": {"total": 13, "kept": 12},
    "dropped": {"unknown shot type": 1},
    "area_agreement": 1.0,
}


def test_convert_and_summary_of_the_file(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new folder" / "strokes.parquet"
    assert main(["convert", str(root), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "unknown shot type" in told
    assert "Please cite" in told
    assert load_strokes(out).num_rows == 12
    for source in (root, out):
        assert main(["summary", str(source), "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == SUMMARY
    assert main(["validate", str(out)]) == 0
    assert "no problems" in capsys.readouterr().out


def test_validate_a_whole_folder(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (published / "ShuttleSet/set/Stranger").mkdir()
    assert main(["validate", str(published)]) == 0
    out = capsys.readouterr().out
    assert "train: 1 of 1 files as published, complete" in out
    assert "Stranger: not in match.csv, so it is not read" in out
    assert "no problems" in out


def test_validate_names_missing_and_altered_files(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = published / "ShuttleSet/set"
    (folder / NAME / "set1.csv").unlink()
    with (folder / "match.csv").open("a") as file:
        file.write("\n")
    assert main(["validate", str(published)]) == 1
    out = capsys.readouterr().out
    assert f"{folder / NAME}: missing set1.csv (train split); download them with `{command('data', 'download')}`" in out
    assert f"{folder / 'match.csv'}: altered: SHA-256 is " in out
    assert "train: 0 of 1 files as published, incomplete" in out


def test_validate_tells_every_problem(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = published / "ShuttleSet/set" / NAME / "set1.csv"
    text = path.read_text(encoding="utf-8").replace("殺球", "飛球").replace(",8,", ",88,", 1)
    path.write_text(text, encoding="utf-8")
    assert main(["validate", str(published), "--json"]) == 1
    captured = capsys.readouterr()
    report = json.loads(captured.out)
    assert len([p for p in report["problems"] if "unknown type '飛球'" in p]) == 2
    assert any("altered: SHA-256" in p for p in report["problems"])
    assert report["splits"]["train"] == {"whole": 0, "files": 1}
    assert f"{len(report['problems'])} problems" in captured.err


def test_validate_an_empty_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["validate", str(tmp_path), "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert any("contains none of the published data sets" in problem for problem in report["problems"])
    assert report["splits"]["test"] == {"whole": 0, "files": 30}


def test_validate_a_bad_table(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = load_strokes(root).to_pylist()
    rows[3]["technique"] = 9
    rows[4]["height"] = 7
    path = tmp_path / "bad.parquet"
    write_parquet(pa.Table.from_pylist(rows[1:], schema=STROKES), path, account=load_account(root), provenance={})
    assert main(["validate", str(path), "--json"]) == 1
    problems = json.loads(capsys.readouterr().out)["problems"]
    assert any("technique lies between 0 and 2: 1 rows break it, first row 2" in problem for problem in problems)
    assert any("height lies between 0 and 1" in problem for problem in problems)
    assert any("the account has 12 strokes, the table 11" in problem for problem in problems)
