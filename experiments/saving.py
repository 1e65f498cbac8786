"""Results of experiments that say what made them."""

import json
from pathlib import Path
from typing import Any, Final

from shuttle_marl import runs
from shuttle_marl.files import replace_file

_PACKAGES: Final = ("numpy", "scipy", "torch", "torchrl", "tensordict", "numba")


def save_results(folder: Path, result: dict[str, Any], copy: Path | None) -> dict[str, Any]:
    """Finish a run folder: the results, with what made them in front.

    Args:
        folder: of the experiment.
        result: what was found, as JSON.
        copy: a second place for the results; None: none.

    Returns:
        What was written.
    """
    about = runs.describe(_PACKAGES)
    whole = {**about, **result}
    runs.write_json(folder / "results.json", whole)
    runs.write_json(folder / runs.MANIFEST, {"status": "finished", **about})
    if copy is not None:
        replace_file(copy, (json.dumps(whole, indent=1) + "\n").encode())
    return whole
