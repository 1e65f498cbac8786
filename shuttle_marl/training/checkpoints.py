"""Checkpoints of a run: everything that the next iteration depends on, in folders that are whole or not there."""

import json
import os
import shutil
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import replace_file
from shuttle_marl.training.config import TrainingError
from shuttle_marl.training.learner import Tensors

FOLDER: Final = "checkpoints"
_STATE: Final = "state.safetensors"
_ABOUT: Final = "about.json"
_KEPT: Final = 2


def save_checkpoint(run: Path, iteration: int, state: Tensors, about: dict[str, Any]) -> Path:
    """Write a checkpoint and remove all but the latest ones.

    Raises:
        TrainingError: it cannot be written; the ones before are whole.
    """
    target = run / FOLDER / f"{iteration:08d}"
    beside = target.with_name(f".{target.name}.part")
    try:
        shutil.rmtree(beside, ignore_errors=True)
        # Each tensor by itself: some share their memory, which safetensors refuses.
        replace_file(beside / _STATE, save({name: tensor.clone() for name, tensor in state.items()}))
        replace_file(beside / _ABOUT, json.dumps({"iteration": iteration, **about}).encode())
        shutil.rmtree(target, ignore_errors=True)
        os.replace(beside, target)
    except (OSError, ShuttleError) as error:
        raise TrainingError(f"{target}: cannot be written ({error}); make room and go on with --resume") from error
    for old in _whole(run)[:-_KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return target


def last_checkpoint(run: Path) -> tuple[dict[str, Any], Tensors] | None:
    """What was saved last, or None where nothing was.

    Raises:
        TrainingError: the last checkpoint is damaged.
    """
    found = _whole(run)
    if not found:
        return None
    folder = found[-1]
    try:
        about: dict[str, Any] = json.loads((folder / _ABOUT).read_text(encoding="utf-8"))
        with safe_open(folder / _STATE, framework="pt") as file:
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  not a mapping
    except (OSError, SafetensorError, ValueError) as error:
        raise TrainingError(f"{folder}: cannot be read ({error}); delete it to go on from the one before") from error
    return about, state


def finite(state: Tensors) -> bool:
    """Whether all numbers are finite."""
    return all(bool(torch.isfinite(tensor).all()) for tensor in state.values() if tensor.is_floating_point())


def _whole(run: Path) -> list[Path]:
    return sorted(path for path in (run / FOLDER).glob("[0-9]*") if (path / _ABOUT).is_file())
