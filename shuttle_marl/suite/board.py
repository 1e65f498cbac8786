"""The leaderboard as Markdown and HTML, from the summaries of runs."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import jinja2

from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import FileReadError, read_json
from shuttle_marl.league.report import escaped
from shuttle_marl.policy.baselines import STYLES
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.registry import TASKS
from shuttle_marl.suite.results import summarise
from shuttle_marl.suite.store import read_card
from shuttle_marl.suite.verify import verify_run

_TEMPLATES: Final = Path(__file__).parent / "templates"
_PERCENT: Final = ("regret", "rally_win", "error", "bias", "legal", "away")
"""Beginnings of the names of scores that are printed in per cent."""
_REFERENCES: Final = (
    "best-response",
    "minimax",
    "bc",
    "random",
    "constant",
    "constant-by-incoming",
    "fictitious-play",
    "psro-exact",
    "human",
    *STYLES,
)
"""Methods and policies that read the tables or do not learn; they are not counted as the best baseline."""
_ABLATION: Final = "-without-"
"""Part of the names of ablations, which are not counted either: to take the best of them would be a choice by the test score."""


def render(summaries: Sequence[Mapping[str, Any]], kind: Literal["md", "html"]) -> str:
    """The board.

    Args:
        summaries: outputs of :func:`shuttle_marl.suite.results.summarise`, with ``verified``: True, False, or None if unknown.
        kind: Markdown or HTML.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES), autoescape=kind == "html", trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["text"] = printable if kind == "html" else escaped
    environment.filters["number"] = number
    return environment.get_template(f"board.{kind}").render(boards=boards(summaries)) + "\n"


def rows_of(
    folders: Sequence[Path],
    results: Path | None = None,
    *,
    check: bool = True,
    game: str | None = None,
    progress: Callable[[Any], Any] = lambda units: units,
    failed: Callable[[SuiteError], object],
) -> list[dict[str, Any]]:
    """Summaries of run folders and of a file of results, for :func:`render`.

    Args:
        folders: run folders.
        results: JSON file with ``rows``; None: none.
        check: verify the folders.
        game: model of the game; None: the shipped model that a run names.
        progress: wraps the units of a folder.
        failed: receives the error of each folder that holds no finished run; the board does without it.

    Raises:
        SuiteError: the file cannot be read.
    """
    rows = []
    for folder in folders:
        try:
            row = summarise(folder, game=game)
            verified = all(each.reason is None for each in verify_run(folder, game=game, progress=progress)) if check else None
        except SuiteError as error:
            failed(error)
        else:
            rows.append({**row, "tuning_strokes": read_card(folder).get("tuning_strokes"), "verified": verified})
    if results is not None:
        try:
            rows += read_json(results, _Results).rows
        except FileReadError as error:
            raise SuiteError(f"{results}: {error}") from error
    return rows


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Results:
    rows: list[dict[str, Any]]


def boards(summaries: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Title, columns, rows and open gap of each task, split and budget, best method first."""
    found = []
    for name, task in TASKS.items():
        of_task = [row for row in summaries if row["task"] == name]
        parts = {(task.splits.index(row["split"]), row["budget"] or 0) for row in of_task}
        for number, budget in sorted(parts):
            split = task.splits[number]
            rows = [row for row in of_task if (row["split"], row["budget"] or 0) == (split, budget)]
            rows.sort(key=lambda row: -row["score"] if task.higher_is_better else row["score"])
            learned = [row for row in rows if row["verified"] is not False and _counts(row["method"])]
            gap = abs(task.optimum - learned[0]["score"]) if learned and task.optimum is not None else None
            columns = list(dict.fromkeys(score for row in rows for score in row["scores"] if score != task.metric))
            found.append({
                "task": name,
                "split": split,
                "budget": budget,
                "title": f"{name}, {split}" + (f", {budget:,} strokes" if budget else ""),
                "about": " ".join((task.__doc__ or "").split()),
                "metric": task.metric,
                "optimum": task.optimum,
                "target": task.target,
                "best": learned[0] if learned else None,
                "gap": gap,
                "columns": columns,
                "rows": rows,
                "official": all(row["official"] for row in rows),
            })  # fmt: skip
    return found


def _counts(method: str) -> bool:
    name = method.removeprefix("policy:").partition(":")[0]
    return name not in _REFERENCES and _ABLATION not in method


def number(value: float | None, name: str = "") -> str:
    """A score as text, in per cent if its name says so."""
    if value is None:
        return ""
    if name.startswith(_PERCENT):
        return f"{100 * value:.2f} %"
    return f"{value:.4f}" if name.startswith("exploitability") else f"{value:.3f}"
