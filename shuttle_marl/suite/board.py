"""The leaderboard as Markdown and HTML, from the rows of runs, in two classes.

*Rerun*: who makes the board has a rerun of the committed code in a round, with these scores. *Self-reported*: all others; their
scores are recomputed from stored policies and answers, and the rest is what their authors say.
"""

import dataclasses
import unicodedata
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, Literal, TypedDict

import jinja2

from shuttle_marl.base.errors import ShuttleError, described, printable
from shuttle_marl.reports.html import escaped
from shuttle_marl.suite import store
from shuttle_marl.suite.options import ACCESS, NOTHING_GIVEN, Split, SuiteError, VerifyOptions
from shuttle_marl.suite.registry import TASKS
from shuttle_marl.suite.results import TOLERANCE, Bounds, Row, summarise, verify_run
from shuttle_marl.suite.task import Task

_TEMPLATES: Final = Path(__file__).parent / "templates"
_LONGEST: Final = 60
"""Characters of a name that are shown."""


def render(rows: Sequence[Row], kind: Literal["md", "html"]) -> str:
    """The board as Markdown or HTML."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES), autoescape=kind == "html", trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["text"] = printable if kind == "html" else escaped
    environment.filters["name"] = shown if kind == "html" else code
    environment.filters |= {each.__name__: each for each in (number, with_interval, stated, called, standing)}
    return environment.get_template(f"board.{kind}").render(boards=boards(rows)) + "\n"


def shown(name: str, longest: int = _LONGEST) -> str:
    """A stranger's name in ASCII, so that it looks like no other one, and short."""
    plain = unicodedata.normalize("NFKC", printable(name))
    text = " ".join(plain.encode("ascii", "backslashreplace").decode().split()) or "(no name)"
    return text if len(text) <= longest else f"{text[:longest]}..."


def code(name: str, longest: int = _LONGEST) -> str:
    """The same as code in a table of Markdown, in which nothing is an address or a mention."""
    return "`" + shown(name, longest).replace("`", "'").replace("|", "\\|") + "`"


def called(row: Row) -> str:
    """Name of a method; that of a stranger's has the author before it, so that none is called like one of this package."""
    return f"{row['author']}/{row['method']}" if row["author"] else row["method"]


def standing(row: Row) -> str:
    """The class of a row, and what supports it."""
    if reran := row.get("reran_by"):
        return f"rerun by {', '.join(reran)}"
    return f"self-reported, {'recomputed' if row.get('recomputed') else 'not recomputed'}"


def rows_of(
    folders: Sequence[Path],
    results: Path | None = None,
    *,
    reran: Sequence[Path] = (),
    check: bool = True,
    given: VerifyOptions = NOTHING_GIVEN,
    progress: Callable[[Any], Any] = lambda units: units,
    failed: Callable[[str], object],
) -> list[Row]:
    """Rows of run folders and of a file of results, for :func:`render`.

    Args:
        folders: run folders, which may be those of strangers.
        results: JSON file with ``rows`` of this package, which are taken as they are; None: none.
        reran: run folders of ``suite rerun`` whose makers the user trusts, such as the user's own.
        failed: receives the reason why a folder is left out: it is refused, is no finished run, stands there twice, or differs
            from a rerun.

    Raises:
        SuiteError: the file cannot be read.
    """
    rows: list[Row] = []
    for folder in (*reran, *folders):
        try:
            if check:
                found = verify_run(folder, given, progress=progress)
                if found.summary is None:
                    raise SuiteError(f"{len(found.refused)} of {found.units} units are refused: {found.refused[0].reason}")
                row = found.summary
            else:
                row = summarise(folder, given.beacon, given.game)
            row["recomputed"] = True if check else None
            row["reran_by"] = []
            if folder in reran:
                if row["commitment"] is None:
                    raise SuiteError("is no rerun of a round; name it as a folder")
                rerun = store.read(folder / store.RERUN, store.Rerun, "; `suite rerun` writes it")
                row["reran_by"], row["round"] = [rerun.by], rerun.round
            if _is_new(row, rows):
                rows.append(row)
        except Exception as error:
            failed(f"{folder}: {error if isinstance(error, ShuttleError) else described(error)}")
    if results is not None:
        rows += store.read(results, _Results).rows
    return rows


