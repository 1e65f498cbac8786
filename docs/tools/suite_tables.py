"""Boards of the benchmark suite, from ``experiments/results/suite.json``."""

import functools
from collections.abc import Callable
from typing import Final

from docs.tools.markdown import ROOT, markdown, saved
from shuttle_marl.suite.board import Board, boards, number, rating, with_interval
from shuttle_marl.suite.method import kind_of
from shuttle_marl.suite.registry import TASKS

_NONE: Final = "There are no results yet: `python -m experiments.suite --json experiments/results/suite.json` makes them."
_BY_CASE: Final = ("exploit-v0", "offline-v0")
"""Tasks with a table of each case."""
_PRELIMINARY: Final = "**Preliminary**: measured on another game than the frozen one."
_SHOWN: Final = 4
"""Number of further scores in a table."""


def _boards(name: str) -> list[Board]:
    """Boards of a task; empty as long as there are no results."""
    if not (ROOT / "experiments" / "results" / "suite.json").is_file():
        return []
    return [board for board in boards(saved("experiments", "suite")["rows"]) if board["task"] == name]


def _best(board: Board) -> str:
    """The optimum, the best method and the open gap."""
    metric, best = board["metric"], board["best"]
    text = "" if best is None else f"Best: `{best['method']}`, {with_interval(best['scores'][metric], metric)}. "
    if board["gap"] is not None:
        text += f"Optimum {number(board['optimum'], metric)}, open gap {number(board['gap'], metric)}. "
    return f"{text}Hard: {board['target']}." if board["target"] else text.strip()


def _table(board: Board) -> str:
    metric, columns = board["metric"], [name for name in board["columns"] if name != "worst"][:_SHOWN]
    rows = []
    for row in board["rows"]:
        scores = (number(row["scores"][name]["value"], name) if name in row["scores"] else "" for name in columns)
        checked = "yes" if row["verified"] else "no"
        apart = with_interval(row["behind"], metric) if "behind" in row else ""
        place = str(row.get("rank", row["kind"]))
        worst = number(row["worst"], metric)
        access = row["access"] + (", isolated" if row["isolated"] else "")
        figures = (with_interval(row["scores"][metric], metric), worst, apart, *scores, f"{row['seconds']:.0f}", checked)
        rows.append((access, place, f"`{row['method']}`", *figures))
    headings = ("access", "rank", "method", f"{metric} (95 %)", "worst", "behind the best", *columns, "seconds", "verified")
    table = markdown(headings, rows, left=("access", "rank", "method"))
    state = "" if board["frozen"] else f" {_PRELIMINARY}"
    return f"**{board['title']}**\n\n{table}\n\n{_best(board)}{state}"


def task_boards(name: str) -> str:
    """All boards of a task."""
    shown = [_table(board) + (_by_case(board) if name in _BY_CASE else "") for board in _boards(name)]
    return "\n\n".join(shown) or _NONE


def _by_case(board: Board) -> str:
    """Mean score of each method in each case, if there are several."""
    metric, first = board["metric"], board["rows"][0]["strata"]
    if len(first) < 2:
        return ""
    names = {case: f"`{case.partition('/')[0]}`" for case in first}
    rows = [(f"`{row['method']}`", *(number(row["strata"][case][metric], metric) for case in names)) for row in board["rows"]]
    return f"\n\nMean {metric} by case:\n\n" + markdown(("method", *names.values()), rows, left=("method",))


def summary(folder: str) -> str:
    """One line for each task: what it asks, and the best result.

    Args:
        folder: of the pages of the tasks, relative to that of the table.
    """
    rows = []
    for name, task in TASKS.items():
        question = (task.__doc__ or "").split("\n", 1)[0].rstrip(".")
        found = _boards(name)
        best = ("", "", "", "")
        if found and (row := found[-1]["best"]):
            last, metric = found[-1], task.metric
            gap = "" if last["gap"] is None else number(last["gap"], metric)
            budget = f"{last['budget']:,}" if last["budget"] else ""
            state = "" if last["frozen"] else ", preliminary"
            best = (budget, f"`{row['method']}`", f"{with_interval(row['scores'][metric], metric)}{state}", gap)
        rows.append((f"[`{name}`]({folder}{kind_of(name)}.md)", question, task.metric, *best))
    headings = ("task", "question", "score", "strokes", "best", "result", "open gap")
    return markdown(headings, rows, left=("task", "question", "score", "best"))


def frontiers() -> str:
    """Score against exploitability of the restricted responses, for each opponent of ``exploit``."""
    found = saved("experiments", "suite").get("frontiers", {})
    rows = [
        (f"`{name}`", f"{point['p']:g}", *(number(point[figure], figure) for figure in ("score", "exploitability", "objective")))
        for name, points in found.items()
        for point in points
    ]
    headings = ("opponent", "restriction", "score", "exploitability", "objective")
    return markdown(headings, rows, left=("opponent",)) if rows else _NONE


def ratings() -> str:
    """The rating of each method over all tasks."""
    found = [board for name in TASKS for board in _boards(name)]
    rows = [(f"`{name}`", f"{points:.0f}") for name, points in rating(found).items()]
    return markdown(("method", "rating"), rows, left=("method",)) if rows else _NONE


BLOCKS: Final[dict[str, Callable[[], str]]] = {
    "suite_summary": functools.partial(summary, ""),
    "suite_rating": ratings,
    "suite_frontier": frontiers,
    "suite_board": functools.partial(summary, "docs/suite/"),
    **{f"suite_{kind_of(name)}": functools.partial(task_boards, name) for name in TASKS},
}
"""Tables by name."""
