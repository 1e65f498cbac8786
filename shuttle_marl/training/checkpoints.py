"""Files that a resumed run reads: checkpoints, and the evaluations up to the last checkpoint.

A checkpoint is a folder ``checkpoints/ITERATION`` that is complete or absent. It holds everything that the next iteration depends
on: tensors in ``state.safetensors``, the rest in ``about.json``, which also holds the hash of the tensors.
"""

import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import Any, Final, TypedDict

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save

from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import Count, FileReadError, Sha256, problem, read_file, read_sealed, replace_file, seal
from shuttle_marl.training.config import TrainingError

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


def write_state(path: Path, about_path: Path, state: dict[str, torch.Tensor], about: dict[str, Any]) -> None:
    """Write tensors, and then a description with their hash."""
    # Some tensors share their memory, which safetensors refuses.
    content = save({name: tensor.clone() for name, tensor in state.items()})
    replace_file(path, content)
    replace_file(about_path, seal({"sha256": {path.name: hashlib.sha256(content).hexdigest()}, **about}))


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


class Mark(TypedDict):
    """Length [bytes] and SHA-256 of a file of evaluations."""

    bytes: Count
    sha256: Sha256


class Metrics:
    """File of evaluations, one JSON object per line. Checkpoints hold its length and hash.

    Args:
        path: path of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def append(self, line: dict[str, Any]) -> None:
        """Append a line."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def mark(self) -> Mark:
        """Write the file to disk, and return its length and hash for :meth:`truncate`."""
        with self._path.open("ab+") as file:
            os.fsync(file.fileno())
            file.seek(0)
            content = file.read()
        return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}

    def truncate(self, mark: Mark | None) -> None:
        """Remove all lines after a mark; None: all lines.

        Raises:
            TrainingError: the file cannot be read, or was changed before the mark.
        """
        try:
            content = self._path.read_bytes() if mark is not None else b""
        except OSError as error:
            raise TrainingError(f"{self._path}: cannot be read ({problem(error)}); train again with --overwrite") from error
        retained = content[: mark["bytes"]] if mark is not None else b""
        if mark is not None and mark != {"bytes": len(retained), "sha256": hashlib.sha256(retained).hexdigest()}:
            raise TrainingError(f"{self._path}: was changed after it was written; train again with --overwrite")
        if retained != content or mark is None:
            replace_file(self._path, retained)
