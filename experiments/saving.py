"""What experiments with training runs share: run folders, result files with their provenance, and the spread over runs."""

import contextlib
import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from docs.tools.results import show
from shuttle_marl.base import runs
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.intervals import interquartile_mean

_PACKAGES: Final = ("numpy", "scipy", "torch", "torchrl", "tensordict", "numba")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """Settings of an experiment with a run folder."""

    out: Path | None = None
    """Run folder; default a folder of this experiment in runs, with a number appended if that exists."""
    resume: bool = False
    """Continue the run in --out."""
    overwrite: bool = False
    """Replace the run in --out."""

    def check(self, *, seeds: int, jobs: int) -> None:
        """Refuse studies without a spread over seeds.

        Raises:
            ShuttleError: fewer than two seeds, or no job.
        """
        if seeds < 2 or jobs < 1:
            raise ShuttleError(f"--seeds {seeds} --jobs {jobs}: expected 2 seeds or more and 1 job or more")

    def fixed(self) -> dict[str, Any]:
        """Settings that determine the result, as JSON: all but those of the folder, and the number of parallel runs."""
        others = {"jobs", *(field.name for field in dataclasses.fields(Study))}
        own = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name not in others}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in own.items()}

    @contextlib.contextmanager
    def open(self, name: str) -> Iterator[Path]:
        """The run folder, see :func:`shuttle_marl.base.runs.open_run`."""
        with runs.open_run(self.out, name, self.fixed(), resume=self.resume, overwrite=self.overwrite) as run:
            yield run.folder


def save_results(folder: Path, result: dict[str, Any], copy: Path | None) -> dict[str, Any]:
    """Finish a run folder: write the results, preceded by their provenance.

    Args:
        folder: of the experiment.
        result: JSON values.
        copy: second file for the results; None: none.

    Returns:
        The written results.
    """
    about = runs.describe(_PACKAGES)
    whole = {**about, **result}
    runs.write_json(folder / "results.json", whole)
    runs.write_json(folder / runs.MANIFEST, {"status": "finished", **about})
    if copy is not None:
        replace_file(copy, (json.dumps(whole, indent=1) + "\n").encode())
    return whole


def finish(
    folder: Path, result: dict[str, Any], *tables: str, copy: Path | None = None, as_json: bool = False
) -> None:  # fmt: skip
    """Write the results of a run folder, print them, and say where they are.

    Args:
        folder: of the experiment.
        result: JSON values.
        tables: templates that show them.
        copy: second file for the results; None: none.
        as_json: print JSON instead of tables.
    """
    show(save_results(folder, result, copy), *tables, as_json=as_json)
    Console(stderr=True, highlight=False, soft_wrap=True, markup=False).print(f"everything is in {folder}")


def mean_and_deviation(values: Sequence[float]) -> dict[str, float]:
    """Mean, and standard deviation of a sample (n - 1)."""
    return {"mean": float(np.mean(values)), "deviation": float(np.std(values, ddof=1))}


def iqm(tasks: Sequence[Sequence[float]]) -> dict[str, float]:
    """Interquartile mean and its 95 % interval (Agarwal et al., NeurIPS 2021, arXiv 2108.13264), as ``value``, ``low``, ``high``.

    The bootstrap is stratified, so each task keeps its number of runs.

    Args:
        tasks: scores of the runs, by task; two runs or more.
    """
    return interquartile_mean(tasks, 0)._asdict()
