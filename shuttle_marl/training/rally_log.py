"""The rally log of a training run."""

import dataclasses
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import I64
from shuttle_marl.game.rally.record import columns_of
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel import RallySampler
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, Rallies, RallyRecorder, Sampling
from shuttle_marl.recording.recover import resume
from shuttle_marl.training.config import TrainingConfig

RALLIES: Final = "rallies.mcap"
"""The rally log in the folder of a run."""
_COLUMNS: Final = {"sac": ("update",)}
_FIGURES: Final = ("update", "log_probability", "value")


class RunLog:
    """Log of the rallies of a run.

    Args:
        header: header of the log; its first policy is the learner, the others are its opponents.
    """

    def __init__(self, recorder: RallyRecorder, header: LogHeader) -> None:
        self._recorder, self._header = recorder, header
        self._sampling = Sampling.parse(header.record)
        self._thread = ThreadPoolExecutor(1, "recording replays")
        self._pending: Future[Rallies] | None = None

    def record(self, sampler: RallySampler, segment: int, update: int) -> None:
        """Record the rallies of the last iteration; in self-play, only those from the serve without other opponents.

        A thread builds the columns while the learner learns; :meth:`settle` waits for it. If all rallies are recorded, the
        sampler records the next iteration while it plays; a sample is replayed.

        Args:
            sampler: sampler of the rallies; it must not change until :meth:`settle`.
            segment: number of the segment between two checkpoints, counted from 0.
            update: number of iterations before this one.

        Raises:
            RecordingError: the log cannot be written; earlier rallies are recorded.
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
        """Wait for the columns of the last rallies, and pass them to the recorder."""
        if self._pending is not None:
            pending, self._pending = self._pending, None
            self._recorder.add(pending.result())

    def _rallies(self, sampler: RallySampler, numbers: I64, segment: int, update: int) -> Rallies:
        rallies = sampler.record(numbers, figures="value" in self._header.columns)
        n = len(rallies)
        own = len(self._header.policies) == 1  # opponents of self-play variants are not in the log
        return dataclasses.replace(
            rallies,
            pairing=np.full(n, segment, np.uint32),
            update=np.full(n, update, np.uint32),
            policy=np.zeros((n, 2), np.uint16) if own else rallies.policy,
        )

    def flush(self) -> int:
        """Write all rallies to disk, and return their number."""
        self.settle()
        return self._recorder.flush()

    def close(self) -> None:
        """Finish the log and move it to its final name."""
        self.settle()
        self._thread.shutdown()
        self._recorder.close()

    def abort(self) -> None:
        """Leave the log unfinished, for a resumed run."""
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
    """Open the log of a run, or continue it; None if nothing is recorded.

    Args:
        opponents: opponents in the order of ``config.opponent``.
        rallies: number of recorded rallies at the last checkpoint.

    Raises:
        RecordingError: the log cannot be written, or holds fewer rallies.
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
        columns=columns_of(game, *_COLUMNS.get(config.algorithm, _FIGURES)),
    )
    return RunLog(RallyRecorder(resume(folder / RALLIES, header, rallies)), header)
