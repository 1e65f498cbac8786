"""Result files of experiments with their provenance."""

import json
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base import runs
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli

_PACKAGES: Final = ("numpy", "scipy", "torch", "torchrl", "tensordict", "numba")


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
