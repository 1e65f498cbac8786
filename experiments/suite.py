"""All baselines on all tasks of the suite: the leaderboard.

    python -m experiments.suite [--plan] [--minutes M] [--tasks TASK …] [--methods METHOD …] [--budgets STROKES …] [--workers N]
        [--out FOLDER] [--resume] [--json FILE]

Every baseline and budget is a run of `python -m shuttle_marl.suite run` in a folder of its own; the cheapest runs come first.
`--plan` prints them with their estimated times. `--minutes` starts no run that would end later; `--resume` continues, and skips
the rows that are there. Each row is the summary of a run with its commit. Boards in the documentation are made from them:
`--json` keeps the rows in FILE of other boards, and of other methods in the same units.
"""

import dataclasses
import json as json_format
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import tyro
from rich.console import Console

from experiments.saving import Study, save_results
from shuttle_marl.base import runs
from shuttle_marl.base.cluster import in_processes
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.cli import run as run_command
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.suite import TASKS, SuiteRun, difference, run_method, summarise, verify_run
from shuttle_marl.suite.board import boards
from shuttle_marl.suite.exploit import opponent_of
from shuttle_marl.suite.frontier import Point, frontier
from shuttle_marl.suite.method import BASELINES, baseline_of, kind_of
from shuttle_marl.suite.options import Split, VerifyOptions
from shuttle_marl.suite.registry import arena_of
from shuttle_marl.suite.results import Row

VARIANTS: Final = {
    "adapt": ("restricted-nash:0.25", "restricted-nash:0.75", "counts:0.5", "mixture:0.9"),
    "text": tuple(f"policy:{name}" for name in ("bc", "safe", "human:0.05", "best-response:bc", "minimax")),
}
"""Baselines with arguments, besides those without, by kind of task."""
LEFT_OUT: Final = {
    "text-v0": ("policy", "chat"),
    "adapt-v0": ("restricted-nash",),
    "adapt-entrance-v0": ("restricted-nash",),
}
"""Methods that need an argument, equal another one without, or do not play the task."""
QUICK: Final = {
    "exploit": "minimax",
    "equilibrium": "minimax",
    "adapt": "minimax",
    "offline": "clone",
    "evaluate": "weighted-importance-sampling",
    "text": "random",
}
"""Cheapest baseline of each kind of task."""
UNIT: Final = {"exploit-v0": 12.0, "equilibrium-v0": 4.0, "adapt-v0": 4.0, "adapt-entrance-v0": 6.0, "evaluate-v0": 3.0}
"""Seconds of a unit besides the method, on one core of the machine of the committed results; of other tasks: 2."""
METHOD: Final = {
    "mixture": 15.0, "tilts": 25.0, "likeliest": 10.0, "posterior-mean": 12.0, "counts": 12.0, "bandit": 2.0, "bayes": 2.0,
    "thompson": 2.0, "constant": 6.0, "constant-by-incoming": 8.0,
    "fictitious-play": 60.0, "psro-exact": 300.0, "iql": 8.0, "fitted-q-boosted": 15.0,
    "model-boosted": 30.0, "doubly-robust": 5.0, "weighted-doubly-robust": 5.0, "fitted-q-evaluation": 5.0,
    "restricted-counts": 8.0,
}  # fmt: skip
"""Seconds of a method in a unit, if more than half of one; a name also stands for those that begin with it and a hyphen."""
SPEED: Final = {"ppo": 2.5e5, "a2c": 2.5e5, "sac": 1e5, "psro": 1e5}
"""Strokes of the budget trained in a second, on the same machine; methods that are not listed do not train."""
ROW: Final = "row.json"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Suite(Study):
    """Settings of the experiment."""

    tasks: tuple[str, ...] = ()
    """Tasks; default: all."""
    methods: tuple[str, ...] = ()
    """Methods, for one task; default: all baselines."""
    budgets: tuple[int, ...] = ()
    """Budgets, in strokes; default: all."""
    split: Split = "test"
    """Part of the tasks."""
    quick: bool = False
    """The cheapest baseline of each task in its smallest case: a smoke test without meaningful results."""
    plan: bool = False
    """Print the runs and their estimated times, and run none."""
    minutes: float | None = None
    """Start no run that is estimated to end later; default: run all."""
    workers: int = os.cpu_count() or 1
    """Runs in parallel; does not change the results."""
    verify: bool = True
    """Recompute all scores from the stored policies."""
    game: str = "default"
    """Model of the game."""

    def __post_init__(self) -> None:
        unknown = [name for name in self.tasks if name not in TASKS]
        if unknown:
            raise ShuttleError(f"--tasks {' '.join(unknown)}: expected some of {', '.join(TASKS)}")
        if self.methods and len(self.tasks) != 1:
            raise ShuttleError("--methods: expected with one of --tasks")

    def fixed(self) -> dict[str, Any]:
        """Settings that every run has in common, as JSON."""
        return {"split": self.split, "quick": self.quick, "game": self.game, "game_hash": resolve_game(self.game).hash}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Job:
    """A run of the experiment.

    Attributes:
        options: of the run.
        seconds: estimated time on one core.
        verify: recompute the scores.
    """

    options: SuiteRun
    seconds: float
    verify: bool


