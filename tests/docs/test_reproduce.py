"""How tables are made: every one is listed once, and another result is noticed."""

import json
import os
from collections import Counter
from pathlib import Path

import pytest

from docs.tools import reproduce, tables
from docs.tools.markdown import ROOT
from docs.tools.reproduce import Result
from shuttle_marl.base.errors import ShuttleError


def test_every_table_is_listed_once() -> None:
    names = Counter(row[0] for row in reproduce.listed())
    assert set(names.values()) == {1}
    alone = {name for name, result in reproduce.RESULTS.items() if not result.tables}
    assert set(names) - alone == {*tables.BLOCKS, *tables.LEAGUE_BLOCKS}


def test_every_table_has_a_time() -> None:
    for name, result in reproduce.RESULTS.items():
        assert result.estimate or name in reproduce.measured(), name
    assert {*reproduce.COMPUTED} <= {*reproduce.measured()} <= {*reproduce.COMPUTED, *reproduce.RESULTS}


def test_every_result_file_is_made_by_a_command() -> None:
    for folder in ("benchmarks", "experiments"):
        saved = {path.stem for path in (ROOT / folder / "results").glob("*.json")}
        known = {name for name, result in reproduce.RESULTS.items() if result.folder == folder}
        assert saved <= known | set(reproduce.PROGRAMS)


@pytest.mark.parametrize(
    "table",
    [
        "layers",
        "layer_diagram",
        pytest.param(
            "stroke_value",
            marks=[pytest.mark.slow, pytest.mark.skipif("SHUTTLESET" not in os.environ, reason="needs the annotated matches")],
        ),
    ],
)
def test_a_table_is_made_again(table: str) -> None:
    """Continuous integration also makes `ranking`, `ranking_short` and `paths` again: ``docs.tools.tables --check``."""
    assert reproduce.check(table) == []


def result(command: str) -> Result:
    return Result(folder="benchmarks", tables=("again",), command=command, tolerance=0.1)


def test_a_result_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a program that prints JSON, and of one that writes it."""
    (tmp_path / "writes.py").write_text("import json, sys\njson.dump(sys.argv[1:], open(sys.argv[1], 'w'))\n")
    monkeypatch.setattr(reproduce, "ROOT", tmp_path)
    again = reproduce.remake("again", result("writes {out} runs/again"))
    assert json.loads(again) == ["benchmarks/results/again.json", "runs/again"]
    (tmp_path / "prints.py").write_text("print('[2]')\n")
    monkeypatch.setattr(reproduce, "RESULTS", {"again": result("prints")})
    monkeypatch.setattr(reproduce, "saved", lambda folder, name: [2.1])
    reproduce.main("again")
    monkeypatch.setattr(reproduce, "saved", lambda folder, name: [3])
    with pytest.raises(ShuttleError, match=r"(?s)again: 1 differences.*\[0\]: 3, now 2"):
        reproduce.main("again")
