"""Learning curves of training runs."""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, TypeGuard

from markupsafe import Markup

from shuttle_marl.base import runs
from shuttle_marl.base.files import MAX_LINES, problem, read_file
from shuttle_marl.league.entrants import LeagueError
from shuttle_marl.reports import charts

FIGURES: Final = {
    "exploitability": "exploitability",
    "normalised_score": "normalised score",
    "rally_win": "rallies won",
}
"""Names of the figures that are drawn, by their keys in the file."""
_LOGARITHMIC: Final = ("exploitability",)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Curve:
    """Evaluations of a training run."""

    name: str
    rows: list[dict[str, Any]]

    def points(self, figure: str, by: str) -> list[tuple[float, float]]:
        """Points of a figure over ``seconds`` or ``strokes``; rows without one of the two are left out."""
        spots = [(row.get(by), row.get(figure)) for row in self.rows]
        return [(float(x), float(y)) for x, y in spots if _finite(x) and _finite(y)]

    def last(self, figure: str) -> float:
        """The last value of a figure; NaN without one."""
        found = [row[figure] for row in self.rows if _finite(row.get(figure))]
        return float(found[-1]) if found else math.nan


def _finite(value: object) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def read_curve(folder: Path, name: str) -> Curve:
    """Read the evaluations of a training run.

    Raises:
        LeagueError: they are missing or damaged.
    """
    path = folder / runs.METRICS
    try:
        # The last line may be incomplete.
        lines = read_file(path, MAX_LINES).decode("utf-8").split("\n")[:-1]
        rows = [json.loads(line) for line in lines]
    except OSError as error:
        raise LeagueError(f"{path}: cannot be read ({problem(error)})") from error
    except (ValueError, RecursionError) as error:
        raise LeagueError(f"{path}: is damaged ({error or 'nested too deeply'})") from error
    if not all(isinstance(row, dict) for row in rows):
        raise LeagueError(f"{path}: is damaged (a line is not a JSON object)")
    return Curve(name=name, rows=rows)


def learning_charts(runs: Sequence[Curve]) -> list[tuple[str, Markup]]:
    """Captions and charts of all figures that the runs have, by strokes where all runs count them, else by time."""
    counted = all(run.points(figure, "strokes") for run in runs for figure in FIGURES if run.points(figure, "seconds"))
    by = "strokes" if counted else "seconds"
    found = []
    for figure, caption in FIGURES.items():
        lines = {run.name: run.points(figure, by) for run in runs}
        chart = charts.curves(lines, by, caption, logarithmic=figure in _LOGARITHMIC)
        if chart is not None:
            found.append((caption.capitalize(), chart))
    return found
