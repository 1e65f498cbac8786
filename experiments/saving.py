"""Result files of experiments with their provenance."""

import json
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base import runs
from shuttle_marl.base.files import replace_file

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
