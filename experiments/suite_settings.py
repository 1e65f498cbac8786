"""Depth of the tasks: figures of simple rules and of cheap methods, exact, with the range in which a task means something.

    python -m experiments.suite_settings [--tasks TASK …] [--game GAME]

A row is a figure, the range, and whether the figure is in it. Change the setting of a task, or call it an entrance, if it is not.
"""

import dataclasses
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from shuttle_marl.commands.cli import run as run_command
from shuttle_marl.suite import TASKS
from shuttle_marl.suite.method import find, kind_of
from shuttle_marl.suite.options import Split
from shuttle_marl.suite.registry import arena_of
from shuttle_marl.suite.task import Arena, Case

HEADINGS: Final = ("task", "figure", "value", "useful", "")
_LOG: Final = 10**5


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Options of the measurement."""

    tasks: tuple[str, ...] = ("exploit-v0", "equilibrium-v0", "adapt-v0", "offline-v0", "evaluate-v0")
    """Tasks."""
    split: Split = "test"
    """Part of the tasks."""
    opponents: int = 1
    """Opponents of each family of adapt."""
    game: str = "default"
    """Model of the game."""


class Figure(NamedTuple):
    """A figure, and the range in which it is useful."""

    name: str
    value: float
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Measure:
    """Scores of methods in cases of a task."""

    name: str
    config: Settings

    @property
    def arena(self) -> Arena:
        """Game and split."""
        return arena_of(TASKS[self.name], self.config.game, self.config.split)

    @property
    def cases(self) -> list[Case]:
        """All cases that count, those of the smallest budget first."""
        return sorted((case for case in TASKS[self.name].cases(self.arena) if case.counts), key=lambda case: case.budget)

    def mean(self, method: str, cases: Sequence[Case], *scores: str) -> list[float]:
        """Means of scores over cases, with seed 0."""
        task, found = TASKS[self.name], []
        with tempfile.TemporaryDirectory() as folder:
            for number, case in enumerate(cases):
                place = Path(folder) / str(number)
                place.mkdir()
                outcome = task.play(self.arena, case, find(task.name, method), 0, place)
                every = task.score(self.arena, case, 0, outcome)
                found.append([every[score] for score in scores])
        return [float(column) for column in np.mean(found, axis=0)]


def exploit(measure: Measure) -> Iterator[Figure]:
    """Lists of strokes should be far from the optimum, in part because a best response is beaten in turn."""
    for case in measure.cases[: len({case.options["opponent"] for case in measure.cases})]:
        for method in ("constant", "constant-by-incoming", "best-response"):
            gain, best = measure.mean(method, [case], "gain", "best")
            yield Figure(f"gain of {method}, {case.name}, as a share of {best:.2f} points", gain / best, -1e3, 0.9)


def equilibrium(measure: Measure) -> Iterator[Figure]:
    """Perfect play should have to mix."""
    (risk,) = measure.mean("minimax-deterministic", measure.cases[:1], "exploitability")
    yield Figure("exploitability of perfect play made deterministic", risk, 2, 50)
    (risk,) = measure.mean("bc", measure.cases[:1], "exploitability")
    yield Figure("exploitability of bc", risk, 5, 50)


def adapt(measure: Measure) -> Iterator[Figure]:
    """A response to bc that never changes should not be good against a family."""
    for family in dict.fromkeys(case.stratum for case in measure.cases):
        cases = [case for case in measure.cases if case.stratum == family][: measure.config.opponents]
        gain, best = measure.mean("restricted-nash:0.75", cases, "gain", "best")
        yield Figure(f"gain of the response to bc, {family}, as a share of {best:.2f} points", gain / best, -1e3, 0.9)


def offline(measure: Measure) -> Iterator[Figure]:
    """A policy that reads no log should be worth less than the best from 10^5 strokes."""
    cases = [case for case in measure.cases if case.budget == _LOG and case.options["behaviour"] == "bc"]
    (learned,) = measure.mean("model-boosted", cases, "score")
    for name in ("shipped-minimax", "shipped-best-response"):
        (known,) = measure.mean(name, cases, "score")
        yield Figure(f"points of {name} above model-boosted, 10^5 strokes", known - learned, -50, 0)


def evaluate(measure: Measure) -> Iterator[Figure]:
    """Policies that were trained on the same log should be judged worse than on a fresh one."""
    for log, low, high in (("same", 3.0, 100.0), ("fresh", -3.0, 3.0)):
        cases = [case for case in measure.cases if case.options["log"] == log][:1]
        (bias,) = measure.mean("model", cases, "bias_trained")
        yield Figure(f"bias of model, {log} log", bias, low, high)


FIGURES: Final = {"exploit": exploit, "equilibrium": equilibrium, "adapt": adapt, "offline": offline, "evaluate": evaluate}


def settings(config: tyro.conf.OmitArgPrefixes[Settings]) -> None:
    """Measure, and print the table.

    Args:
        config: what is measured.
    """
    table, progress = Table(*HEADINGS), Console(stderr=True, highlight=False)
    for name in config.tasks:
        for figure in FIGURES[kind_of(name)](Measure(name, config)):
            useful = figure.low <= figure.value <= figure.high
            row = (name, figure.name, f"{figure.value:.3f}", f"{figure.low:g} to {figure.high:g}", "" if useful else "look")
            progress.print(*row, style="dim", markup=False)
            table.add_row(*row)
    Console(highlight=False, width=150).print(table)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run_command(settings, prog="experiments.suite_settings", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
