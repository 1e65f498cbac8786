"""What an algorithm is to the run that feeds it, and how its state becomes tensors that can be stored."""

import math
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from torch import nn
from torch.optim import Optimizer
from torchrl.modules import ProbabilisticActor

from shuttle_marl.training.config import TrainingError

Tensors = dict[str, torch.Tensor]


class Learner(Protocol):
    """An algorithm with its networks.

    Attributes:
        actor: the policy that collects.
    """

    actor: ProbabilisticActor

    def learn(self, data: TensorDictBase, left: float) -> dict[str, float]:
        """Learn from the strokes of one iteration.

        Args:
            data: ``[rows, steps]`` as the collector gives them.
            left: share of the run that is still to come, from 1 to 0.

        Returns:
            What to log.

        Raises:
            NotFiniteError: a loss or a weight is no finite number.
        """
        ...

    def state(self) -> Tensors:
        """Everything that a resumed run needs, as tensors by name; without randomness of its own."""
        ...

    def restore(self, tensors: Tensors) -> None:
        """Take over what :meth:`state` gave."""
        ...


class NotFiniteError(TrainingError):
    """Learning went astray: a loss is no finite number."""


def checked(losses: dict[str, float]) -> dict[str, float]:
    """The losses, if all are finite.

    Raises:
        NotFiniteError: one is not.
    """
    for name, value in losses.items():
        if not math.isfinite(value):
            raise NotFiniteError(f"{name} became {value}")
    return losses


def module_state(prefix: str, module: nn.Module) -> Tensors:
    """Weights and buffers of a module, by name."""
    return {f"{prefix}.{name}": tensor.detach().cpu().contiguous() for name, tensor in module.state_dict().items()}


def restore_module(prefix: str, module: nn.Module, tensors: Tensors) -> None:
    """Take over weights and buffers that :func:`module_state` gave."""
    module.load_state_dict(_under(prefix, tensors))


def optimizer_state(prefix: str, optimizer: Optimizer) -> Tensors:
    """Moments and step counts of an optimiser, by number of the parameter."""
    stored: dict[int, dict[str, Any]] = optimizer.state_dict()["state"]
    return {
        f"{prefix}.{number}.{name}": torch.as_tensor(value).detach().cpu().clone()
        for number, entries in stored.items()
        for name, value in entries.items()
    }


def restore_optimizer(prefix: str, optimizer: Optimizer, tensors: Tensors) -> None:
    """Take over what :func:`optimizer_state` gave."""
    state: dict[int, dict[str, torch.Tensor]] = {}
    for name, tensor in _under(prefix, tensors).items():
        number, _, entry = name.partition(".")
        state.setdefault(int(number), {})[entry] = tensor
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _under(prefix: str, tensors: Tensors) -> Tensors:
    return {name.removeprefix(f"{prefix}."): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}.")}


def set_rate(optimizer: Optimizer, rate: float, left: float) -> None:
    """Let the learning rate fall linearly to a fiftieth."""
    for group in optimizer.param_groups:
        group["lr"] = rate * max(left, 0.02)
