"""Boards of the benchmark suite, from ``experiments/results/suite.json``; rows of earlier games are left out."""

import functools
from collections.abc import Callable, Sequence
from typing import Final

from docs.tools.markdown import markdown, saved
from shuttle_marl.game.shipped import shipped_game
from shuttle_marl.suite.board import boards, called, number, render, with_interval
from shuttle_marl.suite.method import kind_of
from shuttle_marl.suite.options import ACCESS
from shuttle_marl.suite.results import TASKS, Row

_NONE: Final = (
    "`{task}` has no results in the present game yet: "
    "`python -m experiments.suite --tasks {task} --json experiments/results/suite.json`."
)
_SIMPLE: Final[dict[str, Sequence[str]]] = {
    "exploit": ("constant", "constant-by-incoming", "minimax", "restricted-bc", "ppo-self-play", "bc", "random"),
    "equilibrium": ("minimax-deterministic",),
    "offline": ("shipped-minimax", "shipped-best-response"),
    "evaluate": ("behaviour",),
    "adapt": ("minimax", "best-response-bc"),
}
"""Methods that should not be the best, by kind of task: lists, and those that ignore what they are given."""


def _rows(task: str) -> list[Row]:
    return [row for row in saved("experiments", "suite")["rows"] if row["task"] == task and shipped_game(row["game"]) is not None]


def task_boards(kind: str) -> str:
    """All boards of the tasks of a kind: the task and its entrance. What several boards have stands on the first."""
    names = [name for name in TASKS if kind_of(name) == kind]
    text = "\n\n".join(render(rows).strip() if (rows := _rows(name)) else _NONE.format(task=name) for name in names)
    parts = text.split("\n\n")
    lines = "\n\n".join(part for i, part in enumerate(parts) if part[0] in "#|" or part not in parts[:i]).split("\n")
    return "\n".join(line for i, line in enumerate(lines) if "| reference |" not in line or line not in lines[:i])


def summary() -> str:
    """One line for each task and each board of it with what it asks, and the best result from samples and with tables."""
    rows = []
    for name, task in TASKS.items():
        found, best = boards(_rows(name)), ("", "", "", "")
        if found:
            board = found[-1]
            ranked = [row for row in board["rows"] if row.get("rank") == 1 and row["access"] != ACCESS[-1]]
            budget = f"{ranked[0]['budget']:,}" if ranked and ranked[0]["budget"] else ""
            shown = {row["access"]: f"`{called(row)}` {with_interval(row['scores'][task.metric])}" for row in ranked}
            best = (budget, shown.get("samples", ""), shown.get("tables", ""), number(board["optimum"]))
        kind = "entrance" if task.entrance else ""
        score = f"{task.metric}, {task.unit}"
        rows.append((f"[`{name}`]({kind_of(name)}.md)", task.question, ", ".join(task.hidden), kind, score, *best))
    headings = ("task", "question", "hidden", "", "score", "strokes", "best from samples", "best with tables", "optimum")
    return markdown(headings, rows, left=("task", "question", "hidden", "", "score", "best from samples", "best with tables"))


def frontiers() -> str:
    """Score against exploitability of the restricted responses to the first opponent of the first task of ``exploit``."""
    for task, opponents in saved("experiments", "suite")["frontiers"].items():
        if _rows(task):
            points = next(iter(opponents.values()))
            figures = ("score", "exploitability", "gain")
            rows = [(f"{point['p']:g}", *(number(point[figure]) for figure in figures)) for point in points]
            return markdown(("restriction", *figures), rows, left=())
    return _NONE.format(task="exploit-v1")


def depth() -> str:
    """The best simple rule beside the best other method, on the boards of test."""
    lines = []
    for name, task in TASKS.items():
        for board in boards(_rows(name)) if not task.entrance else ():
            simple = _SIMPLE[kind_of(name)]
            best = sorted(board["rows"], key=lambda row: row["score"], reverse=task.higher_is_better)
            rule = next((row for row in best if row["method"] in simple), None)
            other = next((row for row in best if row["kind"] == "method" and row["method"] not in simple), None)
            if rule and other:
                figures = (f"`{called(row)}` {number(row['score'])}" for row in (rule, other))
                lines.append((f"`{board['title']}`", *figures, "yes" if best.index(other) < best.index(rule) else "no"))
    return markdown(("board", "best simple rule", "best other method", "the method is ahead"), lines, left=("board",))


BLOCKS: Final[dict[str, Callable[[], str]]] = {
    "suite_summary": summary,
    "suite_frontier": frontiers,
    "suite_depth": depth,
    **{f"suite_{kind}": functools.partial(task_boards, kind) for kind in dict.fromkeys(map(kind_of, TASKS))},
}
"""Tables by name."""
