"""How tables are made: every one is listed once, and another result is noticed."""

from collections import Counter

from docs.tools import reproduce, tables
from docs.tools.markdown import ROOT


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
