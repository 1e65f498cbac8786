"""All baselines on all tasks of the suite: the leaderboard.

    python -m experiments.suite [--quick] [--tasks TASK …] [--workers N] [--data DATA] [--out FOLDER] [--resume] [--json FILE]

Every baseline is a run of `python -m shuttle_marl.suite run`, in a folder of its own, which `--resume` continues. Each row of the
result is the summary of a run; with the frozen game, the board in the documentation is made from it.
"""

import dataclasses
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import tyro
from rich.console import Console

from experiments.saving import save_results
from shuttle_marl import runs
from shuttle_marl.commands.cli import run as run_command
from shuttle_marl.errors import ShuttleError
from shuttle_marl.suite import TASKS, SuiteRun, run_method, summarise, verify_run
from shuttle_marl.suite.methods import BASELINES, kind_of
from shuttle_marl.suite.task import Split

VARIANTS: Final = {
    "adapt-v0": ("restricted-nash:0.25", "restricted-nash:0.5", "restricted-nash:0.75", "counts:0.8", "tilt:0.8"),
    "offline-v0": ("fitted-q:8", "model:8"),
    "robust-v0": ("human:0.1",),
    "text-v0": ("policy:bc", "policy:safe", "policy:human:0.05", "policy:best-response:bc", "policy:minimax"),
    "imitate-v0": ("counts:8", "policy:human:0.05", "policy:minimax"),
}
"""Baselines with arguments, besides those without."""
LEFT_OUT: Final = {"text-v0": ("policy", "chat"), "imitate-v0": ("policy",)}
"""Methods that need an argument."""
QUICK: Final = {
    "exploit-v0": "constant",
    "equilibrium-v0": "minimax",
    "adapt-v0": "minimax",
    "offline-v0": "clone",
    "evaluate-v0": "weighted-importance-sampling",
    "imitate-v0": "bc",
    "robust-v0": "minimax",
    "text-v0": "random",
}
"""Cheapest baseline of each task."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Suite:
    """Settings of the experiment."""

    tasks: tuple[str, ...] = ()
    """Tasks; default: all, imitate-v0 only with --data."""
    methods: tuple[str, ...] = ()
    """Methods, for one task; default: all baselines."""
    split: Split = "test"
    """Part of the tasks."""
    quick: bool = False
    """The cheapest baseline of each task in its smallest case: a smoke test without meaningful results."""
    workers: int = os.cpu_count() or 1
    """Parallel processes; does not change the results."""
    data: Path | None = None
    """Annotated matches, for imitate-v0."""
    verify: bool = True
    """Recompute all scores from the stored policies."""
    game: str = "default"
    """Model of the game."""
    out: Path | None = None
    """Folder of the runs; default runs/suite, with a number appended if that exists."""
    resume: bool = False
    """Continue the runs in --out."""
    overwrite: bool = False
    """Replace the runs in --out."""

    def __post_init__(self) -> None:
        unknown = [name for name in self.tasks if name not in TASKS]
        if unknown:
            raise ShuttleError(f"--tasks {' '.join(unknown)}: expected some of {', '.join(TASKS)}")
        if self.methods and len(self.tasks) != 1:
            raise ShuttleError("--methods: expected with one of --tasks")

    def fixed(self) -> dict[str, Any]:
        """Settings that determine the result, as JSON."""
        return {
            "tasks": list(self.tasks),
            "methods": list(self.methods),
            "split": self.split,
            "quick": self.quick,
            "game": self.game,
        }

    def runs(self) -> list[tuple[str, str]]:
        """Task and method of each run."""
        found = []
        for task in self.tasks or [name for name in TASKS if self.data is not None or name != "imitate-v0"]:
            plain = [name for name in BASELINES[kind_of(task)] if name not in LEFT_OUT.get(task, ())]
            methods = [QUICK[task]] if self.quick else [*plain, *VARIANTS.get(task, ())]
            found += [(task, method) for method in self.methods or methods]
        return found


def suite(config: tyro.conf.OmitArgPrefixes[Suite], json: Path | None = None) -> None:
    """Run all baselines, and write their summaries.

    Args:
        config: what to run.
        json: write the results here too.
    """
    console, rows = Console(stderr=True, highlight=False), []
    with runs.open_run(config.out, "suite", config.fixed(), resume=config.resume, overwrite=config.overwrite) as folder:
        for task, method in config.runs():
            console.print(f"{task} {method} …", style="dim")
            out = folder / task / method.replace(":", "-")
            options = SuiteRun(
                task=task,
                method=method,
                split=config.split,
                quick=config.quick,
                workers=config.workers,
                model=config.game,
                data=config.data,
                out=out,
                resume=(out / runs.CONFIG).exists(),
            )
            run_method(options, console)
            verified = None
            if config.verify:
                verified = all(finding.reason is None for finding in verify_run(out, game=config.game, data=config.data))
            rows.append({**summarise(out, game=config.game), "verified": verified, "tuning_strokes": None})
        save_results(folder, {"rows": rows}, json)
    Console(highlight=False, soft_wrap=True).print(f"{len(rows)} runs are in {folder}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run_command(suite, prog="experiments.suite", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
