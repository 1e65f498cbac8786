"""The rally log of a training run: every rally that the collectors play, without a share in what is learned.

The learner sees its own strokes alone; in the recorder's thread :class:`~shuttle_marl.kernel.BatchLog` plays them once more on
the seed of the environment, and so knows the rest. Every checkpoint begins with draws of its own, so a pairing of the log is
what one process plays between two checkpoints, and its key is the seed of that environment. Rallies that a checkpoint
interrupts are not played to their end, and not recorded.
"""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from tensordict import TensorDictBase

from shuttle_marl.game.rally import Game, IllegalStrokeError
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.kernel import BatchLog, RallyBatch, VersusBatch
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, Rallies, RallyRecorder, RecordingError, Sampling
from shuttle_marl.recording.kernel_rallies import single_rallies_of
from shuttle_marl.recording.recover import resume
from shuttle_marl.training.config import TrainingConfig

RALLIES: Final = "rallies.mcap"
"""The rally log in the folder of a run."""
_ENTRIES: Final = {"log_probability": "action_log_prob", "value": "state_value"}
"""Columns of the log, and what they are called in what is collected."""
_COLUMNS: Final = {"ppo": ("update", *_ENTRIES), "a2c": ("update", *_ENTRIES), "sac": ("update",)}
_STROKES_A_STEP: Final = 2
"""The learner's stroke and the reply to it, to count what waits."""


def open_log(
    folder: Path,
    config: TrainingConfig,
    game: Game,
    opponents: Sequence[TabulatedPolicy],
    seeds: Sequence[Sequence[int]],
    *,
    rallies: int,
) -> "RunLog | None":
    """The log of a run, or of the rest of one; None where nothing is recorded.

    Rallies on a Ray cluster are not recorded: which of its processes a stroke comes from is not known here.

    Args:
        folder: of the run.
        config: of the run.
        game: the tables.
        opponents: in the order of ``config.opponent``.
        seeds: of the environments, by segment and process.
        rallies: number in the log at the checkpoint from which the run continues.

    Raises:
        RecordingError: the log cannot be written, or holds fewer rallies than that.
    """
    if not Sampling.parse(config.record).every or config.collector == "ray":
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
        pairings=tuple(seed for segment in seeds for seed in segment),
        matches_per_draw=1,
        rules=SINGLE_RALLY,
        draws="training",
        record=config.record,
        columns=_COLUMNS[config.algorithm],
    )
    rows, figures = config.rows // config.processes, sum(name in _ENTRIES for name in header.columns)
    logs = [
        BatchLog(VersusBatch(game, rows, opponents=opponents) if opponents else RallyBatch(game, rows), extra=figures)
        for _ in range(config.processes)
    ]
    recorder = RallyRecorder(resume(folder / RALLIES, header, rallies))
    return RunLog(recorder, logs, seeds, header.columns, seat=0 if opponents else None)


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Collected:
    """``[rows, steps]`` arrays of an iteration, ``extra`` ``[E, rows, steps]``, and when that was."""

    segment: int
    update: int
    stroke: npt.NDArray[np.int64]
    reward: npt.NDArray[np.float32]
    extra: npt.NDArray[np.float32]


class RunLog:
    """Log of the rallies of a run.

    Args:
        recorder: writes them.
        logs: one for each process.
        seeds: of the environments, by segment and process.
        columns: of the log.
        seat: the learner's; None in self-play.
    """

    def __init__(
        self,
        recorder: RallyRecorder,
        logs: list[BatchLog],
        seeds: Sequence[Sequence[int]],
        columns: tuple[str, ...],
        *,
        seat: int | None,
    ) -> None:
        self._recorder, self._logs, self._seeds, self._seat = recorder, logs, seeds, seat
        self._columns = tuple(name for name in columns if name in _ENTRIES)
        self._segment = 0
        self._played = -1
        """Segment that the batches are in; they live in the recorder's thread."""

    def begin(self, segment: int) -> None:
        """From here on rallies belong to what follows the given checkpoint, counted from 0."""
        self._segment = segment

    def add(self, data: TensorDictBase, update: int) -> None:
        """Record ``[rows, steps]`` strokes after the learner has learned from them.

        Raises:
            RecordingError: the log cannot be written any further; every rally before is there.
        """
        extra = np.empty((len(self._columns), *data.shape), np.float32)
        for figures, name in zip(extra, self._columns, strict=True):
            figures[:] = data[_ENTRIES[name]].detach().cpu().numpy().reshape(data.shape)
        collected = _Collected(
            segment=self._segment,
            update=update,
            stroke=_copy(data["action"]),
            reward=_copy(data["next", "reward"])[..., 0],
            extra=extra,
        )
        self._recorder.add_later(functools.partial(self._rallies, collected), _STROKES_A_STEP * data.numel())

    def flush(self) -> int:
        """Have everything on the disk; returns the number of rallies there."""
        return self._recorder.flush()

    def close(self) -> None:
        """Move the log into place."""
        self._recorder.close()

    def abort(self) -> None:
        """Leave the log unfinished, for a run that continues it."""
        self._recorder.abort()

    def _rallies(self, collected: _Collected) -> Rallies:
        """The rallies that ended in an iteration, process after process.

        Raises:
            RecordingError: the environments played other rallies than their seeds give.
        """
        segment, share = collected.segment, len(collected.stroke) // len(self._logs)
        found = []
        for p, (log, seed) in enumerate(zip(self._logs, self._seeds[segment], strict=True)):
            as_recorded = functools.partial(
                single_rallies_of,
                pairing=segment * len(self._logs) + p,
                seat=self._seat,
                update=collected.update,
                columns=self._columns,
            )
            if segment != self._played:
                log.reset(seed)
                found.append(as_recorded(log.take()))
            rows = slice(p * share, (p + 1) * share)
            try:
                same = np.array_equal(log.play(collected.stroke[rows], collected.extra[:, rows]), collected.reward[rows])
            except IllegalStrokeError:
                same = False
            if not same:
                raise RecordingError(f"process {p}: its strokes and rewards do not follow from its seed")
            found.append(as_recorded(log.take()))
        self._played = segment
        return Rallies.join(found)


def _copy(tensor: Any) -> npt.NDArray[Any]:
    """A copy of a tensor as an array, which later steps do not change."""
    array: npt.NDArray[Any] = tensor.detach().cpu().numpy().copy()
    return array
