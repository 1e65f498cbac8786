"""Turns of a round, side by side in processes or one after another here, with the same results."""

import multiprocessing
import os
import threading
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Final

from shuttle_marl.training.league.config import LeagueTrainingConfig, LeagueTrainingError
from shuttle_marl.training.league.turns import Taken, Turn, take_turn

_ATTEMPTS: Final = 3
"""Times that workers may die in one round before the run gives up."""


class Workers:
    """Processes that take turns; none where one is enough.

    Args:
        count: number of processes.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def take(self, folder: Path, config: LeagueTrainingConfig, turns: Sequence[Turn]) -> list[Taken]:
        """Take some turns; a worker that dies costs only the turns that were not over.

        Raises:
            LeagueTrainingError: workers died again and again.
        """
        if self._count == 1 or len(turns) == 1:
            return [take_turn(folder, config, turn) for turn in turns]
        for _ in range(_ATTEMPTS):
            try:
                waiting: list[Future[Taken]] = [self._started().submit(take_turn, folder, config, turn) for turn in turns]
                return [future.result() for future in waiting]
            except BrokenProcessPool:
                # Turns that are over have left their results in the folder.
                self._pool = None
        raise LeagueTrainingError(
            f"{folder}: workers died {_ATTEMPTS} times in one round, perhaps for lack of memory; continue with --resume and "
            "fewer --workers"
        )

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._count, mp_context=context, initializer=_end_with_parent)
        return self._pool


def _end_with_parent() -> None:
    """Let a worker end when the process that started it does, however that ends."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
