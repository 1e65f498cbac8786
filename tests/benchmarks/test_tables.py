"""The tables of the documentation come from results."""

import sys
from pathlib import Path

import pytest

from benchmarks import startup, tables
from shuttle_marl.league.config import LeagueConfig
from shuttle_marl.league.run import run_league

PAGE = "before\n<!-- begin: x -->\nold\n<!-- end: x -->\nafter\n"


def test_a_table_is_replaced_and_nothing_else() -> None:
    after = tables.replaced(PAGE, "x", "new\nlines")
    assert after == "before\n<!-- begin: x -->\nnew\nlines\n<!-- end: x -->\nafter\n"
    assert tables.replaced(after, "x", "new\nlines") == after


@pytest.mark.parametrize("page", ["no marks", PAGE + PAGE, "<!-- end: x -->\n<!-- begin: x -->\n"])
def test_a_page_without_one_place_is_refused(page: str) -> None:
    with pytest.raises(tables.TableError, match="expected one <!-- begin: x -->"):
        tables.replaced(page, "x", "new")


def test_ranking_of_a_run(tmp_path: Path) -> None:
    run = run_league(LeagueConfig(pool=("random", "safe", "attacking"), matches=4, out=tmp_path / "run", record="none"))
    lines = tables.ranking(run.folder).splitlines()
    names = [line.split(" | ")[1] for line in lines[2:5]]
    assert names == [standing.player for standing in run.standings]
    assert f"{100 * run.standings[0].share:.1f} %" in lines[2]
    assert lines[-1].startswith("3 players, 4 matches a pair, seed 0, game `")


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(tables.TableError, match="no finished run"):
        tables.ranking(tmp_path)


def test_check_finds_a_number_typed_by_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = run_league(LeagueConfig(pool=("random", "safe"), matches=2, out=tmp_path / "run", record="none"))
    for name in (*(name for name, _ in tables.TABLES), *tables.WHOLE_PAGES):
        page = tmp_path / name
        page.parent.mkdir(exist_ok=True)
        page.write_text((tables.ROOT / name).read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    tables.main(run=run.folder)
    tables.main(run=run.folder, check=True)
    page = tmp_path / "README.md"
    page.write_text(page.read_text(encoding="utf-8").replace("| 1 |", "| 7 |"), encoding="utf-8")
    with pytest.raises(tables.TableError, match=r"(?s)README\.md does not show.*\+\| 1 \|"):
        tables.main(run=run.folder, check=True)


def test_cpu_time_is_that_of_the_command() -> None:
    busy = [sys.executable, "-c", "import time\nwhile time.process_time() < 0.3: pass"]
    assert 0.3 <= startup.cpu_seconds(busy, 1) < 3
