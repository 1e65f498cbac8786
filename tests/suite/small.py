"""Runs of the suite in the small game."""

import functools
from pathlib import Path
from typing import Any

from shuttle_marl.suite.options import SuiteRun
from shuttle_marl.suite.results import Row, summarise
from shuttle_marl.suite.run import run_method
from shuttle_marl.suite.verify import verify_run
from tests.reduced import reduced_model

verified = functools.partial(verify_run, game=reduced_model())


def run(task: str, method: str, out: Path, **options: Any) -> Path:
    """The folder of a quick run; see :class:`SuiteRun` for the options."""
    return run_method(SuiteRun(task=task, method=method, game=reduced_model(), out=out, **{"quick": True, **options}))


def summary(folder: Path, beacon: str | None = None) -> Row:
    return summarise(folder, beacon, reduced_model())
