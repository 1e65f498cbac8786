"""The leaderboard as Markdown and HTML, from the rows of runs."""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, Literal, TypedDict

import jinja2
import numpy as np

from shuttle_marl.base.errors import ShuttleError, described, printable
from shuttle_marl.pages import escaped
from shuttle_marl.suite import frozen, store
from shuttle_marl.suite.options import ACCESS, Split, SuiteError
from shuttle_marl.suite.registry import TASKS
from shuttle_marl.suite.results import Bounds, Row, summarise
from shuttle_marl.suite.verify import marked, verify_run

_TEMPLATES: Final = Path(__file__).parent / "templates"
_PERCENT: Final = ("regret", "rally_win", "error", "bias", "legal", "away")
"""Beginnings of the names of scores that are printed in per cent."""
_SWEEPS: Final = 2000
"""Iterations of the ratings."""
_CHECKED: Final = {True: "yes", False: "no", None: "not checked"}
_LONGEST: Final = 60
"""Characters of a name that are shown."""


def render(rows: Sequence[Row], kind: Literal["md", "html"]) -> str:
    """The board as Markdown or HTML."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES), autoescape=kind == "html", trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["text"] = printable if kind == "html" else escaped
    environment.filters["name"] = shown if kind == "html" else code
    environment.filters |= {"number": number, "interval": with_interval, "stated": _stated, "checked": _CHECKED.get}
    return environment.get_template(f"board.{kind}").render(boards=(found := boards(rows)), ratings=rating(found)) + "\n"


def shown(name: str, longest: int = _LONGEST) -> str:
    """A stranger's name in ASCII, so that it looks like no other one, and short."""
    text = " ".join(printable(name).encode("ascii", "backslashreplace").decode().split()) or "(no name)"
    return text if len(text) <= longest else f"{text[:longest]}..."


def code(name: str, longest: int = _LONGEST) -> str:
    """The same as code in a table of Markdown, in which nothing is an address or a mention."""
    return "`" + shown(name, longest).replace("`", "'").replace("|", "\\|") + "`"


def rows_of(
    folders: Sequence[Path],
    results: Path | None = None,
    *,
    check: bool = True,
    game: str | None = None,
    beacon: str | None = None,
    data: Path | None = None,
    progress: Callable[[Any], Any] = lambda units: units,
    failed: Callable[[str], object],
) -> list[Row]:
    """Rows of run folders and of a file of results, for :func:`render`.

    Args:
        folders: run folders, which may be those of strangers.
        results: JSON file with ``rows``, which are taken as they are; None: none.
        game: model of the game; None: the shipped model that a run names.
        beacon: randomness of the beacon round of the hidden split.
        data: annotated matches, for ``imitate``.
        failed: receives the reason why a folder is left out: it is refused, is no finished run, or stands there twice.

    Raises:
        SuiteError: the file cannot be read.
    """
    rows: list[Row] = []
    for folder in folders:
        try:
            if not check:
                row = marked(summarise(folder, beacon, game))
            else:
                found = verify_run(folder, game=game, beacon=beacon, data=data, progress=progress)
                if found.summary is None:
                    raise SuiteError(f"{len(found.refused)} of {found.units} units are refused: {found.refused[0].reason}")
                row = found.summary
            row["verified"] = True if check else None
            _compare(row, rows)
        except Exception as error:
            failed(f"{folder}: {error if isinstance(error, ShuttleError) else described(error)}")
        else:
            rows.append(row)
    if results is not None:
        rows += store.read(results, _Results).rows
    return rows


def _compare(row: Row, rows: Sequence[Row]) -> None:
    """Find another row with the same policies and answers; references have them for several budgets.

    Raises:
        SuiteError: it is the same run.
    """
    for other in rows:
        if (other["task"], other["outputs"]) == (row["task"], row["outputs"]):
            if all(other[key] == row[key] for key in ("method", "split", "budget")):
                raise SuiteError("the same run as another one of the board")
            if row["kind"] != "reference":
                budget = "" if other["budget"] is None else f" at {other['budget']:,} strokes"
                row["remarks"] = [*row["remarks"], f"the same policies as {shown(other['method'])}{budget}"]
                row["official"] = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Results:
    rows: list[Row]


