"""Training runs of experiments: many side by side, and results that say what made them."""

import dataclasses
import json
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.progress import track

from shuttle_marl import runs
from shuttle_marl.files import replace_file
from shuttle_marl.training import TrainingConfig, train

_PACKAGES: Final = ("numpy", "scipy", "torch", "torchrl", "tensordict", "numba")


def _train(config: TrainingConfig) -> None:
    assert config.out is not None
    train(dataclasses.replace(config, resume=(config.out / runs.CONFIG).exists()))


def train_all(configs: Sequence[TrainingConfig], jobs: int, console: Console) -> None:
    """Start or continue every training run; each ends with the same weights whatever runs beside it.

    Args:
        configs: each with a run folder of its own.
        jobs: how many run at once.
        console: shows progress.
    """
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        waiting = [pool.submit(_train, config) for config in configs]
        try:
            for done in track(as_completed(waiting), "training", len(waiting), console=console, transient=True):
                done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


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
