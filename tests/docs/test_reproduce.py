"""How tables are made: every one is listed once, and another result is noticed."""

import json
import math
from collections import Counter
from pathlib import Path

import pytest

from docs.tools import reproduce, tables
from docs.tools.markdown import ROOT
from docs.tools.reproduce import Result, differences
from shuttle_marl.errors import ShuttleError

SAVED = {"value": 2.0, "names": ["a"], "rows": [1, 2.0], "won": True, "seconds": 3, "none": None}


def test_every_table_is_listed_once() -> None:
    names = Counter(row[0] for row in reproduce.listed())
    assert set(names.values()) == {1}
    alone = {name for name, result in reproduce.RESULTS.items() if not result.tables}
    assert set(names) - alone == {*tables.BLOCKS, *tables.LEAGUE_BLOCKS}


def test_every_result_file_is_made_by_a_command() -> None:
    for folder in ("benchmarks", "experiments"):
        saved = {path.stem for path in (ROOT / folder / "results").glob("*.json")}
        known = {name for name, result in reproduce.RESULTS.items() if result.folder == folder}
        assert saved <= known | set(reproduce.PROGRAMS)


@pytest.mark.parametrize("table", ["layers", "layer_diagram"])
def test_a_computed_table_is_that_of_its_page(table: str) -> None:
    assert reproduce.check(table) == []


@pytest.mark.parametrize(
    ("change", "tolerance", "found"),
    [
        ({}, 0.0, []),
        ({"seconds": 9}, 0.0, []),
        ({"value": 2.1}, 0.05, []),
        ({"value": 2.2}, 0.05, [".value: 2, now 2.2"]),
        ({"value": 2.0000001}, 0.0, [".value: 2, now 2"]),
        ({"rows": [1]}, 0.5, [".rows: 2 entries, now 1"]),
        ({"names": ["b"]}, 0.5, [".names[0]: 'a', now 'b'"]),
        ({"won": False}, 9.0, [".won: True, now False"]),
        ({"none": 1.0}, 9.0, [".none: None, now 1.0"]),
        ({"value": math.inf}, 0.5, [".value: 2, now inf"]),
        ({"more": 1}, 0.0, [".more: only in the new result"]),
    ],
)
def test_differences(change: dict, tolerance: float, found: list[str]) -> None:
    assert list(differences(SAVED, {**SAVED, **change}, tolerance)) == found


def test_a_key_that_is_gone() -> None:
    assert list(differences(SAVED, {}, 0.0)) == [f".{key}: only in the saved result" for key in sorted({*SAVED} - {"seconds"})]


def result(command: str) -> Result:
    return Result(folder="benchmarks", tables=("again",), command=command, time="a second", tolerance=0.1)


def test_a_result_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a program that prints JSON, and of one that writes it."""
    (tmp_path / "writes.py").write_text(f"import sys\nopen(sys.argv[1], 'w').write('{json.dumps({'x': 1})}')\n")
    monkeypatch.setattr(reproduce, "ROOT", tmp_path)
    assert reproduce.remake("again", result("writes {out}")) == {"x": 1}
    (tmp_path / "prints.py").write_text("print('[2]')\n")
    monkeypatch.setattr(reproduce, "RESULTS", {"again": result("prints")})
    monkeypatch.setattr(reproduce, "saved", lambda folder, name: [2.1])
    reproduce.main("again")
    monkeypatch.setattr(reproduce, "saved", lambda folder, name: [3])
    with pytest.raises(ShuttleError, match=r"(?s)again: 1 differences.*\[0\]: 3, now 2"):
        reproduce.main("again")


def test_what_cannot_be_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SHUTTLESET", raising=False)
    with pytest.raises(ShuttleError, match="needs the annotated matches"):
        reproduce.check("human")
    with pytest.raises(ShuttleError, match="no table 'nothing'"):
        reproduce.check("nothing")
    with pytest.raises(ShuttleError, match="recipes is not compared"):
        reproduce.check("recipes")
    monkeypatch.setattr(reproduce, "ROOT", tmp_path)
    (tmp_path / "fails.py").write_text("raise SystemExit(3)\n")
    with pytest.raises(ShuttleError, match="exit status 3"):
        reproduce.remake("again", result("fails"))
