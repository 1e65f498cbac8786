"""Boards of the benchmark suite, from ``experiments/results/suite.json``; rows of earlier games are left out."""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from docs.tools.markdown import markdown, saved
from shuttle_marl.game.shipped import shipped_game
from shuttle_marl.suite.board import Board, boards, called, number, with_interval
from shuttle_marl.suite.method import kind_of
from shuttle_marl.suite.registry import TASKS

_NONE: Final = (
    "`{task}` has no results in the present game yet: "
    "`python -m experiments.suite --tasks {task} --json experiments/results/suite.json`."
)
_LOG: Final = 10**5
"""Strokes of the smallest log that has to be worth more than what is known before."""
_SIMPLE: Final[dict[str, Sequence[tuple[tuple[str, ...], str]]]] = {
    "exploit": [(("minimax", "ppo-self-play", "bc", "random"), "blind to the opponent")],
    "offline": [(("shipped-minimax", "shipped-best-response"), "which reads no log")],
    "evaluate": [(("behaviour",), "which reads no policy")],
    "adapt": [(tuple(f"mixture-without-{part}" for part in ("levels", "weights", "places", "change")), "an ablation")],
}
"""Methods that should not be the best, by kind of task."""
_SHOWN: Final = 4
"""Number of further scores in a table."""


def _all_boards() -> list[Board]:
    return boards([row for row in saved("experiments", "suite")["rows"] if shipped_game(row["game"]) is not None])


def _boards(name: str) -> list[Board]:
    """Boards of a task; empty as long as there are no results."""
    return [board for board in _all_boards() if board["task"].name == name]


def _table(board: Board) -> str:
    task, metric, columns = board["task"], board["task"].metric, board["columns"][:_SHOWN]
    rows = []
    for row in board["rows"]:
        scores = (number(row["scores"][name]["value"]) if name in row["scores"] else "" for name in columns)
        apart = with_interval(row["behind"]) if "behind" in row else ""
        place = str(row.get("rank", row["kind"]))
        figures = (with_interval(row["scores"][metric]), number(row["worst"]), apart, *scores)
        rows.append((row["access"], place, f"`{called(row)}`", *figures, str(row["seeds"]), f"{row['seconds']:.0f}"))
    headings = ("access", "rank", "method", f"{metric} (95 %)", "worst", "behind the best", *columns, "seeds", "seconds")
    table = markdown(headings, rows, left=("access", "rank", "method"))
    gap = "" if board["gap"] is None else f", open gap {number(board['gap'])}"
    best = "" if board["best"] is None else f" Best: `{called(board['best'])}`{gap}."
    return f"**{board['title']}** (`{metric}` in {task.unit}; 0: {task.zero})\n\n{table}\n\nSelf-reported.{best}"


def task_boards(kind: str) -> str:
    """All boards of the tasks of a kind: the task and its entrance."""
    names = [name for name in TASKS if kind_of(name) == kind]
    return "\n\n".join(text for name in names for text in [*map(_table, _boards(name))] or [_NONE.format(task=name)])


def summary() -> str:
    """One line for each task: what it asks, and the best result."""
    rows = []
    for name, task in TASKS.items():
        question = (task.__doc__ or "").split("\n", 1)[0].rstrip(".").replace("``", "`")
        found, best = _boards(name), ("", "", "", "")
        if found and (row := found[-1]["best"]):
            last = found[-1]
            gap = "" if last["gap"] is None else number(last["gap"])
            budget = f"{last['budget']:,}" if last["budget"] else ""
            best = (budget, f"`{called(row)}`", with_interval(row["scores"][task.metric]), gap)
        kind = "entrance" if task.entrance else ""
        score = f"{task.metric}, {task.unit}"
        rows.append((f"[`{name}`]({kind_of(name)}.md)", question, ", ".join(task.hidden), kind, score, *best))
    headings = ("task", "question", "hidden", "", "score", "strokes", "best", "result", "open gap")
    return markdown(headings, rows, left=("task", "question", "hidden", "", "score", "best"))


def frontiers() -> str:
    """Score against exploitability of the restricted responses, for each opponent of the tasks of ``exploit``."""
    rows = [
        (f"`{task}`", f"`{name}`", f"{point['p']:g}", *(number(point[figure]) for figure in ("score", "exploitability", "gain")))
        for task, opponents in saved("experiments", "suite")["frontiers"].items()
        if _boards(task)
        for name, points in opponents.items()
        for point in points
    ]
    headings = ("task", "opponent", "restriction", "score", "exploitability", "gain")
    return markdown(headings, rows, left=("task", "opponent")) if rows else _NONE.format(task="exploit-v0")


def depth() -> str:
    """What simple rules and ablations reach beside the best method, in the range in which a task means something."""
    lines = []
    for board in _all_boards():
        if board["split"] == "test" and not board["task"].entrance:
            lines += [(f"`{board['title'].replace(', test', '')}`", *figure) for figure in _depth(board)]
    return markdown(("board", "figure", "points or share", "useful", "holds"), lines, left=("board", "figure", "useful"))


def _depth(board: Board) -> Iterator[tuple[str, str, str, str]]:
    rows, kind = {row["method"]: row for row in board["rows"]}, kind_of(board["task"].name)
    if kind == "exploit":
        lists = [rows[name] for name in ("constant", "constant-by-incoming") if name in rows]
        if shares := [each["gain"] / each["best"] for row in lists for each in row["strata"].values()]:
            share = max(shares)
            yield "highest share of the largest gain of a list, of any opponent", number(share), "at most 0.9", _yes(share <= 0.9)
    if kind == "equilibrium" and (row := rows.get("minimax-deterministic")):
        yield "exploitability of deterministic perfect play", number(row["score"]), "at least 2", _yes(row["score"] >= 2)
    for names, what in _SIMPLE.get(kind, ()):
        if board["task"].name == "offline-v0" and board["budget"] < _LOG:
            continue
        sign = 1 if board["task"].higher_is_better else -1
        others = [sign * row["score"] for name, row in rows.items() if row["kind"] == "method" and name not in names]
        simple = [(sign * row["score"], name) for name, row in rows.items() if name in names]
        if others and simple:
            above, name = max(simple)[0] - max(others), max(simple)[1]
            yield f"`{name}`, {what}, above the best other method", number(above), "below 0", _yes(above < 0)


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


BLOCKS: Final[dict[str, Callable[[], str]]] = {
    "suite_summary": summary,
    "suite_frontier": frontiers,
    "suite_depth": depth,
    **{f"suite_{kind}": functools.partial(task_boards, kind) for kind in dict.fromkeys(map(kind_of, TASKS))},
}
"""Tables by name."""
