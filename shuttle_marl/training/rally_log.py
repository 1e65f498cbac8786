"""The rally log of a training run."""

import dataclasses
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.base import runs
from shuttle_marl.base.arrays import I64
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.rally import columns_of
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import RallySampler
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, Rallies, RallyRecorder
from shuttle_marl.recording.recorder import LogContext, resume
from shuttle_marl.training.config import PPOConfig, TrainingConfig
from shuttle_marl.training.self_play import n_opponents

FIRST: Final = 10_000  # rallies at the beginning of a run that have figures, so that those of a short run all have them
_EVERY: Final = 100
_FIGURES: Final = ("log_probability", "value")


class RunLog(LogContext):
    """Log of the rallies of a learner, or the continuation of one.

    Args:
        path: the log; None: nothing is written.
        players: the learner, then the opponents of its sampler in their order.
        seeds: seed of the sampler in each segment.
        seed: of the run.
        figures: rallies of the log whose strokes have the learner's log-probability and value: all, none, or auto, the first
            :data:`FIRST` and one in a hundred; None: a log without these columns.
        rallies: number of rallies that were recorded before.

    Raises:
        RecordingError: the log cannot be written, or holds fewer rallies.
    """

    def __init__(
        self,
        path: Path | None,
        game: Game,
        players: tuple[Player, ...],
        seeds: Sequence[int],
        *,
        seed: int,
        figures: str | None = None,
        rallies: int = 0,
    ) -> None:
        self._figures = figures
        self._header = LogHeader(
            seed=seed,
            game=game.hash,
            strokes=game.catalogue.names,
            policies=players,
            pairings=tuple(seeds),
            matches_per_draw=1,
            rules=SINGLE_RALLY,
            draws="training",
            columns=columns_of(game, "update", *(_FIGURES if figures else ())),
        )
        self._recorder = None if path is None else RallyRecorder(resume(path, self._header, rallies))
        self._thread = ThreadPoolExecutor(1, "recording rallies")
        self._pending: Future[Rallies] | None = None

    def record(self, sampler: RallySampler, segment: int, update: int) -> None:
        """Record the rallies of the last iteration that began with a serve.

        A thread builds the columns while the learner learns; :meth:`settle` waits for it.

        Args:
            sampler: sampler of the rallies; it must not change until :meth:`settle`.
            segment: number of the segment between two checkpoints, counted from 0.
            update: number of iterations before this one.

        Raises:
            RecordingError: the log cannot be written; earlier rallies are recorded.
        """
        if self._recorder is None:
            return
        if not len(sampler.numbers):
            return
        self.settle()
        self._pending = self._thread.submit(self._rallies, sampler, sampler.numbers, segment, update)

    def settle(self) -> None:
        """Wait for the columns of the last rallies, and pass them to the recorder."""
        if self._pending is not None:
            assert self._recorder is not None
            pending, self._pending = self._pending, None
            self._recorder.add(pending.result())

    def _rallies(self, sampler: RallySampler, numbers: I64, segment: int, update: int) -> Rallies:
        auto = (numbers % _EVERY == 0) | ((segment == 0) & (numbers < FIRST))
        kept = auto if self._figures == "auto" else np.full(len(numbers), self._figures == "all")
        with_figures = "value" in self._header.columns
        rallies = sampler.record(numbers, figures=with_figures and bool(kept.all()))
        n = len(rallies)
        rallies = dataclasses.replace(rallies, pairing=np.full(n, segment, np.uint32), update=np.full(n, update, np.uint32))
        if not with_figures or rallies.value is not None:
            return rallies
        chance, value = np.full((2, len(rallies.stroke)), np.nan, np.float32)
        if kept.any():
            some, strokes = sampler.record(numbers[kept], figures=True), np.repeat(kept, rallies.length)
            chance[strokes], value[strokes] = some.log_probability, some.value
        return dataclasses.replace(rallies, log_probability=chance, value=value)

    def flush(self) -> int:
        """Write all rallies to disk, and return their number."""
        self.settle()
        return 0 if self._recorder is None else self._recorder.flush()

    def close(self) -> None:
        """Finish the log and move it to its final name."""
        self.settle()
        self._thread.shutdown()
        if self._recorder is not None:
            self._recorder.close()

    def abort(self) -> None:
        """Leave the log unfinished, for a resumed run."""
        self._thread.shutdown()
        if self._recorder is not None:
            self._recorder.abort()


def open_log(
    folder: Path,
    config: TrainingConfig,
    game: Game,
    opponents: Sequence[TabulatedPolicy],
    seeds: Sequence[int],
    rallies: int = 0,
    *,
    record: bool = True,
) -> RunLog:
    """Open the log of a run, or continue it.

    Args:
        opponents: opponents in the order of ``config.opponent``.
        rallies: number of recorded rallies at the last checkpoint.
        record: whether rallies are recorded, if ``config.record`` says so.

    Raises:
        RecordingError: the log cannot be written, or holds fewer rallies.
    """
    if isinstance(config, PPOConfig) and config.self_play:
        others = [Player(name=f"{config.variant}-{k}") for k in range(n_opponents(config))]
    else:
        others = [Player(name=name, hash=policy.hash) for name, policy in zip(config.opponent, opponents, strict=False)]
    return RunLog(
        folder / runs.RALLIES if record and config.record == "all" else None,
        game,
        (Player(name=f"{config.algorithm}-{config.seed}"), *others),
        seeds,
        seed=config.seed,
        figures=None if config.algorithm == "sac" or config.collector == "torchrl" else config.figures,
        rallies=rallies,
    )
