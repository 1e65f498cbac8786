"""An algorithm as its run sees it: what it plays, how it learns, and its state in checkpoints.

A checkpoint is a folder ``checkpoints/ITERATION`` of the run folder that is whole or not there. It holds all that the next
iteration depends on: ``state.safetensors``, and ``about.json`` with the hashes of both.
"""

import dataclasses
import hashlib
import math
import os
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from tensordict import TensorDictBase
from torch import nn
from torch.optim import Optimizer
from torchrl.modules import ProbabilisticActor

from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import FileReadError, open_file, problem, read_sealed, replace_file, seal
from shuttle_marl.training.config import TrainingError

Tensors = dict[str, torch.Tensor]

CHECKPOINTS: Final = "checkpoints"
"""Folder of the checkpoints in the folder of a run."""
_STATE: Final = "state.safetensors"
_ABOUT: Final = "about.json"
_KEPT: Final = 2


class DivergedError(TrainingError):
    """Learning diverged: a loss, a weight or a probability is no finite number."""


@dataclasses.dataclass(kw_only=True)
class Learner:
    """An algorithm with its networks.

    Attributes:
        actor: the policy that collects.
        assess: ``[U, 6]`` observations to its ``[U, n]`` logits and the ``[U]`` values of the critic.
        distinct: whether it learns from distinct states or from strokes one by one (:mod:`shuttle_marl.training.collecting`).
        learn: learns from the strokes of one iteration, as the collector gives them; its second argument is
            the share of the run that remains, from 1 to 0. Returns what to log; raises :class:`DivergedError`.
        begin: called before the strokes of an iteration are collected, with the share of the run that remains.
        modules: networks and losses with weights, by name.
        optimizers: by name.
        shown: the policy that is evaluated and saved; None: the one that collects.
        remembered: gives everything else that a resumed run needs, as tensors by name.
        remember: takes over what ``remembered`` gave.
    """

    actor: ProbabilisticActor
    assess: Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]]
    distinct: bool
    learn: Callable[[TensorDictBase, float], dict[str, float]]
    modules: dict[str, nn.Module]
    optimizers: dict[str, Optimizer]
    shown: ProbabilisticActor | None = None
    begin: Callable[[float], None] = lambda _: None
    remembered: Callable[[], Tensors] = dict
    remember: Callable[[Tensors], None] = lambda _: None

    @property
    def played(self) -> ProbabilisticActor:
        """The policy that is evaluated and saved."""
        return self.shown or self.actor

    def state(self) -> Tensors:
        """Everything that a resumed run needs, as tensors by name; without randomness of its own."""
        tensors: Tensors = {}
        for name, module in self.modules.items():
            tensors |= {f"{name}.{part}": tensor.detach().cpu().contiguous() for part, tensor in module.state_dict().items()}
        for name, optimizer in self.optimizers.items():
            moments: dict[int, dict[str, Any]] = optimizer.state_dict()["state"]
            for number, entries in moments.items():
                for entry, value in entries.items():
                    tensors[f"{name}.{number}.{entry}"] = torch.as_tensor(value).detach().cpu().clone()
        return {**tensors, **self.remembered()}

    def restore(self, tensors: Tensors) -> None:
        """Take over what :meth:`state` gave."""
        for name, module in self.modules.items():
            module.load_state_dict(_under(name, tensors))
        for name, optimizer in self.optimizers.items():
            moments: dict[int, dict[str, torch.Tensor]] = {}
            for part, tensor in _under(name, tensors).items():
                number, _, entry = part.partition(".")
                moments.setdefault(int(number), {})[entry] = tensor
            optimizer.load_state_dict({"state": moments, "param_groups": optimizer.state_dict()["param_groups"]})
        self.remember(tensors)

    def check_weights(self) -> None:
        """Look for weights of the actor that are no finite numbers; checkpoints look at the rest.

        Raises:
            DivergedError: there is one.
        """
        check_finite(self.actor.parameters())