def _is_new(row: Row, rows: Sequence[Row]) -> bool:
    """Whether a run belongs on the board beside others; another rerun of the same code is added to its row.

    Raises:
        SuiteError: it is the same run as another one, or differs from a rerun of the same code.
    """
    for other in rows:
        if any(other[key] != row[key] for key in ("task", "split", "budget", "cases")):
            continue
        if "round" in row and row["round"] != other.get("round", row["round"]):
            raise SuiteError("is of another file of the round; take that of the organiser")
        if other.get("reran_by") and row["commitment"] == other["commitment"]:
            close = abs(row["score"] - other["score"]) <= TOLERANCE
            if not close or any(row[key] != other[key] for key in ("seeds", "outputs")):
                found = f"{other['score']:.4f} ({other['seeds']} seeds) when it was rerun"
                if row["reran_by"]:
                    other["remarks"] = [*other["remarks"], f"{row['score']:.4f} when {row['reran_by'][0]} reran it"]
                raise SuiteError(f"says {row['score']:.4f} ({row['seeds']} seeds); the code gave {found}")
            other["reran_by"] = sorted({*other.get("reran_by", ()), *row.get("reran_by", ())})
            return False
        same = row["seeds"] == other["seeds"] and (row["outputs"] == other["outputs"] or _figures(row) == _figures(other))
        if same and called(row) == called(other):
            raise SuiteError("the same run as another one of the board")
        if same and row["kind"] != "reference":
            what = "policies" if row["outputs"] == other["outputs"] else "scores"
            for one, two in ((row, other), (other, row)):  # the order of folders proves nothing
                one["remarks"] = [*one["remarks"], f"the same {what} as {shown(called(two))}"]
    return True


def _figures(row: Row) -> str:
    """Results of all units, to the digits to which they are verified: a table may be changed where it is never used."""
    units = {s: {case: [round(x, 6) for x in parts] for case, parts in cases.items()} for s, cases in row["units"].items()}
    return repr((units, [round(bounds["value"], 6) for bounds in row["scores"].values()]))


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Results:
    rows: list[Row]


class Board(TypedDict):
    """A board: rows of a task, split and budget with the same cases, best first; ranks are of a class and an access.

    ``best`` is the first method of the first class and least access, ``gap`` its distance to the optimum.
    """

    task: Task
    split: Split
    budget: int
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
            if row["task"] == name and row["split"] in task.splits:
                key = task.splits.index(row["split"]), row["budget"] or 0, row["game"], row["cases"]
                groups.setdefault(key, []).append(row)
        for (number, budget, game, cases), those in sorted(groups.items()):
            several = sum(key[:2] == (number, budget) for key in groups) > 1
            title = f"{name}, {task.splits[number]}" + (f", {budget:,} strokes" if budget else "")
            found.append(_board(task, those, title + (f", game {game[:8]}, cases {cases[:8]}" if several else "")))
    return found


def _board(task: Task, rows: list[Row], title: str) -> Board:
    """Rows in their order, with ranks, and the best one."""
    sign = -1 if task.higher_is_better else 1
    rows.sort(key=lambda row: (*_class(row), sign * row["score"]))
    ranked = [row for row in rows if row["kind"] == "method" and row.get("recomputed") is not False]
    classes = [*map(_class, ranked)]
    for place, row in enumerate(ranked):
        row["rank"] = place - classes.index(_class(row)) + 1
    best, optimum = ranked[0] if ranked else None, task.optimum
    if optimum is None and best is not None and "best" in best["scores"]:
        optimum = best["scores"]["best"]["value"]
    return {
        "task": task,
        "split": rows[0]["split"],
        "budget": rows[0]["budget"] or 0,
        "title": title,
        "optimum": optimum,
        "best": best,
        "gap": abs(optimum - best["score"]) if best and optimum is not None else None,
        "columns": list(dict.fromkeys(score for row in rows for score in row["scores"] if score != task.metric)),
        "rows": rows,
    }


def _class(row: Row) -> tuple[bool, int]:
    """Order of the classes: rerun first, and what is read, from little to much."""
    return not row.get("reran_by"), ACCESS.index(row["access"])


def stated(strokes: int | str | None) -> str:
    """Strokes used for tuning, as the author states them."""
    return "not stated" if strokes is None else f"{strokes:,}" if isinstance(strokes, int) else shown(strokes)


def with_interval(score: Bounds) -> str:
    """A score with its interval, if it has one."""
    low, high = score["low"], score["high"]
    text = number(score["value"])
    return text if low is None or high is None else f"{text} ({number(low)} to {number(high)})"


def number(value: float | None) -> str:
    """A score as text."""
    return "" if value is None else f"{value:z.3f}"
