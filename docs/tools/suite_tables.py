"""Boards of the benchmark suite, from ``experiments/results/suite.json``."""

import functools
from collections.abc import Callable
from typing import Any, Final

from docs.tools.markdown import ROOT, markdown, saved
from shuttle_marl.suite import frozen
from shuttle_marl.suite.board import boards, number
from shuttle_marl.suite.method import kind_of
from shuttle_marl.suite.registry import TASKS

_NONE: Final = "There are no results yet: `python -m experiments.suite --json experiments/results/suite.json` makes them."
_BY_CASE: Final = ("exploit-v0", "offline-v0")
"""Tasks with a table of each case."""
_PRELIMINARY: Final = (
    "**Preliminary**: measured on the game before the frozen one, in which net kills from the back line were legal."
)
_SHOWN: Final = 4
"""Number of further scores in a table."""


def _boards(name: str) -> list[dict[str, Any]]:
    """Boards of a task; empty as long as there are no results. Those of another game than the frozen one are not official."""
    if not (ROOT / "experiments" / "results" / "suite.json").is_file():
        return []
    rows = saved("experiments", "suite")["rows"]
    current = [{**row, "official": row["official"] and frozen.load().official(row["game"])} for row in rows]
    return [board for board in boards(current) if board["task"] == name]


def _with_interval(row: dict[str, Any], metric: str) -> str:
    value = number(row["score"], metric)
    return value if row["low"] is None else f"{value} ({number(row['low'], metric)} to {number(row['high'], metric)})"


def _best(board: dict[str, Any]) -> str:
    """The optimum, the best learned method and the open gap."""
    metric, best = board["metric"], board["best"]
    text = "" if best is None else f"Best learned: `{best['method']}`, {_with_interval(best, metric)}. "
    if board["gap"] is not None:
        text += f"Optimum {number(board['optimum'], metric)}, open gap {number(board['gap'], metric)}. "
    return f"{text}Hard: {board['target']}." if board["target"] else text.strip()


def _table(board: dict[str, Any]) -> str:
    metric, columns = board["metric"], board["columns"][:_SHOWN]
    rows = []
    for row in board["rows"]:
        scores = (number((row["scores"].get(name) or {}).get("value"), name) for name in columns)
        checked = "yes" if row["verified"] else "no"
        behind = row.get("behind")
        apart = "" if behind is None else _with_interval({**behind, "score": behind["value"]}, metric)
        rows.append((f"`{row['method']}`", _with_interval(row, metric), apart, *scores, f"{row['seconds']:.0f}", checked))
    headings = ("method", f"{metric} (95 %)", "behind the best learned", *columns, "seconds", "verified")
    table = markdown(headings, rows, left=("method",))
    state = "" if board["official"] else f" {_PRELIMINARY}"
    return f"**{board['title']}**\n\n{table}\n\n{_best(board)}{state}"


def task_boards(name: str) -> str:
    """All boards of a task."""
    shown = [_table(board) + (_by_case(board) if name in _BY_CASE else "") for board in _boards(name)]
    return "\n\n".join(shown) or _NONE


def _by_case(board: dict[str, Any]) -> str:
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
            state = "" if last["official"] else ", preliminary"
            best = (budget, f"`{row['method']}`", f"{_with_interval(row, metric)}{state}", gap)
        rows.append((f"[`{name}`]({folder}{kind_of(name)}.md)", question, task.metric, *best))
    headings = ("task", "question", "score", "strokes", "best learned", "result", "open gap")
    return markdown(headings, rows, left=("task", "question", "score", "best learned"))


BLOCKS: Final[dict[str, Callable[[], str]]] = {
    "suite_summary": functools.partial(summary, ""),
    "suite_board": functools.partial(summary, "docs/suite/"),
    **{f"suite_{kind_of(name)}": functools.partial(task_boards, name) for name in TASKS},
}
"""Tables by name."""
