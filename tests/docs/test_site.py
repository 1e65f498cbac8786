"""Tools of the documentation: each of them runs on the pages as they are, which hold what their sources say."""

import re

import pytest

import shuttle_marl
from docs.tools import croissant, figures, notebooks, pictures, reproduce, site, size, tables
from docs.tools.figures import FIGURES
from docs.tools.markdown import ROOT
from shuttle_marl import default_game, load_game


def test_every_page_of_the_site_is_in_the_navigation() -> None:
    found = {page for _, pages in site.sections((ROOT / "docs/index.md").read_text()) for page in pages}
    paths = {(ROOT / "docs" / f"{page}.md").resolve() for page in found}
    pages = {path for pattern in site.PAGES for path in ROOT.glob(pattern) if path.suffix == ".md"}
    assert pages - paths == {ROOT / "docs/index.md"}
    assert paths <= pages


def test_the_reference_has_every_public_name() -> None:
    """Sphinx reads the module that defines a name, and the name is in ``__all__`` of a package below the top."""
    unread = set(site.unpublished())
    read = [path.read_text() for path in (ROOT / "shuttle_marl").glob("*/**/*.py") if str(path) not in unread]
    exported = set(re.findall(r'"(\w+)"', "\n".join(text.partition("\n__all__")[2].partition("\n\n")[0] for text in read)))
    batched = ROOT / "shuttle_marl/env/batched.py"
    assert str(batched) not in unread
    own = set(re.findall(r"^class (\w+)", batched.read_text(), re.MULTILINE))
    assert set(shuttle_marl.__all__) - {"__version__"} <= exported | own
    assert str(ROOT / "shuttle_marl/commands/cli.py") in unread


def test_every_public_name_has_an_example() -> None:
    pages = [*ROOT.glob("docs/**/*.md"), ROOT / "README.md"]
    fence = re.compile(r"^```python[^\n]*\n(.*?)^```", re.DOTALL | re.MULTILINE)
    used = {word for page in pages for block in fence.findall(page.read_text()) for word in re.findall(r"\w+", block)}
    assert set(shuttle_marl.__all__) - {"__version__"} - used == set()


def test_the_sample_is_described() -> None:
    croissant.main(check=True)


@pytest.mark.parametrize("name", notebooks.NAMES)
def test_tutorials_are_notebooks(name: str) -> None:
    text = notebooks.text_form(name)
    assert text.startswith("---\njupyter:")
    assert "bash run" not in text
    links = re.findall(r"\]\(([^)#]+\.md)", text)
    assert all((ROOT / "docs/notebooks" / link).resolve().is_file() for link in links if not link.startswith("http"))


def test_figures_above_their_budgets_are_named() -> None:
    found = {"code": 1200, "rooms.game": 3}
    assert size.over_budget(found, {"code": 1200, "rooms.game": 3}) == []
    assert size.over_budget(found, {"code": 1199}) == ["code: 1,200, of at most 1,199", "rooms.game: no budget"]


PAGES = {figure.page: (ROOT / figure.page).read_text(encoding="utf-8") for figure in FIGURES}


def test_no_committed_figure_has_drifted() -> None:
    assert figures.updated(PAGES) == (PAGES, [])


def test_no_picture_is_older_than_its_data() -> None:
    assert pictures.outdated() == []


def test_every_result_file_is_made_by_a_command() -> None:
    for folder in ("benchmarks", "experiments"):
        saved = {path.stem for path in (ROOT / folder / "results").glob("*.json")}
        known = {name for name, result in tables.RESULTS.items() if result.folder == folder}
        assert saved == known


def test_tables_are_of_the_shipped_games() -> None:
    shipped = {game.hash[:12] for game in (default_game(), load_game("default:recovery"))}
    rows = list(reproduce.listed())
    earlier = {table for name, result in tables.RESULTS.items() if result.earlier for table in result.tables or (name,)}
    assert len(rows) > 40
    for table, *_, game, commit in rows:
        assert (game in shipped) != (table in earlier) or not commit, table
