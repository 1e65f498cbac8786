"""The rally log of a training run, without a share in what is learned.

Rallies are played to their end in the iteration in which they begin, from draws that the seed of their segment and their number
name. So a pairing of the log is what is played between two checkpoints, and its key is the seed of that segment.
"""

import dataclasses
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.arrays import I64
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel import RallySampler
from shuttle_marl.rally.record import OPTIONAL
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, Rallies, RallyRecorder, Sampling
from shuttle_marl.recording.recover import resume
from shuttle_marl.training.config import TrainingConfig

RALLIES: Final = "rallies.mcap"
"""The rally log in the folder of a run."""
_COLUMNS: Final = {"ppo": OPTIONAL, "a2c": OPTIONAL, "sac": ("update",)}


class RunLog:
    """Log of the rallies of a run.

    Args:
        recorder: writes them.
        header: of the log; its first policy is the learner, the others its opponents.
    """

    def __init__(self, recorder: RallyRecorder, header: LogHeader) -> None:
        self._recorder, self._header = recorder, header
        self._sampling = Sampling.parse(header.record)
        self._thread = ThreadPoolExecutor(1, "recording replays")
        self._pending: Future[Rallies] | None = None

    def add(self, sampler: RallySampler, segment: int, update: int) -> None:
        """Record what a sampler played in its last iteration; in self-play what the learner played with itself from the serve on.

        The rallies are put together in a thread of their own, while the learner learns; :meth:`settle` waits for it. Where all
        are recorded, the sampler notes those of the next iteration while it plays; of a sample it plays them again.

        Args:
            sampler: before its next iteration; nothing of it may change until :meth:`settle`.
            segment: part of the run that ends with a checkpoint, counted from 0.
            update: iterations before this one.

        Raises:
            RecordingError: the log cannot be written any further; every rally before is there.
        """
        if self._sampling.every == 1:
            sampler.note_next()
        numbers = sampler.numbers[sampler.usual(sampler.numbers)]
        pairing = np.full(len(numbers), segment)
        numbers = numbers[self._sampling.keeps(self._header, pairing, numbers)]
        if not len(numbers):
            return
        self.settle()
        self._pending = self._thread.submit(self._rallies, sampler, numbers, segment, update)

    def settle(self) -> None:
        """Wait until what was added last is put together, and hand it to the writer."""
        if self._pending is not None:
            pending, self._pending = self._pending, None
            self._recorder.add(pending.result())

    def _rallies(self, sampler: RallySampler, numbers: I64, segment: int, update: int) -> Rallies:
        rallies = sampler.record(numbers, figures="value" in self._header.columns)
        n = len(rallies)
        own = len(self._header.policies) == 1  # a pool of self-play is not named
        return dataclasses.replace(
            rallies,
            pairing=np.full(n, segment, np.uint32),
            update=np.full(n, update, np.uint32),
            policy=np.zeros((n, 2), np.uint16) if own else rallies.policy,
        )

    def flush(self) -> int:
        """Have everything on the disk; returns the number of rallies there."""
        self.settle()
        return self._recorder.flush()

    def close(self) -> None:
        """Move the log into place."""
        self.settle()
        self._thread.shutdown()
        self._recorder.close()

    def abort(self) -> None:
        """Leave the log unfinished, for a run that continues it."""
        self._thread.shutdown()
        self._recorder.abort()


def open_log(
    folder: Path,
    config: TrainingConfig,
    game: Game,
    opponents: Sequence[TabulatedPolicy],
    seeds: Sequence[int],
    *,
    rallies: int,
) -> RunLog | None:
    """The log of a run, or of the rest of one; None where nothing is recorded.

    Args:
        folder: of the run.
        config: of the run.
        game: the tables.
        opponents: in the order of ``config.opponent``.
        seeds: of the segments.
        rallies: number in the log at the checkpoint from which the run continues.

    Raises:
        RecordingError: the log cannot be written, or holds fewer rallies than that.
    """
    if not Sampling.parse(config.record).every:
        return None
    names = () if config.self_play else config.opponent
    header = LogHeader(
        seed=config.seed,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=(
            Player(name=f"{config.algorithm}-{config.seed}"),
            *(Player(name=name, hash=policy.hash) for name, policy in zip(names, opponents, strict=True)),
        ),
        pairings=tuple(seeds),
        matches_per_draw=1,
        rules=SINGLE_RALLY,
        draws="training",
        record=config.record,
        columns=_COLUMNS[config.algorithm],
    )
    return RunLog(RallyRecorder(resume(folder / RALLIES, header, rallies)), header)