def check_finite(tensors: Iterable[torch.Tensor]) -> None:
    """Look for numbers that are not finite.

    Raises:
        DivergedError: there is one.
    """
    if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors if tensor.is_floating_point()):
        raise DivergedError("a weight is no finite number")


def _under(prefix: str, tensors: Tensors) -> Tensors:
    return {name.removeprefix(f"{prefix}."): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}.")}


def set_rate(optimizer: Optimizer, rate: float, remaining: float) -> None:
    """Let the learning rate fall linearly to a fiftieth."""
    for group in optimizer.param_groups:
        group["lr"] = rate * max(remaining, 0.02)


def weighted_sums(terms: TensorDictBase, weight: torch.Tensor) -> TensorDictBase:
    """The terms of a loss over distinct states, as they are over all strokes.

    Args:
        terms: of a loss of TorchRL without reduction: the objective of every row, whose advantages are divided by the number of
            strokes, and what else there is of every state.
        weight: ``[U]`` share of the strokes that were played in each state.
    """
    summed = {name: (terms[name].reshape(-1) * weight).sum() for name in ("loss_critic", "loss_entropy")}
    return terms.copy().update({**summed, "loss_objective": terms["loss_objective"].sum()})


class Mean:
    """Means of some terms of a loss over gradient steps.

    Args:
        names: of the terms.
    """

    def __init__(self, *names: str) -> None:
        self._totals, self._count = dict.fromkeys(names, 0.0), 0

    def add(self, terms: TensorDictBase) -> None:
        """Add the terms of a gradient step.

        Raises:
            DivergedError: one is no finite number.
        """
        self._count += 1
        for name in self._totals:
            value = terms[name].mean().item()
            if not math.isfinite(value):
                raise DivergedError(f"{name} became {value}")
            self._totals[name] += value

    def values(self) -> dict[str, float]:
        """The means by name."""
        return {name: total / self._count for name, total in self._totals.items()}


def save_checkpoint(run: Path, iteration: int, state: Tensors, about: dict[str, Any]) -> Path:
    """Write a checkpoint and remove all but the latest ones.

    Args:
        run: folder of the run.
        iteration: how many there were.
        state: of the learner.
        about: what else is to be restored, as JSON.

    Raises:
        TrainingError: it cannot be written; the ones before are whole.
    """
    target = run / CHECKPOINTS / f"{iteration:08d}"
    beside = target.with_name(f".{target.name}.part")
    # Each tensor by itself: some share their memory, which safetensors refuses.
    content = save({name: tensor.clone() for name, tensor in state.items()})
    hashes = {_STATE: hashlib.sha256(content).hexdigest()}
    try:
        shutil.rmtree(beside, ignore_errors=True)
        replace_file(beside / _STATE, content)
        replace_file(beside / _ABOUT, seal({"iteration": iteration, "sha256": hashes, **about}))
        shutil.rmtree(target, ignore_errors=True)
        os.replace(beside, target)
    except (OSError, ShuttleError) as error:
        raise TrainingError(f"{target}: cannot be written ({error}); make room and continue with --resume") from error
    for old in _whole(run)[:-_KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return target


def last_checkpoint(run: Path) -> tuple[dict[str, Any], Tensors] | None:
    """The last checkpoint of a run: what :func:`save_checkpoint` was given; None without one.

    Raises:
        TrainingError: the last checkpoint is damaged.
    """
    found = _whole(run)
    if not found:
        return None
    folder = found[-1]
    try:
        about = read_sealed(folder / _ABOUT)
        with open_file(folder / _STATE) as file:
            content = file.read()
        if about.get("sha256") != {_STATE: hashlib.sha256(content).hexdigest()}:
            raise FileReadError(f"{_STATE} does not fit its hash in {_ABOUT}")
        return about, load(content)
    except OSError as error:
        reason = problem(error)
    except (SafetensorError, ShuttleError) as error:
        reason = str(error)
    raise TrainingError(f"{folder}: cannot be read ({reason}); delete it to continue from the one before")


def _whole(run: Path) -> list[Path]:
    return sorted(path for path in (run / CHECKPOINTS).glob("[0-9]*") if (path / _ABOUT).is_file())
