"""The leaderboard as Markdown, from the rows of runs.

Rows are self-reported: their scores are recomputed from stored policies and answers, and the rest is what their authors say.
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, TypedDict

import jinja2

from shuttle_marl.base import cache
from shuttle_marl.base.errors import ShuttleError, described, printable
from shuttle_marl.reports.html import escaped
from shuttle_marl.suite.options import ACCESS, SPLITS, SuiteError
from shuttle_marl.suite.results import CARD, DIGITS, NOT_VERIFIED, TASKS, Bounds, Row, difference, distinct, read, verify_run
from shuttle_marl.suite.task import Task

_LONGEST: Final = 60  # characters of a name that are shown
_LONGEST_AUTHOR: Final = 24  # the same of an author, so that the method behind it is seen


def render(rows: Sequence[Row]) -> str:
    """The board as Markdown."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
    environment = jinja2.Environment(loader=loader, trim_blocks=True, lstrip_blocks=True, autoescape=False)
    environment.filters |= {"text": escaped, "name": code}
    environment.filters |= {each.__name__: each for each in (number, with_interval, stated, called)}
    return environment.get_template("board.md").render(boards=boards(rows), not_verified=NOT_VERIFIED) + "\n"


def shown(name: str, longest: int = _LONGEST) -> str:
    """A stranger's name, short, and in ASCII, so that letters of other scripts look like no Latin ones."""
    plain = printable(name).translate({ord(c): f"\\x{ord(c):x}" for c in "`|"})  # which end code, and cells, in Markdown
    text = " ".join(plain.encode("ascii", "backslashreplace").decode().split()) or "(no name)"
    return text if len(text) <= longest else f"{text[:longest]}..."


def code(name: str, longest: int = _LONGEST) -> str:
    """The same as code in a table of Markdown, in which nothing is an address or a mention."""
    return f"`{shown(name, longest)}`"


def called(row: Row) -> str:
    """Name of a method; that of a stranger's has the author before it, so that none is called like one of this package."""
    return f"{shown(row['author'], _LONGEST_AUTHOR)}/{row['method']}" if row["author"] else row["method"]


def rows_of(
    folders: Sequence[Path],
    results: Path | None = None,
    *,
    game: str | None = None,
    seed: str | None = None,
    progress: Callable[[Any], Any] = iter,
    failed: Callable[[str], object],
) -> list[Row]:
    """Rows of run folders and of a file of results, for :func:`render`.

    Args:
        folders: run folders, which may be those of strangers.
        results: JSON file with ``rows`` of this package, which are taken as they are; None: none.
        game, seed: see :func:`shuttle_marl.suite.results.verify_run`.
        failed: receives the reason why a folder is left out: it is refused, is no finished run, names no author, or was there.

    Raises:
        SuiteError: the file cannot be read.
    """
    rows, known = list[Row](), dict[tuple[str, ...], Path]()
    with cache.forgotten():
        for folder in folders:
            try:
                found = verify_run(folder, game, seed, progress=progress)
                if found.summary is None:
                    raise SuiteError(f"{len(found.refused)} of {found.units} units are refused: {found.refused[0].reason}")
                if not found.summary["author"]:
                    raise SuiteError(f"the run has no author; name one in {CARD}")
                own = found.summary["author"], found.summary["method"], repr(found.summary["units"])
                if (same := known.setdefault(own, folder)) is not folder:
                    raise SuiteError(f"left out, because it holds the units of {same}")
                rows.append(found.summary)
            except Exception as error:
                failed(f"{folder}: {error if isinstance(error, ShuttleError) else described(error)}")
    if results is not None:
        rows += read(results, Results).rows
    return rows


@dataclasses.dataclass(frozen=True, kw_only=True)
class Results:
    """Rows of this package, and frontiers by task and opponent: a file of ``python -m experiments.suite``."""

    rows: list[Row]
    frontiers: dict[str, dict[str, list[dict[str, float]]]] = dataclasses.field(default_factory=dict)


class Board(TypedDict):
    """A board: rows of a task, split and budget with the same cases, best first; ranks are among methods of an access.

    ``best`` is the first method of the least access, ``gap`` its distance to the optimum.
    """

    task: Task
    title: str
    optimum: float | None
    best: Row | None
    gap: float | None
    columns: list[str]
    rows: list[Row]


def boards(rows: Sequence[Row]) -> list[Board]:
    """Boards of all tasks, splits, budgets and cases."""
    found: list[Board] = []
    for name, task in TASKS.items():
        groups: dict[tuple[int, int, str, str], list[Row]] = {}
        for row in rows:
            if row["task"] == name:
                key = SPLITS.index(row["split"]), row["budget"] or 0, row["game"], row["cases"]
                groups.setdefault(key, []).append(row)
        for (number, budget, game, cases), those in sorted(groups.items()):
            several = sum(key[:2] == (number, budget) for key in groups) > 1
            title = f"{name}, {SPLITS[number]}" + (f", {budget:,} strokes" if budget else "")
            found.append(_board(task, those, title + (f", game {game[:8]}, cases {cases[:8]}" if several else "")))
    return found


def _board(task: Task, rows: list[Row], title: str) -> Board:
    """Rows in their order, with ranks, and the best one."""
    sign = -1 if task.higher_is_better else 1

    def order(row: Row) -> tuple[int, float]:
        return ACCESS.index(row["access"]), round(sign * row["score"], DIGITS)

    def units(row: Row) -> dict[str, set[float]]:
        return {case: distinct(seeds) for cases in row["units"].values() for case, seeds in cases.items()}

    rows.sort(key=lambda row: (*order(row), bool(row["author"]), called(row)))
    for row in rows:
        if same := [called(each) for each in rows if each is not row and units(each) == units(row)]:
            row["remarks"] = [*row["remarks"], f"the same scores as {', '.join(same)}"]
    ranked = [row for row in rows if row["kind"] == "method"]
    for row in ranked:
        row["rank"] = 1 + sum(each["access"] == row["access"] and order(each) < order(row) for each in ranked)
    best, optimum = ranked[0] if ranked else None, task.optimum
    for row in rows:
        if best and row is not best and row["seeds"] == best["seeds"]:
            row["behind"] = difference(best, row)
    if optimum is None and best is not None and "best" in best["scores"]:
        optimum = best["scores"]["best"]["value"]
    return {
        "task": task,
        "title": title,
        "optimum": optimum,
        "best": best,
        "gap": abs(optimum - best["score"]) if best and optimum is not None else None,
        "columns": list(dict.fromkeys(score for row in rows for score in row["scores"] if score != task.metric)),
        "rows": rows,
    }


def stated(strokes: int | str | None) -> str:
    """Strokes used for tuning, as the author states them."""
    return "not stated" if strokes is None else f"{strokes:,}" if isinstance(strokes, int) else shown(strokes)


def with_interval(score: Bounds | None) -> str:
    """A score with its interval, if it has one of some width."""
    if not score:
        return ""
    low, high = number(score["low"]), number(score["high"])
    return number(score["value"]) + (f" ({low} to {high})" if low != high else "")


def number(value: float | None) -> str:
    """A score as text."""
    return "" if value is None else f"{value:z.3f}"
