"""What experiments with training runs share: run folders, result files with their provenance, and the spread over runs."""

import contextlib
import dataclasses
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from rich.console import Console

from docs.tools.results import show
from shuttle_marl.base import runs
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.intervals import interquartile_mean
from shuttle_marl.game import load_game, model_folder
from shuttle_marl.policy.agents import load_agent, shipped_folder

_PACKAGES: Final = ("numpy", "scipy", "torch", "torchrl", "tensordict", "numba")


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunFolder:
    """An experiment with a run folder."""

    out: Path | None = None
    """Run folder; default a folder of this experiment in runs, with a number appended if that exists."""
    resume: bool = False
    """Continue the run in --out."""
    overwrite: bool = False
    """Replace the run in --out."""

    def fixed(self) -> dict[str, Any]:
        """Settings that determine the result, as JSON."""
        others = {"jobs", "ship", *(field.name for field in dataclasses.fields(RunFolder))}
        own = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name not in others}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in own.items()}

    @contextlib.contextmanager
    def open(self, name: str) -> Iterator[Path]:
        """The run folder, see :func:`shuttle_marl.base.runs.open_run`."""
        with runs.open_run(self.out, name, self.fixed(), resume=self.resume, overwrite=self.overwrite) as run:
            yield run.folder


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study(RunFolder):
    """An experiment with several seeds."""

    seeds: int = 5
    """Training runs of each agent."""
    quick: bool = False
    """Two seeds and a small part of the training: a smoke test without meaningful results."""
    jobs: int = os.cpu_count() or 1
    """Number of parallel training runs; does not change the result."""

    def __post_init__(self) -> None:
        if self.seeds < 2 or self.jobs < 1:
            raise ShuttleError(f"--seeds {self.seeds} --jobs {self.jobs}: expected 2 seeds or more and 1 job or more")

    def sized(self, **less: Any) -> Self:
        """These settings; with --quick those of a smoke test."""
        return dataclasses.replace(self, seeds=2, **less) if self.quick else self


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
    """Write the results of a run folder, print them as tables or JSON, and say where they are."""
    show(save_results(folder, result, copy), *tables, as_json=as_json)
    Console(stderr=True, highlight=False, soft_wrap=True, markup=False).print(f"everything is in {folder}")


def ship(agents: Mapping[str, Path]) -> None:
    """Copy trained agents into the package; a model that is fitted again needs new ones.

    Args:
        agents: folder of each by its name in the package: that of the first seed, not of the best one.
    """
    for folder in agents.values():
        load_agent(folder, load_game("default"))  # raises an error for another game before files are replaced
    for name, folder in agents.items():
        target = shipped_folder(name, model_folder())
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(folder, target)


def mean_and_deviation(values: Sequence[float]) -> dict[str, float]:
    """Mean, and standard deviation of a sample (n - 1)."""
    return {"mean": float(np.mean(values)), "deviation": float(np.std(values, ddof=1))}


def iqm(values: Sequence[float]) -> dict[str, float]:
    """Interquartile mean and its 95 % interval (Agarwal et al., NeurIPS 2021, arXiv 2108.13264): ``value``, ``low``, ``high``."""
    return interquartile_mean([values], 0)._asdict()
