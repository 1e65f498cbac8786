"""Files of a training run: checkpoints, evaluations, and the rally log.

A checkpoint is a folder ``checkpoints/ITERATION`` that is complete or absent. It holds everything that the next iteration depends
on: tensors in ``state.safetensors``, the rest in ``about.json``, which also holds the hash of the tensors.
"""

import dataclasses
import hashlib
import os
import shutil
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load, save

from shuttle_marl.base.arrays import I64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import FileReadError, problem, read_file, read_sealed, replace_file, replace_sealed
from shuttle_marl.game.rally.record import OPTIONAL
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel import RallySampler
from shuttle_marl.recording import SINGLE_RALLY, LogHeader, Player, Rallies, RallyRecorder, Sampling
from shuttle_marl.recording.recover import resume
from shuttle_marl.training.config import TrainingConfig, TrainingError

CHECKPOINTS: Final = "checkpoints"
"""Folder of the checkpoints in the folder of a run."""
_STATE: Final = "state.safetensors"
_ABOUT: Final = "about.json"
_RETAINED: Final = 2


def save_checkpoint(run: Path, iteration: int, state: dict[str, torch.Tensor], about: dict[str, Any]) -> None:
    """Write a checkpoint, and remove all but the latest two.

    Args:
        run: folder of the run.
        iteration: number of completed iterations.
        state: tensors to restore.
        about: other values to restore, as JSON.

    Raises:
        TrainingError: the checkpoint cannot be written; earlier ones are intact.
    """
    target = run / CHECKPOINTS / f"{iteration:08d}"
    part = target.with_name(f".{target.name}.part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        write_state(part / _STATE, part / _ABOUT, state, {"iteration": iteration, **about})
        shutil.rmtree(target, ignore_errors=True)
        os.replace(part, target)
    except (OSError, ShuttleError) as error:
        raise TrainingError(f"{target}: cannot be written ({error}); free some space and continue with --resume") from error
    for old in _complete(run)[:-_RETAINED]:
        shutil.rmtree(old, ignore_errors=True)


def last_checkpoint(run: Path) -> tuple[dict[str, Any], dict[str, torch.Tensor]] | None:
    """``about`` and ``state`` of the last checkpoint of a run, see :func:`save_checkpoint`; None if there is none.

    Raises:
        TrainingError: the last checkpoint is damaged.
    """
    complete = _complete(run)
    if not complete:
        return None
    folder = complete[-1]
    try:
        return read_state(folder / _STATE, folder / _ABOUT)
    except FileReadError as error:
        raise TrainingError(f"{folder}: cannot be read ({error}); delete it to continue from the one before") from error


def saved_iteration(run: Path) -> int:
    """Number of iterations in the last checkpoint of a run; 0 without one."""
    return max((int(folder.name) for folder in _complete(run)), default=0)


def write_state(path: Path, about_path: Path, state: dict[str, torch.Tensor], about: dict[str, Any]) -> None:
    """Write tensors, and then a description with their hash."""
    # Some tensors share their memory, which safetensors refuses.
    content = save({name: tensor.clone() for name, tensor in state.items()})
    replace_file(path, content)
    replace_sealed(about_path, {"sha256": {path.name: hashlib.sha256(content).hexdigest()}, **about})


def read_state(path: Path, about_path: Path) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    """Read the description and the tensors of :func:`write_state`.

    Raises:
        FileReadError: a file is missing or damaged.
    """
    try:
        about = read_sealed(about_path)
        content = read_file(path)
        if about.get("sha256") != {path.name: hashlib.sha256(content).hexdigest()}:
            raise FileReadError(f"{path.name} does not match its hash in {about_path.name}")
        return about, load(content)
    except OSError as error:
        raise FileReadError(problem(error)) from error
    except SafetensorError as error:
        raise FileReadError(str(error)) from error


def _complete(run: Path) -> list[Path]:
    return sorted(path for path in (run / CHECKPOINTS).glob("[0-9]*") if (path / _ABOUT).is_file())


RALLIES: Final = "rallies.mcap"
"""The rally log in the folder of a run."""
_COLUMNS: Final = {"ppo": OPTIONAL, "a2c": OPTIONAL, "sac": ("update",)}


class RunLog:
    """Log of the rallies of a run.

    Args:
        recorder: writes the log.
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
        folder: folder of the run.
        config: settings of the run.
        game: the tables.
        opponents: opponents in the order of ``config.opponent``.
        seeds: seeds of the segments.
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
        columns=_COLUMNS[config.algorithm],
    )
    return RunLog(RallyRecorder(resume(folder / RALLIES, header, rallies)), header)
