"""All baselines on all tasks of the suite: the leaderboard.

    python -m experiments.suite [--minutes M] [--tasks TASK …] [--methods METHOD …] [--budgets STROKES …] [--seeds N]
        [--workers N] [--out FOLDER] [--resume] [--json FILE]
    python -m experiments.suite --again NUMBER --json FILE

Every baseline and budget is a run of `python -m shuttle_marl.suite run` in a folder of its own; small budgets come first.
`--minutes` starts no run after so many; `--resume` continues, and skips the rows that are there. Each row is the summary of a
verified run with its commit. Boards in the documentation are made from them: `--json` keeps the rows in FILE of other boards,
and of other methods in the same units. `--again` finds rows of another game or commit, and rows that come out otherwise.
"""

import dataclasses
import itertools
import json as json_format
import math
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import tyro
from rich.console import Console

from experiments.saving import RunFolder, save_results
from shuttle_marl.base import runs
from shuttle_marl.base.cluster import in_processes
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.cli import run as run_command
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.suite import TASKS, SuiteRun, run_method, verify_run
from shuttle_marl.suite.exploit import opponent_of
from shuttle_marl.suite.method import BASELINES, kind_of
from shuttle_marl.suite.options import Split
from shuttle_marl.suite.results import Row, arena_of
from shuttle_marl.suite.task import frontier

VARIANTS: Final = {"adapt": ("restricted-nash:0.25", "restricted-nash:0.75", "counts:0.5", "mixture:0.9")}
"""Baselines with arguments, besides those without, by kind of task."""
LEFT_OUT: Final = ("restricted-nash",)  # methods that without an argument equal another one
QUICK: Final = {
    **dict.fromkeys(("exploit", "equilibrium", "adapt"), "minimax"),
    "offline": "clone",
    "evaluate": "weighted-importance-sampling",
}
"""Cheapest baseline of each kind of task."""
ROW: Final = "row.json"
_LONGEST: Final = 7200.0  # seconds of a row that is made again
_ALIKE: Final = 0.1  # points, and fraction of the score, by which machines may differ


@dataclasses.dataclass(frozen=True, kw_only=True)
class Suite(RunFolder):
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
    again: int | None = None
    """Make one row of each board of --json again, that of this number modulo its rows, and compare; nothing is written there."""
    minutes: float = math.inf
    """Start no run after so many minutes."""
    seeds: int | None = None
    """Seeds of each run; default: those of the task; references have one."""
    workers: int = os.cpu_count() or 1
    """Runs in parallel; does not change the results."""
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
        return {
            "split": self.split,
            "quick": self.quick,
            "seeds": self.seeds,
            "game": self.game,
            "game_hash": resolve_game(self.game).hash,
        }


def runs_of(config: Suite, folder: Path) -> list[SuiteRun]:
    """The runs, small budgets first."""
    found = []
    for name in config.tasks or TASKS:
        arena, kind = arena_of(TASKS[name], config.game, config.split, quick=config.quick), kind_of(name)
        plain = [method for method in BASELINES[kind] if method not in LEFT_OUT]
        methods = config.methods or ([QUICK[kind]] if config.quick else [*plain, *VARIANTS.get(kind, ())])
        for budget in {case.budget for case in TASKS[name].cases(arena)}:
            if not budget or not config.budgets or budget in config.budgets:
                found += [
                    SuiteRun(
                        task=name,
                        method=method,
                        split=config.split,
                        budget=budget or None,
                        quick=config.quick,
                        seeds=None if BASELINES[kind][method.partition(":")[0]].kind == "reference" else config.seeds,
                        game=config.game,
                        out=folder / name / f"{method}-{budget}".replace(":", "-"),
                    )
                    for method in methods
                ]
    return sorted(found, key=lambda options: options.budget or 0)


def run_one(options: SuiteRun) -> SuiteRun:
    """Run a method, verify it, and write its row."""
    assert options.out is not None
    run_method(dataclasses.replace(options, resume=(options.out / runs.CONFIG).exists()))
    found = verify_run(options.out, options.game)
    if found.summary is None:
        raise ShuttleError(f"{options.out}: {found.refused[0].reason}")
    git = runs.read_json(options.out / runs.MANIFEST, dict[str, Any])["git"]
    runs.write_json(options.out / ROW, {**found.summary, "author": "", "commit": git and git["commit"]})
    return options


