"""Figures that show whether the settings of the suite mean something in a game, to be looked at before tasks are frozen.

    python -m experiments.suite_settings [--tasks TASK …] [--opponents N] [--game GAME]

A row is a figure of cheap methods, the range in which the setting is useful, and whether the figure is in it. Change the setting,
or say why not, if it is not.
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
from shuttle_marl.suite.method import find
from shuttle_marl.suite.options import Split
from shuttle_marl.suite.population import FAMILIES
from shuttle_marl.suite.registry import arena_of
from shuttle_marl.suite.task import Arena, Case
from shuttle_marl.suite.text import POSITIONS, chosen_states, regrets

_LARGEST_LOG: Final = 10**5
HEADINGS: Final = ("task", "figure", "value", "useful", "")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Options of the measurement."""

    tasks: tuple[str, ...] = ()
    """Tasks; default: exploit, equilibrium, adapt, offline, evaluate and text."""
    split: Split = "test"
    """Part of the tasks."""
    opponents: int = 3
    """Opponents of each family of adapt."""
    seeds: int = 1
    """Seeds of logs."""
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
        """All cases, those of the smallest budget first."""
        return sorted(TASKS[self.name].cases(self.arena), key=lambda case: case.budget)

    def mean(self, method: str, cases: Sequence[Case], score: str) -> float:
        """Mean of a score over cases and seeds."""
        task, found = TASKS[self.name], []
        with tempfile.TemporaryDirectory() as folder:
            for case in cases:
                for seed in range(min(self.config.seeds, task.seeds)):
                    outcome = task.play(self.arena, case, find(task.name, method), seed, Path(folder))
                    found.append(task.score(self.arena, case, seed, outcome)[score])
        return float(np.mean(found))


def exploit(measure: Measure) -> Iterator[Figure]:
    """Constant lists should not solve the task."""
    for case in measure.cases[: len({case.options["opponent"] for case in measure.cases})]:
        for method in ("constant", "constant-by-incoming"):
            yield Figure(f"objective of {method}, {case.name}", measure.mean(method, [case], "objective"), -1e3, 0.9)


def equilibrium(measure: Measure) -> Iterator[Figure]:
    """The smallest budget should leave room, and the largest one should not."""
    yield Figure("exploitability of bc", measure.mean("bc", measure.cases[:1], "exploitability"), 0.1, 1)
    for case in measure.cases[:2]:
        yield Figure(f"exploitability of ppo, {case.name}", measure.mean("ppo", [case], "exploitability"), 0.001, 0.3)


def adapt(measure: Measure) -> Iterator[Figure]:
    """Neither a best response to bc nor perfect play should be good against a family."""
    for family in FAMILIES:
        cases = [case for case in measure.cases if case.stratum == family][: measure.config.opponents]
        for method in ("best-response-bc", "minimax"):
            yield Figure(f"regret of {method}, {family}", measure.mean(method, cases, "regret_500"), 0.005, 1)


def offline(measure: Measure) -> Iterator[Figure]:
    """Logs should be worth something, and leave room; the default shrinkage should be near the best one."""
    small = [case for case in measure.cases if case.budget <= _LARGEST_LOG]
    for case in small:
        yield Figure(f"score of one-step, {case.name}", measure.mean("one-step", [case], "score"), 0.05, 0.95)
    cases = [case for case in small if case.options["behaviour"] == "bc"]
    by_shrink = {shrink: measure.mean(f"model:{shrink}", cases, "score") for shrink in (8, 32, 128)}
    yield Figure("loss of the default shrinkage", max(by_shrink.values()) - by_shrink[32], 0, 0.05)


def evaluate(measure: Measure) -> Iterator[Figure]:
    """Policies that were trained on the same log should be judged worse than on a fresh one."""
    for log, low, high in (("same", 0.03, 1.0), ("fresh", -0.03, 0.03)):
        cases = [case for case in measure.cases if case.options["log"] == log][:1]
        yield Figure(f"bias of model, {log} log", measure.mean("model", cases, "bias_trained"), low, high)


def text(measure: Measure) -> Iterator[Figure]:
    """There should be enough hard positions, and named policies should lose in them."""
    arena, cases = measure.arena, measure.cases
    game, states = arena.game, chosen_states(arena)
    lost = regrets(game)
    yield Figure("positions", len(states), POSITIONS, POSITIONS)
    yield Figure("regret of the median stroke", float(np.mean([np.median(lost[game.pairs_of(s)]) for s in states])), 0.03, 1)
    for name in ("bc", "safe", "best-response:bc"):
        yield Figure(f"regret of {name}", measure.mean(f"policy:{name}", cases, "regret"), 0.005, 1)


FIGURES: Final = {
    "exploit-v0": exploit,
    "equilibrium-v0": equilibrium,
    "adapt-v0": adapt,
    "offline-v0": offline,
    "evaluate-v0": evaluate,
    "text-v0": text,
}


def settings(config: tyro.conf.OmitArgPrefixes[Settings]) -> None:
    """Measure, and print the table.

    Args:
        config: what is measured.
    """
    table, progress = Table(*HEADINGS), Console(stderr=True, highlight=False)
    for name in config.tasks or FIGURES:
        for figure in FIGURES[name](Measure(name, config)):
            useful = figure.low <= figure.value <= figure.high
            row = (name, figure.name, f"{figure.value:.3f}", f"{figure.low:g} to {figure.high:g}", "" if useful else "look")
            progress.print(*row, style="dim", markup=False)
            table.add_row(*row)
    Console(highlight=False, width=130).print(table)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run_command(settings, prog="experiments.suite_settings", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
