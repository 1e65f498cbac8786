"""The tables of the documentation come from results."""

import json
import re
import shutil
from pathlib import Path

import pytest

from docs.tools import markdown, suite_tables, tables
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


def test_boards_of_the_suite_are_made_from_its_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suite_tables, "ROOT", tmp_path)
    monkeypatch.setattr(markdown, "ROOT", tmp_path)
    assert "no results yet" in suite_tables.task_boards("exploit-v0")
    score = {"value": 0.25, "low": 0.2, "high": 0.3}
    row = {
        "task": "exploit-v0", "method": "ppo", "split": "test", "budget": 1000, "score": 0.75, "low": 0.7, "high": 0.8,
        "worst": 0.6, "scores": {"objective": {"value": 0.75, "low": 0.7, "high": 0.8}, "exploitability": score}, "seconds": 12.3,
        "official": False, "verified": True, "game": "another", "quick": False, "kind": "method", "access": "samples",
        "isolated": False,
        "strata": {"bc/1,000": {"objective": 0.6}, "safe/1,000": {"objective": 0.9}},
    }  # fmt: skip
    rows = [
        row,
        {**row, "method": "dqn", "score": 0.5, "behind": score},
        {**row, "method": "minimax", "score": 0.9, "kind": "reference"},
    ]
    (tmp_path / "experiments" / "results").mkdir(parents=True)
    (tmp_path / "experiments" / "results" / "suite.json").write_text(json.dumps({"rows": rows}))
    text = suite_tables.task_boards("exploit-v0")
    assert text.startswith("**exploit-v0, test, 1,000 strokes**")
    ppo = "| samples | 1 | `ppo` | 0.750 (0.700 to 0.800) | 0.600 |  | 0.2500 | 12 | yes |"
    assert text.index("| samples | reference | `minimax`") < text.index(ppo) < text.index("| samples | 2 | `dqn`")
    assert "| 0.600 | 0.250 (0.200 to 0.300) | 0.2500 |" in text
    assert "Best: `ppo`, 0.750 (0.700 to 0.800). Optimum 1.000, open gap 0.250." in text
    assert "Mean objective by case:" in text
    assert "| method | `bc` | `safe` |" in text
    assert "| `ppo` | 0.600 | 0.900 |" in text
    assert "**Preliminary**" in text
    assert "| 1,000 | `ppo` | 0.750 (0.700 to 0.800), preliminary | 0.250 |" in suite_tables.summary("docs/suite/")
