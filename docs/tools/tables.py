"""Writes the tables of the documentation from results, so that no number is typed by hand.

    python -m docs.tools.tables [--check]

A table stands between ``<!-- begin: NAME -->`` and ``<!-- end: NAME -->`` on any page; :data:`BLOCKS` lists the names. The
rankings are those of the default tournament, which is the same on every machine. The other tables come from
``benchmarks/results/`` and ``experiments/results/``. The model card is a page of its own.
Figures in sentences are those of :mod:`docs.tools.figures`, each with a tolerance. ``--check`` changes nothing and fails if a
page does not show what the results say.
"""

import dataclasses
import difflib
import functools
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

from rich.console import Console

from docs.tools import figures, league_tables, results, suite_tables
from docs.tools.markdown import ROOT
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.dynamics.evaluate import as_markdown
from shuttle_marl.game.shipped import model_folder, read_model_card
from shuttle_marl.league.entrants import LeagueConfig
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.run import run_league

RESULTS: Final = {**results.RESULTS, "suite": dataclasses.replace(results.RESULTS["suite"], tables=tuple(suite_tables.BLOCKS))}
"""Result files by name."""


@functools.cache
def _standings() -> list[Standing]:
    with tempfile.TemporaryDirectory() as temporary:
        return run_league(LeagueConfig(out=Path(temporary) / "run", record="none"), Console(stderr=True)).standings


BLOCKS: Final[dict[str, Callable[[], str]]] = {
    "layers": league_tables.layers,
    "ranking": lambda: league_tables.ranking(_standings()),
    "ranking_short": lambda: league_tables.ranking_short(_standings()),
    **{table: functools.partial(results.saved_table, table, name) for name, of in results.RESULTS.items() for table in of.tables},
    **suite_tables.BLOCKS,
}
"""Tables by name, and what makes them."""
MODEL_CARD: Final = "docs/model_card.md"  # the page that is made as a whole
_PAGES: Final = ("README.md", "benchmarks/README.md", "docs/*.md", "docs/suite/*.md")
_MARK: Final = re.compile(r"<!-- begin: (\w+) -->")


class TableError(ShuttleError):
    """A table that cannot be written, or that does not show the results."""


def replaced(text: str, name: str, table: str) -> str:
    """A page with one of its tables replaced.

    Raises:
        TableError: the page has no such place, or more than one.
    """
    begin, end = f"<!-- begin: {name} -->", f"<!-- end: {name} -->"
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise TableError(f"expected one {begin} with {end} behind it")
    return f"{text[: text.index(begin)]}{begin}\n{table}\n{text[text.index(end) :]}"


def rendered(root: Path) -> dict[str, str]:
    """Every page with tables as it should be, by its path from the root of the repository.

    Raises:
        TableError: a mark names no table, a place has no end, or a table stands on no page.
    """
    pages, made = {MODEL_CARD: as_markdown(read_model_card(model_folder()))}, dict[str, str]()
    for path in sorted(path for pattern in _PAGES for path in root.glob(pattern)):
        text = path.read_text(encoding="utf-8")
        for name in _MARK.findall(text):
            if name not in BLOCKS:
                raise TableError(f"{path}: no table is called {name!r}; there are {', '.join(sorted(BLOCKS))}")
            if name not in made:
                made[name] = BLOCKS[name]()
            pages[path.relative_to(root).as_posix()] = text = replaced(text, name, made[name])
    if missing := BLOCKS.keys() - made:
        raise TableError(f"no page shows {', '.join(sorted(missing))}")
    return pages


def main(*, check: bool = False) -> None:
    """Write all tables, or check them.

    Args:
        check: Change nothing; fail if a table differs.
    """
    pages = rendered(ROOT)
    for name in {figure.page for figure in figures.FIGURES} - set(pages):
        pages[name] = (ROOT / name).read_text(encoding="utf-8")
    pages, drifted = figures.updated(pages)
    if check and drifted:
        raise TableError("figures have drifted; run this without --check\n" + "\n".join(drifted))
    for name, after in pages.items():
        before = (ROOT / name).read_text(encoding="utf-8")
        if check and after != before:
            changes = "\n".join(difflib.unified_diff(before.splitlines(), after.splitlines(), name, "results", lineterm=""))
            raise TableError(f"{name} does not show what the results say; run this without --check\n{changes}")
        if not check:
            replace_file(ROOT / name, after.encode())
    Console().print(f"{len(pages)} pages {'checked' if check else 'written'}")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.tables", description="Write or check the tables of the documentation."))
