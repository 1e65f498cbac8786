"""Checkpoints of a training run, and the states of learners in files.

A checkpoint is a folder ``checkpoints/ITERATION``. It holds everything that the next iteration depends on: tensors in
``state.safetensors``, and the rest in ``about.json``, which is written last, with the hash of the tensors.
"""

import shutil
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import FileReadError, hash_in, problem, read_hashed, read_sealed, replace_with_card
from shuttle_marl.base.runs import RunError

CHECKPOINTS: Final = "checkpoints"
"""Folder of the checkpoints in the folder of a run."""
_STATE: Final = "state.safetensors"
_ABOUT: Final = "about.json"
_RETAINED: Final = 2


def save_checkpoint(run: Path, iteration: int, state: dict[str, torch.Tensor], about: dict[str, Any]) -> None:
    """Write a checkpoint, and remove all but the latest two.

    Raises:
        RunError: the checkpoint cannot be written; earlier ones are intact.
    """
    folder = run / CHECKPOINTS / f"{iteration:08d}"
    try:
        shutil.rmtree(folder, ignore_errors=True)
        write_state(folder / _STATE, folder / _ABOUT, state, about)
    except ShuttleError as error:
        raise RunError(f"{folder}: cannot be written ({error}); free some space and continue with --resume") from error
    for old in complete(run)[:-_RETAINED]:
        shutil.rmtree(old, ignore_errors=True)


def last_checkpoint(run: Path) -> tuple[dict[str, Any], dict[str, torch.Tensor]] | None:
    """``about`` and ``state`` of the last checkpoint of a run, see :func:`save_checkpoint`; None if there is none.

    Raises:
        RunError: the last checkpoint is damaged.
    """
    if not (folders := complete(run)):
        return None
    folder = folders[-1]
    try:
        return read_state(folder / _STATE, folder / _ABOUT)
    except FileReadError as error:
        raise RunError(f"{folder}: cannot be read ({error}); delete it to continue from the one before") from error


def write_state(path: Path, about_path: Path, state: dict[str, torch.Tensor], about: dict[str, Any]) -> None:
    """Write tensors, and then a description with their hash."""
    # Some tensors share their memory, which safetensors refuses.
    replace_with_card(about_path, about, {path.name: save({name: tensor.clone() for name, tensor in state.items()})})


def read_state(path: Path, about_path: Path) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    """Read the description and the tensors of :func:`write_state`.

    Raises:
        FileReadError: a file is missing or damaged.
    """
    try:
        about = read_sealed(about_path)
        return about, load(read_hashed(path, hash_in(about, path.name)))
    except (OSError, ValueError, SafetensorError) as error:
        raise FileReadError(f"{path.name}: {problem(error)}") from error


def complete(run: Path) -> list[Path]:
    """Folders of the checkpoints, the last one last."""
    return sorted(path for path in (run / CHECKPOINTS).glob("[0-9]*") if (path / _ABOUT).is_file())
