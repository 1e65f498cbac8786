"""Ensembles of small networks over attribute codes; all members run as one batched product.

A member is a linear model on one-hot attributes and chosen products of attributes, plus a two-layer perceptron on the
one-hot attributes. The linear part learns the large, sparse effects, the perceptron what they share.
"""

import dataclasses
import math

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from shuttle_marl.dynamics.features import SLOTS, Codes


@dataclasses.dataclass(frozen=True, kw_only=True)
class Spec:
    """What a network reads and returns.

    Attributes:
        inputs: names of slots (:data:`shuttle_marl.dynamics.features.SLOTS`).
        crosses: tuples of inputs whose products enter linearly.
        outputs: number of logits.
        hidden: width of both hidden layers.
        members: size of the ensemble.
    """

    inputs: tuple[str, ...]
    crosses: tuple[tuple[str, ...], ...]
    outputs: int
    hidden: int = 64
    members: int = 10


def encode(spec: Spec, codes: dict[str, Codes]) -> npt.NDArray[np.int32]:
    """``[N, inputs + crosses]`` columns of the multi-hot input that are 1."""
    columns, offset = [], 0
    for name in spec.inputs:
        columns.append(codes[name].astype(np.int32) + offset)
        offset += SLOTS[name]
    for cross in spec.crosses:
        index = np.zeros(len(columns[0]), dtype=np.int32)
        for name in cross:
            index = index * SLOTS[name] + codes[name]
        columns.append(index + offset)
        offset += math.prod(SLOTS[name] for name in cross)
    return np.stack(columns, axis=1)


class Ensemble(nn.Module):
    """K members: ``[N, C]`` active columns to ``[K, N, outputs]`` logits.

    Active columns are looked up and summed for all members at once, so the wide one-hot input never exists.
    """

    def __init__(self, spec: Spec) -> None:
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
        """Random weights, and ``prior`` (``[outputs]`` logits) as what an untrained network says."""
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

    def forward(self, columns: Tensor, dropout: float = 0.0, generator: torch.Generator | None = None) -> Tensor:
        """Logits ``[K, N, outputs]``; ``dropout`` applies to both hidden layers."""

        def drop(hidden: Tensor) -> Tensor:
            if dropout == 0:
                return hidden
            return hidden * (torch.rand(hidden.shape, generator=generator) >= dropout) / (1 - dropout)

        def looked_up(table: Tensor, which: Tensor) -> Tensor:
            summed = functional.embedding_bag(which, table.flatten(1), mode="sum")
            return summed.view(len(which), *table.shape[1:]).transpose(0, 1)

        hidden = drop(torch.relu(looked_up(self.first, columns[:, : len(self.spec.inputs)]) + self.first_bias))
        hidden = drop(torch.relu(torch.baddbmm(self.second_bias, hidden, self.second)))
        return torch.baddbmm(self.last_bias, hidden, self.last) + looked_up(self.linear, columns)