def kept_rows(before: Sequence[Row], rows: Sequence[Row]) -> list[Row]:
    """Earlier rows that stay: of other boards, and of other methods in the same units."""

    def board(row: Row) -> tuple[Any, ...]:
        return row["task"], row["split"], row["budget"]

    cases = {board(row): row["cases"] for row in rows}
    again = {(*board(row), row["method"]) for row in rows}
    return [
        row for row in before if cases.get(board(row), row["cases"]) == row["cases"] and (*board(row), row["method"]) not in again
    ]


def frontiers(config: Suite, rows: Sequence[Row], before: dict[str, Any]) -> dict[str, Any]:
    """The frontier of every opponent of the tasks of ``exploit`` that the rows have; those of earlier rows in this game stay."""
    found = {}
    for name in {row["task"] for row in rows if kind_of(row["task"]) == "exploit" and not config.quick}:
        arena = arena_of(TASKS[name], config.game, config.split)
        if name in before["frontiers"] and {row["game"] for row in before["rows"] if row["task"] == name} == {arena.base}:
            continue
        opponents = {case.options["opponent"]: opponent_of(arena, case) for case in TASKS[name].cases(arena)}
        found[name] = {each: frontier(arena, opponent, tolerance=1e-5) for each, opponent in opponents.items()}
    return found


def foreign(rows: Sequence[Row]) -> list[str]:
    """What is wrong with rows that should be of the present game, and of one commit."""
    found = [
        f"{row['task']} {row['method']}: of the game {row['game'][:12]}, which is not the present one"
        for row in rows
        if row["game"] != arena_of(TASKS[row["task"]], "default", row["split"]).base
    ]
    commits = sorted({str(row.get("commit")) for row in rows})
    return found + ([f"rows of {len(commits)} commits: {', '.join(each[:12] for each in commits)}"] if len(commits) > 1 else [])


def made_again(config: Suite, before: Sequence[Row], folder: Path) -> list[str]:
    """Rows that differ when they are made again: one of each board."""
    assert config.again is not None
    boards: dict[tuple[str, str, int], list[Row]] = {}
    for row in before:
        if row["seconds"] < _LONGEST:
            boards.setdefault((row["task"], row["split"], row["budget"] or 0), []).append(row)
    found = []
    for those in boards.values():
        row = those[config.again % len(those)]
        out = folder / f"{row['task']}-{row['budget']}"
        again = SuiteRun(
            task=row["task"], method=row["method"], split=row["split"], budget=row["budget"], seeds=row["seeds"], out=out
        )
        run_one(dataclasses.replace(again, workers=config.workers, game=config.game))
        score = json_format.loads((out / ROW).read_text())["score"]
        if not abs(score - row["score"]) <= _ALIKE + _ALIKE * abs(row["score"]):
            found.append(f"{row['task']} {row['method']}, {row['budget']} strokes: {score:.4f}, not {row['score']:.4f}")
    return found


def suite(config: tyro.conf.OmitArgPrefixes[Suite], json: Path | None = None) -> None:
    """Run all baselines, and write their summaries.

    Args:
        config: what to run.
        json: write the results here too, with the rows that stay of those that it holds.
    """
    console, end = Console(stderr=True, highlight=False, soft_wrap=True), time.monotonic() + 60 * config.minutes
    with config.open("suite") as folder:
        before = json_format.loads(json.read_text()) if json is not None and json.exists() else {"rows": [], "frontiers": {}}
        if config.again is not None:
            if wrong := foreign(before["rows"]) or made_again(config, before["rows"], folder):
                raise ShuttleError("; ".join(wrong))
            return
        planned = runs_of(config, folder)
        waiting = [options for options in planned if not (options.out / ROW).exists()]  # type: ignore[operator]
        in_time = itertools.takewhile(lambda _: time.monotonic() < end, waiting)
        for options in in_processes(run_one, in_time, config.workers):
            console.print(f"{options.task} {options.method}, {options.budget or 'no'} strokes")
        rows: list[Row] = [json_format.loads(path.read_text()) for path in sorted(folder.glob(f"*/*/{ROW}"))]
        points = {**before["frontiers"], **frontiers(config, rows, before)}
        save_results(folder, {"rows": [*kept_rows(before["rows"], rows), *rows], "frontiers": points}, json)
    console.print(f"{len(rows)} of {len(planned)} runs are in {folder}; --resume continues them")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run_command(suite, prog="experiments.suite", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