class Board(TypedDict):
    """A board: rows of a task, split and budget, best first; methods of each access are ranked apart.

    ``best`` is the first official method of the least access, ``gap`` its distance to the optimum.
    """

    task: str
    split: Split
    budget: int
    title: str
    about: str
    metric: str
    optimum: float | None
    target: str
    best: Row | None
    gap: float | None
    columns: list[str]
    rows: list[Row]
    frozen: bool


def boards(rows: Sequence[Row]) -> list[Board]:
    """Boards of all tasks, splits and budgets."""
    found: list[Board] = []
    for name, task in TASKS.items():
        of_task = [row for row in rows if row["task"] == name and row["split"] in task.splits]
        for number, budget in sorted({(task.splits.index(row["split"]), row["budget"] or 0) for row in of_task}):
            split = task.splits[number]
            shown = [row for row in of_task if (row["split"], row["budget"] or 0) == (split, budget)]
            sign = -1 if task.higher_is_better else 1
            shown.sort(key=lambda row: (ACCESS.index(row["access"]), sign * row["score"]))
            ranked = [row for row in shown if row["kind"] == "method" and row.get("verified") is not False]
            best = next((row for row in ranked if row["official"]), ranked[0] if ranked else None)
            places = [row["access"] for row in ranked]
            for place, row in enumerate(ranked):
                row["rank"] = place - places.index(row["access"]) + 1
            found.append({
                "task": name,
                "split": split,
                "budget": budget,
                "title": f"{name}, {split}" + (f", {budget:,} strokes" if budget else ""),
                "about": " ".join((task.__doc__ or "").split()),
                "metric": task.metric,
                "optimum": task.optimum,
                "target": task.target,
                "best": best,
                "gap": abs(task.optimum - best["score"]) if best and task.optimum is not None else None,
                "columns": list(dict.fromkeys(score for row in shown for score in row["scores"] if score != task.metric)),
                "rows": shown,
                "frozen": all(frozen.load().official(row["game"]) and not row["quick"] for row in shown),
            })  # fmt: skip
    return found


def rating(found: Sequence[Board]) -> dict[str, float]:
    """Bradley-Terry ratings of all methods in Elo points, best first (MM algorithm: Hunter, Annals of Statistics 32, 2004).

    A game is a pair of rows of a board with the same units, and its result the fraction of units in which a row is the better
    one. Everyone also draws once with a player of 1500 points, so that ratings are finite, and boards without common methods
    comparable.
    """
    names = list(dict.fromkeys(row["method"] for board in found for row in board["rows"] if row["kind"] != "ablation"))
    won = np.zeros((len(names), len(names)))
    for board in found:
        sign = 1 if TASKS[board["task"]].higher_is_better else -1
        middle = {row["method"]: {case: np.mean(seeds) for part in row["units"].values() for case, seeds in part.items()}
                  for row in board["rows"] if row["kind"] != "ablation"}  # fmt: skip
        for (ours, mine), (theirs, other) in itertools.permutations(middle.items(), 2):
            if mine.keys() == other.keys():
                better = [0.5 + 0.5 * np.sign(sign * (mine[case] - other[case])) for case in mine]
                won[names.index(ours), names.index(theirs)] += np.mean(better)
    strength, games = np.ones(len(names)), won + won.T
    for _ in range(_SWEEPS):
        expected = (games / (strength[:, None] + strength)).sum(axis=1) + 1 / (1 + strength)
        strength = (won.sum(axis=1) + 0.5) / expected
    points = 1500 + 400 * np.log10(strength)
    return {names[i]: float(points[i]) for i in np.argsort(-points, kind="stable").tolist()}


def _stated(strokes: int | str | None) -> str:
    """Strokes used for tuning, as the author states them."""
    return "not stated" if strokes is None else f"{strokes:,}" if isinstance(strokes, int) else shown(strokes)


def with_interval(score: Bounds, name: str) -> str:
    """A score with its interval, if it has one."""
    low, high = score["low"], score["high"]
    text = number(score["value"], name)
    return text if low is None or high is None else f"{text} ({number(low, name)} to {number(high, name)})"


def number(value: float | None, name: str = "") -> str:
    """A score as text, in per cent if its name says so."""
    if value is None:
        return ""
    if name.startswith(_PERCENT):
        return f"{100 * value:z.2f} %"
    return f"{value:z.4f}" if name.startswith("exploitability") else f"{value:z.3f}"
