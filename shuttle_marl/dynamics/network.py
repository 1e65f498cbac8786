"""Ensembles of small networks over attribute codes; all members are fitted and evaluated in batched matrix products.

A member is the sum of a linear model on one-hot attributes and selected products of attributes, and of a perceptron with two
hidden layers on the one-hot attributes. Every member leaves out one fold of the matches, so every row has out-of-fold
predictions.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from shuttle_marl.base.arrays import F64, I16, I64, Floats, Ints
from shuttle_marl.dynamics.features import SLOTS

_CHUNK: Final = 1024
"""Strokes of an evaluation: few enough that their hidden layers stay in the cache."""
Loss = Callable[[Tensor, Tensor], Tensor]
"""From the logits ``[K, B', outputs]`` of a batch and its row numbers ``[B]`` to losses ``[K, B]``."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class NetworkSpec:
    """Inputs, outputs and size of an ensemble.

    Attributes:
        inputs: names of attributes (:data:`shuttle_marl.dynamics.features.SLOTS`).
        crosses: tuples of inputs whose products enter the linear part.
        hidden: width of both hidden layers.
    """

    inputs: tuple[str, ...]
    crosses: tuple[tuple[str, ...], ...]
    outputs: int
    hidden: int = 64
    members: int = 10


def attributes(codes: dict[str, I16]) -> Tensor:
    """``[N, 15]`` int32 codes in the order of :data:`~shuttle_marl.dynamics.features.SLOTS`, the inputs of all modules.

    Attributes that are missing are 0: who reads them not may leave them out.
    """
    table = np.zeros((len(next(iter(codes.values()))), len(SLOTS)), dtype=np.int32)
    for k, name in enumerate(SLOTS):
        if name in codes:
            table[:, k] = codes[name]
    return torch.from_numpy(table)


def encode(spec: NetworkSpec, codes: Tensor) -> Tensor:
    """``[N, inputs + crosses]`` int32 active columns of the multi-hot input, from ``[N, 15]`` codes."""
    strides, offsets = (part.to(codes.device) for part in _columns(spec))
    # A product of doubles is exact here, and fast.
    return (codes.double() @ strides + offsets).int()


@functools.cache
def _columns(spec: NetworkSpec) -> tuple[Tensor, Tensor]:
    """``[15, C]`` weights of the codes in the number of an active column, and ``[C]`` first columns."""
    crosses = [*((name,) for name in spec.inputs), *spec.crosses]
    strides, widths = torch.zeros(len(SLOTS), len(crosses), dtype=torch.float64), []
    for column, cross in enumerate(crosses):
        width = 1
        for name in reversed(cross):
            strides[list(SLOTS).index(name), column] = width
            width *= SLOTS[name]
        widths.append(width)
    return strides, torch.tensor([0, *itertools.accumulate(widths[:-1])], dtype=torch.float64)


class Ensemble(nn.Module):
    """K networks from ``[N, 15]`` codes of :data:`~shuttle_marl.dynamics.features.SLOTS` to ``[K, N, outputs]`` logits.

    Rows of the weights are looked up and summed for all members at once; the multi-hot input is never materialised.
    """

    def __init__(self, spec: NetworkSpec) -> None:
        super().__init__()
        self.spec = spec
        simple = sum(SLOTS[name] for name in spec.inputs)
        width = simple + sum(math.prod(SLOTS[name] for name in cross) for cross in spec.crosses)
        k, hidden = spec.members, spec.hidden
        self.first = nn.Parameter(torch.zeros(simple, k, hidden))
        self.first_bias = nn.Parameter(torch.zeros(k, 1, hidden))
        self.second = nn.Parameter(torch.zeros(k, hidden, hidden))
        self.second_bias = nn.Parameter(torch.zeros(k, 1, hidden))
        self.last = nn.Parameter(torch.zeros(k, hidden, spec.outputs))
        self.last_bias = nn.Parameter(torch.zeros(k, 1, spec.outputs))
        self.linear = nn.Parameter(torch.zeros(width, k, spec.outputs))

    def initialise(self, generator: torch.Generator, prior: Tensor) -> None:
        """Random weights; ``prior`` is the ``[outputs]`` logits of an untrained network."""
        with torch.no_grad():
            hidden = self.spec.hidden
            scales = (
                (self.first, math.sqrt(2 / len(self.spec.inputs))),
                (self.second, math.sqrt(2 / hidden)),
                (self.last, 0.1 / math.sqrt(hidden)),
            )
            for weight, scale in scales:
                weight.copy_(torch.randn(weight.shape, generator=generator) * scale)
            self.last_bias.copy_(prior.expand_as(self.last_bias))

    def forward(self, codes: Tensor, dropout: float = 0.0, generator: torch.Generator | None = None) -> Tensor:
        """Logits ``[K, N, outputs]``; ``dropout`` applies to both hidden layers."""
        columns = encode(self.spec, codes)

        def drop(hidden: Tensor) -> Tensor:
            if dropout == 0:
                return hidden
            # One mask for all members: sampling ten would cost as much as the products.
            mask = (torch.rand(hidden.shape[1:], generator=generator) >= dropout).to(hidden.dtype)
            return hidden * (mask / (1 - dropout))

        def embedded(table: Tensor, indices: Tensor) -> Tensor:
            summed = functional.embedding_bag(indices, table.flatten(1), mode="sum")
            return summed.view(len(indices), *table.shape[1:]).transpose(0, 1)

        hidden = drop(torch.relu(embedded(self.first, columns[:, : len(self.spec.inputs)]) + self.first_bias))
        hidden = drop(torch.relu(torch.baddbmm(self.second_bias, hidden, self.second)))
        return torch.baddbmm(self.last_bias, hidden, self.last) + embedded(self.linear, columns)

    def logits(self, codes: dict[str, I16]) -> F64:
        """``[K, N, outputs]`` logits of N strokes."""
        return in_chunks(self, codes, axis=1)


def in_chunks(module: Callable[[Tensor], Tensor], codes: dict[str, I16], *, axis: int = 0) -> F64:
    """Results of a module on N strokes, evaluated some thousands at a time.

    Args:
        axis: that of the strokes in a result.
    """
    table = attributes(codes)
    with torch.no_grad():
        parts = [module(table[start : start + _CHUNK]) for start in range(0, max(1, len(table)), _CHUNK)]
    return np.concatenate([part.numpy() for part in parts], axis=axis)


@dataclasses.dataclass(frozen=True, kw_only=True)
class EnsembleConfig:
    """Settings of the fit of an ensemble, chosen on the validation matches.

    Attributes:
        learning_rate: peak of the one-cycle schedule of AdamW.
        decay: weight decay of the perceptron.
        decay_linear: weight decay of the linear part.
        dropout: dropout probability of hidden units.
        folds: number of folds of matches; member k leaves out fold k modulo this number.
        members: size of the ensemble; None: that of its :class:`NetworkSpec`.
    """

    epochs: int = 12
    batch: int = 1024
    learning_rate: float = 3e-3
    decay: float = 0.2
    decay_linear: float = 1e-3
    dropout: float = 0.2
    folds: int = 10
    members: int | None = None


QUICK: Final = EnsembleConfig(folds=5, members=5)
"""Half the cost, for refits and cross-validation; the out-of-fold log-loss is at most .2 % higher."""


def fold_of_match(matches: Ints, folds: int) -> I64:
    """``[N]`` fold of each row; matches are assigned to folds in turn, in the order of their first rows."""
    _, first, inverse = np.unique(matches, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return rank[inverse] % folds


def fit_ensemble(
    spec: NetworkSpec,
    codes: dict[str, I16],
    loss: Loss,
    matches: Ints,
    prior: Floats,
    config: EnsembleConfig,
    seed: int,
    expand: Callable[[Tensor], Tensor] | None = None,
) -> Ensemble:
    """Fit all members at once; weights are rounded to half precision, in which they are stored, and computed with in double.

    Args:
        codes: ``[M]`` codes of the inputs.
        matches: ``[N]`` match of each row; the rows of a member's fold have weight zero.
        prior: ``[outputs]`` logits of an untrained network.
        expand: maps row numbers to the rows of ``codes`` that the loss needs; None: the same rows.
    """
    generator = torch.Generator().manual_seed(seed)
    spec = dataclasses.replace(spec, members=config.members or spec.members)
    model = Ensemble(spec)
    model.initialise(generator, torch.as_tensor(prior, dtype=torch.float32))
    inputs = attributes(codes)
    n = len(matches)
    fold = torch.from_numpy(fold_of_match(matches, config.folds))
    member_fold = torch.arange(spec.members) % config.folds
    weight = (fold[None, :] != member_fold[:, None]).float()
    weight /= weight.mean(dim=1, keepdim=True)
    groups = [
        {"params": [model.first, model.second, model.last], "weight_decay": config.decay},
        {"params": [model.linear], "weight_decay": config.decay_linear},
        {"params": [model.first_bias, model.second_bias, model.last_bias], "weight_decay": 0.0},
    ]
    optimiser = torch.optim.AdamW(groups, lr=config.learning_rate, fused=True)
    steps_per_epoch = max(1, n // config.batch)
    steps = config.epochs * steps_per_epoch
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, max_lr=config.learning_rate, total_steps=steps + 1, pct_start=0.15)
    for step in range(steps):
        if step % steps_per_epoch == 0:
            order = torch.randperm(n, generator=generator)
        start = step % steps_per_epoch * config.batch
        rows = order[start : start + config.batch]
        logits = model(inputs[rows if expand is None else expand(rows)], config.dropout, generator)
        total = (loss(logits, rows) * weight[:, rows]).mean(dim=1).sum()
        optimiser.zero_grad()
        torch.autograd.backward(total)
        optimiser.step()
        schedule.step()
    model.requires_grad_(False)
    # Half of the space in a file, which holds the model as it predicts.
    for weight in model.parameters():
        weight.copy_(weight.half())
    return model.double().eval()


def unseen(values: F64, matches: Ints, folds: int) -> F64:
    """Out-of-fold mean ``[N, ...]`` of ``[K, N, ...]`` values: over the members that were not fitted to a row's match."""
    fold = fold_of_match(matches, folds)
    left_out = (np.arange(len(values)) % folds)[:, None] == fold[None, :]
    extra = (1,) * (values.ndim - 2)
    return (values * left_out.reshape(*left_out.shape, *extra)).sum(axis=0) / left_out.sum(axis=0).reshape(-1, *extra)
