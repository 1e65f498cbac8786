"""Run folders of experiments, and result files with their provenance."""

import contextlib
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base import runs
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli

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


def show_figures(figures: dict[str, Any], copy: Path | None, *, as_json: bool, **settings: Any) -> None:
    """Print the figures of an experiment without a run folder.

    Args:
        figures: JSON values by name.
        copy: file for them, preceded by their provenance; None: none.
        as_json: whether JSON is printed instead of lines.
        **settings: of the experiment, for the file.
    """
    if copy is not None:
        runs.write_json(copy, {**runs.describe(("numpy",)), **settings, **figures})
    if as_json:
        cli.print_json(figures)
        return
    for name, value in figures.items():
        cli.console().print(f"{name}: {value}", soft_wrap=True)
