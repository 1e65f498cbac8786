"""The tables of the documentation come from results."""

import re
import shutil
from pathlib import Path

import pytest

from docs.tools import tables
from docs.tools.league_tables import TableError
from docs.tools.markdown import ROOT


@pytest.fixture
def pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of all pages, which the tool takes for those of the repository."""
    for path in (path for pattern in ("*.md", "docs/**/*.md", "benchmarks/*.md") for path in ROOT.glob(pattern)):
        copy = tmp_path / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    # `docs.tools.tables --check` makes the tables themselves, in continuous integration.
    monkeypatch.setattr(tables, "BLOCKS", {name: lambda name=name: f"| {name} | 1 |" for name in tables.BLOCKS})
    monkeypatch.setattr(tables, "LEAGUE_BLOCKS", {name: lambda _: "| 1 | bc |" for name in tables.LEAGUE_BLOCKS})
    return tmp_path


def test_check_finds_a_number_typed_by_hand(pages: Path) -> None:
    tables.main(run=pages)
    tables.main(run=pages, check=True)
    page = pages / "docs" / "league.md"
    page.write_text(page.read_text(encoding="utf-8").replace("| 1 |", "| 7 |"), encoding="utf-8")
    with pytest.raises(TableError, match=r"(?s)docs/league\.md does not show.*\+\| 1 \|"):
        tables.main(run=pages, check=True)


def test_no_page_states_a_probability_beyond_100_percent() -> None:
    """Normal intervals of probabilities are cut at 0 and 100 %, and exploitability is a value from 0 to 1 everywhere."""
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = path.read_text(encoding="utf-8")
        beyond = [number for number in re.findall(r"(\d+\.\d+) (?:% )?(?:to \d|\))", text) if 100 < float(number) < 101]
        assert beyond == [], path
        assert not re.findall(r"exploitab\w+ (?:of |is |about )?\d+(?:\.\d+)? %", text), path
