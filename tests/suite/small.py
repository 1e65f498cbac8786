"""Runs of the suite in the small game."""

from pathlib import Path
from typing import Any

from shuttle_marl.suite.options import SuiteRun
from shuttle_marl.suite.results import Row, RunConfig, Verification, arena_of, find_task, summarise, verify_run
from shuttle_marl.suite.run import PlayedUnit, play_unit, run_method
from tests.reduced import reduced_model


def verified(folder: Path, seed: str | None = None) -> Verification:
    return verify_run(folder, reduced_model(), seed)


def run(task: str, method: str, out: Path, **options: Any) -> Path:
    """The folder of a quick run; see :class:`SuiteRun` for the options."""
    return run_method(SuiteRun(task=task, method=method, game=reduced_model(), out=out, **{"quick": True, **options}))


def unit(task: str, method: str, folder: Path) -> PlayedUnit:
    """The first unit of a quick run, in this process, while a run plays each unit of a stranger's method in one of its own."""
    game = arena_of(find_task(task), reduced_model(), "dev", quick=True).game
    config = RunConfig(task=task, method=method, split="dev", quick=True, seeds=1, model=reduced_model(), game=game.hash)
    return play_unit(folder, config, None, (0, 0))


def summary(folder: Path, seed: str | None = None) -> Row:
    return summarise(folder, reduced_model(), seed)
