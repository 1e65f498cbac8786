"""Several training runs side by side, each of them made or gone on with."""

import dataclasses
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed

from rich.console import Console
from rich.progress import track

from shuttle_marl import runs
from shuttle_marl.training import TrainingConfig, train


def _train(config: TrainingConfig) -> None:
    assert config.out is not None
    train(dataclasses.replace(config, resume=(config.out / runs.CONFIG).exists()))


def train_all(configs: Sequence[TrainingConfig], jobs: int, console: Console) -> None:
    """Run, or go on with, every training run; each ends with the same weights whatever runs beside it.

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
