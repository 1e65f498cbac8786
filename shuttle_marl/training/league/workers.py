"""Turns of a round, side by side in processes or on a cluster, or one after another here, with the same results.

On a cluster no folder is shared: the files that a turn reads travel with it, and those that it leaves come back.
"""

import multiprocessing
import tempfile
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Final

from shuttle_marl.cluster import Cluster, Task
from shuttle_marl.files import open_file, problem, replace_file
from shuttle_marl.game.tables import Game
from shuttle_marl.training.league.config import LeagueTrainingConfig, LeagueTrainingError
from shuttle_marl.training.league.turns import Taken, Turn, made, needed, results, take_turn
from shuttle_marl.training.study import end_with_parent

_ATTEMPTS: Final = 3
"""Times that workers may die in one round before the run gives up."""


class Workers:
    """Processes that take turns; none where one is enough.

    Args:
        count: number of processes.
        game: of the league.
        cluster: takes the turns instead of processes.
    """

    def __init__(self, count: int, game: Game, cluster: Cluster | None = None) -> None:
        self._count, self._cluster = count, cluster
        self._game = None if cluster is None else cluster.share(game)
        self._pool: ProcessPoolExecutor | None = None
        self._others: set[int | None] = set()
        """Processes that were there before the pool."""

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def take(self, folder: Path, config: LeagueTrainingConfig, turns: Sequence[Turn]) -> list[Taken]:
        """Take some turns; a worker that dies costs only the turns that were not over.

        Raises:
            LeagueTrainingError: workers died again and again.
            ClusterError: the same on a cluster.
        """
        if self._cluster is not None:
            return self._take_on(self._cluster, folder, config, turns)
        if self._count == 1 or len(turns) == 1:
            return [take_turn(folder, config, turn) for turn in turns]
        for _ in range(_ATTEMPTS):
            try:
                waiting: list[Future[Taken]] = [self._started().submit(take_turn, folder, config, turn) for turn in turns]
                return [future.result() for future in waiting]
            except BrokenProcessPool:
                # Turns that are over have left their results in the folder. A worker that was about to start when another one
                # died can outlive the pool, which would wait for it for ever.
                self._pool = None
                for child in multiprocessing.active_children():
                    if child.pid not in self._others:
                        child.kill()
        raise LeagueTrainingError(
            f"{folder}: workers died {_ATTEMPTS} times in one round, perhaps for lack of memory; continue with --resume and "
            "fewer --workers"
        )

    def _take_on(self, cluster: Cluster, folder: Path, config: LeagueTrainingConfig, turns: Sequence[Turn]) -> list[Taken]:
        missing = [turn for turn in turns if results(folder, turn) is None]
        tasks: list[Task[tuple[Taken, dict[Path, bytes]]]] = []
        for turn in missing:
            tasks.append(
                cluster.submit(take_elsewhere, config, turn, self._game, {path: _read(folder / path) for path in needed(turn)})
            )
        for turn, task in zip(missing, tasks, strict=True):
            taken, files = task.result()
            for path in made(turn, taken):
                replace_file(folder / path, files[path])
        return [take_turn(folder, config, turn) for turn in turns]

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._others = {child.pid for child in multiprocessing.active_children()}
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self._count, mp_context=context, initializer=end_with_parent)
        return self._pool


def take_elsewhere(
    config: LeagueTrainingConfig, turn: Turn, game: Game, files: dict[Path, bytes]
) -> tuple[Taken, dict[Path, bytes]]:
    """Take a turn where the folder of the run is not.

    Args:
        config: of the league.
        turn: the turn.
        game: of the league.
        files: that the turn needs, by their places in the folder of the run.

    Returns:
        The results, and the files that the turn left.
    """
    with tempfile.TemporaryDirectory(prefix="shuttle-marl-") as name:
        folder = Path(name)
        for path, content in files.items():
            replace_file(folder / path, content)
        taken = take_turn(folder, config, turn, game)
        return taken, {path: _read(folder / path) for path in made(turn, taken)}


def _read(path: Path) -> bytes:
    try:
        with open_file(path) as file:
            return file.read()
    except OSError as error:
        raise LeagueTrainingError(f"{path}: cannot be used ({problem(error)}); train again with --overwrite") from error
