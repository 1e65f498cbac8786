"""Fits an ensemble: every member leaves out one fold of the matches, so that unseen predictions exist for every row."""

import dataclasses
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from shuttle_marl.dynamics.network import Ensemble, Spec

Loss = Callable[[Tensor, Tensor], Tensor]
"""From the logits ``[K, B', outputs]`` of a batch and its row numbers ``[B]`` to losses ``[K, B]``."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """How an ensemble is fitted; chosen on the validation matches.

    Attributes:
        epochs: passes over the rows.
        batch: rows a step.
        learning_rate: peak of the one-cycle schedule of AdamW.
        decay: weight decay of the perceptron.
        decay_linear: weight decay of the linear part.
        dropout: share of hidden units left out.
        folds: number of folds of matches; member k leaves out fold k modulo this number.
    """

    epochs: int = 12
    batch: int = 1024
    learning_rate: float = 3e-3
    decay: float = 0.2
    decay_linear: float = 1e-3
    dropout: float = 0.2
    folds: int = 10


def fold_of_match(matches: npt.NDArray[np.integer], folds: int) -> npt.NDArray[np.int64]:
    """``[N]`` fold of each row: matches are dealt to the folds in the order of their first row."""
    _, first, inverse = np.unique(matches, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return rank[inverse] % folds


def fit_ensemble(
    spec: Spec,
    columns: npt.NDArray[np.int32],
    loss: Loss,
    matches: npt.NDArray[np.integer],
    prior: npt.NDArray[np.floating],
    config: TrainingConfig,
    seed: int,
    expand: Callable[[Tensor], Tensor] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Ensemble:
    """Fit all members at once.

    Args:
        spec: the network.
        columns: ``[M, C]`` active columns of the inputs (see :func:`shuttle_marl.dynamics.network.encode`).
        loss: loss of a batch.
        matches: ``[N]`` match of each row; rows of a member's fold get weight zero.
        prior: ``[outputs]`` logits of an untrained network.
        config: how.
        seed: of initial weights, order of rows and dropout.
        expand: from row numbers to the rows of ``columns`` that the loss needs; default the same rows.
        progress: called with the share of steps done.
    """
    generator = torch.Generator().manual_seed(seed)
    model = Ensemble(spec)
    model.initialise(generator, torch.as_tensor(prior, dtype=torch.float32))
    inputs = torch.from_numpy(columns)
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
    optimiser = torch.optim.AdamW(groups, lr=config.learning_rate)
    steps_an_epoch = max(1, n // config.batch)
    steps = config.epochs * steps_an_epoch
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, max_lr=config.learning_rate, total_steps=steps + 1, pct_start=0.15)
    for step in range(steps):
        if step % steps_an_epoch == 0:
            order = torch.randperm(n, generator=generator)
        start = step % steps_an_epoch * config.batch
        rows = order[start : start + config.batch]
        logits = model(inputs[rows if expand is None else expand(rows)], config.dropout, generator)
        total = (loss(logits, rows) * weight[:, rows]).mean(dim=1).sum()
        optimiser.zero_grad()
        torch.autograd.backward(total)
        optimiser.step()
        schedule.step()
        if progress is not None:
            progress((step + 1) / steps)
    return model.requires_grad_(False).eval()


def predict(model: Ensemble, columns: npt.NDArray[np.int32], chunk: int = 1024) -> npt.NDArray[np.float64]:
    """Logits ``[K, N, outputs]`` in double precision."""
    double = Ensemble(model.spec).double().requires_grad_(False)
    double.load_state_dict(model.state_dict())
    inputs = torch.from_numpy(columns)
    out = np.empty((model.spec.members, len(columns), model.spec.outputs))
    for start in range(0, len(columns), chunk):
        out[:, start : start + chunk] = double(inputs[start : start + chunk]).numpy()
    return out


def unseen(logits: npt.NDArray[np.float64], matches: npt.NDArray[np.integer], folds: int) -> npt.NDArray[np.float64]:
    """Mean of the members that did not see a row's match: ``[K, N, ...]`` values to ``[N, ...]``."""
    fold = fold_of_match(matches, folds)
    blind = (np.arange(len(logits)) % folds)[:, None] == fold[None, :]
    extra = (1,) * (logits.ndim - 2)
    return (logits * blind.reshape(*blind.shape, *extra)).sum(axis=0) / blind.sum(axis=0).reshape(-1, *extra)