def jobs_of(config: Suite, folder: Path) -> list[Job]:
    """The runs, cheapest first."""
    found = []
    for name in config.tasks or TASKS:
        task = TASKS[name]
        arena = arena_of(task, config.game, config.split, quick=config.quick)
        kind = kind_of(name)
        plain = [method for method in BASELINES[kind] if method not in LEFT_OUT.get(name, ())]
        methods = config.methods or ([QUICK[kind]] if config.quick else [*plain, *VARIANTS.get(kind, ())])
        cases = task.cases(arena)
        for budget in sorted({case.budget for case in cases}):
            units = sum(case.budget == budget for case in cases)
            if budget and config.budgets and budget not in config.budgets:
                continue
            for method in methods:
                baseline = baseline_of(name, method)
                fixed = baseline is not None and baseline.kind == "reference"
                seeds = 1 if config.quick or fixed else task.seeds
                seconds = UNIT.get(name, 2.0) + _of(METHOD, method, 0.5)
                if _of(SPEED, method, 0) and not fixed:
                    seconds += budget / _of(SPEED, method, 0)
                options = SuiteRun(
                    task=name,
                    method=method,
                    split=config.split,
                    budget=budget or None,
                    seeds=seeds,
                    quick=config.quick,
                    game=config.game,
                    out=folder / name / f"{method}-{budget}".replace(":", "-"),
                )
                found.append(Job(options=options, seconds=units * seeds * seconds, verify=config.verify))
    return sorted(found, key=lambda job: job.seconds)


def _of(numbers: Mapping[str, float], method: str, otherwise: float) -> float:
    """The number of a method, or of the longest name that begins its name."""
    name = method.partition(":")[0]
    found = [key for key in numbers if name == key or name.startswith(f"{key}-")]
    return numbers[max(found, key=len)] if found else otherwise


def run_job(job: Job) -> tuple[Job, float]:
    """Run a method, verify it, and write its row; returns the seconds taken."""
    begun, options = time.monotonic(), job.options
    assert options.out is not None
    run_method(dataclasses.replace(options, resume=(options.out / runs.CONFIG).exists()))
    same = not verify_run(options.out, VerifyOptions(game=options.game)).refused if job.verify else None
    runs.write_json(options.out / ROW, {**summarise(options.out, game=options.game), "recomputed": same})
    return job, time.monotonic() - begun


def rows_of(folder: Path) -> list[Row]:
    """The rows of all finished runs."""
    rows: list[Row] = []
    for path in sorted(folder.glob(f"*/*/{ROW}")):
        about = json_format.loads((path.parent / runs.MANIFEST).read_text())
        row: Row = json_format.loads(path.read_text())
        rows.append({**row, "commit": about["git"] and about["git"]["commit"]})
    return rows


