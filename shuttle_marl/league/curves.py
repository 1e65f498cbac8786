"""Learning curves of training runs."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from markupsafe import Markup

from shuttle_marl.base import runs
from shuttle_marl.league.entrants import LeagueError
from shuttle_marl.reports import charts

FIGURES: Final = {
    "exploitability": "exploitability",
    "normalised_score": "normalised score",
    "rally_win": "rallies won",
}
"""Names of the figures that are drawn, by their keys in the file."""
_NUMBER: Final = (int, float)
_LOGARITHMIC: Final = ("exploitability",)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Curve:
    """Evaluations of a training run."""

    name: str
    rows: list[dict[str, Any]]

    def points(self, figure: str, by: str) -> list[tuple[float, float]]:
        """Points of a figure over ``seconds`` or ``strokes``; rows without one of the two are left out."""
        return [
            (row[by], row[figure])
            for row in self.rows
            if isinstance(row.get(by), _NUMBER) and isinstance(row.get(figure), _NUMBER)
        ]

    def last(self, figure: str) -> float:
        """The last value of a figure; NaN without one."""
        found = [row[figure] for row in self.rows if isinstance(row.get(figure), _NUMBER)]
        return float(found[-1]) if found else math.nan


def read_curve(folder: Path, name: str) -> Curve:
    """Read the evaluations of a training run.

    Raises:
        LeagueError: they are damaged.
    """
    try:
        return Curve(name=name, rows=runs.Journal(folder / runs.METRICS).read())
    except runs.RunError as error:
        raise LeagueError(str(error)) from error


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
