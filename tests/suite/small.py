"""Runs of the suite in the small game."""

from pathlib import Path
from typing import Any

from shuttle_marl.suite.options import SuiteRun
from shuttle_marl.suite.results import Row, Verification, summarise, verify_run
from shuttle_marl.suite.run import run_method
from tests.reduced import reduced_model


def verified(folder: Path, seed: str | None = None) -> Verification:
    return verify_run(folder, reduced_model(), seed)


def run(task: str, method: str, out: Path, **options: Any) -> Path:
    """The folder of a quick run; see :class:`SuiteRun` for the options."""
    return run_method(SuiteRun(task=task, method=method, game=reduced_model(), out=out, **{"quick": True, **options}))


def summary(folder: Path, seed: str | None = None) -> Row:
    return summarise(folder, reduced_model(), seed)