def compared(rows: list[Row]) -> list[Row]:
    """Rows with the paired difference to the best method of the board, where the units are the same."""
    for board in boards(rows):
        best = board["best"]
        for row in board["rows"]:
            row.pop("behind", None)
            if best and row is not best and row["seeds"] == best["seeds"]:
                row["behind"] = difference(best, row)
    return rows


def kept_rows(path: Path | None, rows: Sequence[Row]) -> list[Row]:
    """Rows in a file of results that stay: of other boards, and of other methods in the same units."""
    if path is None or not path.exists():
        return []

    def board(row: Row) -> tuple[Any, ...]:
        return row["task"], row["split"], row["budget"]

    cases = {board(row): row["cases"] for row in rows}
    again = {(*board(row), row["method"]) for row in rows}
    before: list[Row] = json_format.loads(path.read_text())["rows"]
    return [
        row for row in before if cases.get(board(row), row["cases"]) == row["cases"] and (*board(row), row["method"]) not in again
    ]


def frontiers(config: Suite, path: Path | None, rows: Sequence[Row]) -> dict[str, dict[str, list[Point]]]:
    """The frontier of every opponent of the tasks of ``exploit`` that the rows have; of others those in the file of results."""
    before = json_format.loads(path.read_text()) if path is not None and path.exists() else {}
    found = dict(before.get("frontiers", {}))
    for name in {row["task"] for row in rows if kind_of(row["task"]) == "exploit" and not config.quick}:
        arena = arena_of(TASKS[name], config.game, config.split)
        opponents = {case.options["opponent"]: opponent_of(arena, case) for case in TASKS[name].cases(arena)}
        found[name] = {each: frontier(arena, opponent, tolerance=1e-5) for each, opponent in opponents.items()}
    return found


def suite(config: tyro.conf.OmitArgPrefixes[Suite], json: Path | None = None) -> None:
    """Run all baselines, and write their summaries.

    Args:
        config: what to run.
        json: write the results here too, with the rows that stay of those that it holds.
    """
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    if config.plan:
        planned = jobs_of(config, Path())
        for job in planned:
            console.print(_line(job, f"{job.seconds / 60:.1f} min"))
        console.print(f"{len(planned)} runs, {sum(job.seconds for job in planned) / 60:.0f} minutes on one core")
        return
    with config.open("suite") as folder:
        waiting = [job for job in jobs_of(config, folder) if not (job.options.out / ROW).exists()]  # type: ignore[operator]
        begun, spent, estimated, started = time.monotonic(), 0.0, 0.0, 0

        def in_time() -> Iterator[Job]:
            nonlocal started
            for job in waiting:
                # Estimates are corrected by how long the runs before took.
                pace = spent / estimated if estimated else 1.0
                if config.minutes is None or time.monotonic() - begun + pace * job.seconds < 60 * config.minutes:
                    started += 1
                    yield job

        for job, seconds in in_processes(run_job, in_time(), config.workers):
            spent, estimated = spent + seconds, estimated + job.seconds
            console.print(_line(job, f"{seconds / 60:.1f} min, estimated {job.seconds / 60:.1f}"))
        rows = rows_of(folder)
        everything = compared([*kept_rows(json, rows), *rows])
        save_results(folder, {"rows": everything, "frontiers": frontiers(config, json, rows)}, json)
    left = f"; {len(waiting) - started} are left, --resume starts them" if started < len(waiting) else ""
    console.print(f"{len(rows)} runs are in {folder}{left}")


def _line(job: Job, took: str) -> str:
    options = job.options
    return f"{options.task} {options.method}{'' if options.budget is None else f' {options.budget:,} strokes'}: {took}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run_command(suite, prog="experiments.suite", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
