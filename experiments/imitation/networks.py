"""Residual networks of the imitator: the shot type, and the area given the shot type.

Every second network also reads each number as its step on a quantile scale, and so learns thresholds where the others are smooth.
During the fit the contact height and each player are hidden in a fraction of the strokes.
"""

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Final, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from experiments.imitation.context import CODES, UNSEEN_HEIGHT, HitContexts, cuts_of, steps_of
from shuttle_marl.base.arrays import F32, F64, I64
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS

_LIMIT: Final = 4.0
"""Standardised numbers are cut off here: single points in the files are far off."""
_CHUNK: Final = 4096
_HEIGHT: Final = list(CODES).index("height")
_STRIKER: Final = len(CODES)
"""Column of the striker; followed by the receiver and the steps."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class NetworksConfig:
    """Settings of the fit; chosen on held-out matches of the training split.

    Attributes:
        members: networks of the ensemble.
        epochs: passes over the strokes.
        batch: strokes per step.
        learning_rate: peak of the one-cycle schedule of AdamW.
        decay: weight decay of matrices and embeddings.
        width: hidden units of a layer.
        layers: number of hidden layers.
        dropout: dropout probability of hidden units.
        steps: steps of the quantile scales that every second network reads.
        hide_height: fraction of strokes whose contact height is hidden during the fit.
        hide_player: fraction of strokes whose striker is hidden during the fit, and of those whose receiver is.
    """

    members: int = 6
    epochs: int = 8
    batch: int = 1024
    learning_rate: float = 0.012
    decay: float = 0.5
    width: int = 256
    layers: int = 3
    dropout: float = 0.3
    steps: int = 8
    hide_height: float = 0.5
    hide_player: float = 0.1


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Context manager: PyTorch computes each operation in the calling thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Network(nn.Module):
    """Standardised numbers ``[B, F]`` and columns of codes ``[B, C]`` to logits ``[B, 13]`` and ``[B, 13, 9]``."""

    def __init__(self, numbers: int, columns: int, config: NetworksConfig) -> None:
        super().__init__()
        self.numbers = nn.Linear(numbers, config.width)
        self.codes = nn.EmbeddingBag(columns, config.width, mode="sum")
        nn.init.normal_(self.codes.weight, std=0.03)
        self.inner = nn.ModuleList(nn.Linear(config.width, config.width) for _ in range(config.layers - 1))
        self.norms = nn.ModuleList(nn.LayerNorm(config.width) for _ in range(config.layers))
        self.last = nn.Linear(config.width, N_SHOTS * (1 + N_AREAS))

    def forward(
        self, numbers: Tensor, columns: Tensor, dropout: float = 0.0, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor]:
        def drop(hidden: Tensor) -> Tensor:
            if dropout == 0:
                return hidden
            mask = (torch.rand(hidden.shape, generator=generator) >= dropout).to(hidden.dtype)
            return hidden * (mask / (1 - dropout))

        hidden = drop(self.norms[0](functional.silu(self.numbers(numbers) + self.codes(columns))))
        for inner, norm in zip(self.inner, list(self.norms)[1:], strict=True):
            hidden = drop(norm(hidden + functional.silu(inner(hidden))))
        logits = self.last(hidden)
        return logits[:, :N_SHOTS], logits[:, N_SHOTS:].view(-1, N_SHOTS, N_AREAS)


class TrainingStrokes(NamedTuple):
    """Training data of the networks.

    Attributes:
        numbers, columns: inputs, as returned by :meth:`ImitatorNetworks.inputs`.
        shot: ``[N]`` shot types.
        area: ``[N]`` areas, -1 where unknown.
    """

    numbers: Tensor
    columns: Tensor
    shot: Tensor
    area: Tensor


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ImitatorNetworks:
    """Ensemble of networks.

    Attributes:
        config: settings of the fit.
        players: number of players, without the average player.
        mean, scale: ``[F]`` mean and standard deviation of each number.
        cuts: ``[F, steps - 1]`` increasing cuts between the steps of the quantile scale of each number.
        members: the networks.
    """

    config: NetworksConfig
    players: int
    mean: F32
    scale: F32
    cuts: F32
    members: nn.ModuleList

    @classmethod
    def untrained(cls, contexts: HitContexts, players: int, config: NetworksConfig, seed: int) -> Self:
        """Networks with random weights, scaled by the contexts of the training strokes."""
        mean, scale = _scales(contexts.numbers)
        with torch.random.fork_rng(devices=()):
            torch.manual_seed(seed)
            members = nn.ModuleList(_network(len(mean), players, config, k) for k in range(config.members))
        cuts = cuts_of(contexts.numbers, config.steps)
        return cls(config=config, players=players, mean=mean, scale=scale, cuts=cuts, members=members)

    def inputs(self, contexts: HitContexts, players: I64) -> tuple[Tensor, Tensor]:
        """Inputs of the networks.

        Args:
            contexts: of N strokes.
            players: ``[N, 2]`` codes of striker and receiver, 0 for the average player.

        Returns:
            ``[N, F]`` standardised numbers, 0 where unknown; ``[N, 20 + F]`` columns of codes, players, and steps.
        """
        numbers = np.clip((contexts.numbers - self.mean) / self.scale, -_LIMIT, _LIMIT)
        codes = np.concatenate([contexts.codes, players, steps_of(contexts.numbers, self.cuts)], axis=1)
        return torch.from_numpy(np.nan_to_num(numbers)), torch.from_numpy(codes + self._starts)

    def train(self, member: int, seed: int, strokes: TrainingStrokes) -> None:
        """Fit one member.

        Args:
            member: index of the network.
            seed: random seed.
            strokes: training data.
        """
        config, starts, shot, area = self.config, self._starts, strokes.shot, strokes.area
        network, columns = self.members[member], _member_columns(strokes.columns, member)
        generator = torch.Generator().manual_seed(seed)
        weights = list(network.parameters())
        groups: list[dict[str, list[nn.Parameter] | float]] = [
            {"params": [w for w in weights if w.ndim > 1], "weight_decay": config.decay},
            {"params": [w for w in weights if w.ndim == 1], "weight_decay": 0.0},
        ]
        optimiser = torch.optim.AdamW(groups, lr=config.learning_rate, fused=True)
        size = min(config.batch, len(shot))
        steps = len(shot) // size
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, max_lr=config.learning_rate, total_steps=config.epochs * steps + 1, pct_start=0.15
        )
        hidden = (
            (_HEIGHT, int(starts[_HEIGHT]) + UNSEEN_HEIGHT, config.hide_height),
            (_STRIKER, int(starts[_STRIKER]), config.hide_player),
            (_STRIKER + 1, int(starts[_STRIKER + 1]), config.hide_player),
        )
        for _ in range(config.epochs):
            for rows in torch.randperm(len(shot), generator=generator)[: steps * size].view(steps, size):
                seen = columns[rows]
                for column, code, fraction in hidden:
                    seen[torch.rand(size, generator=generator) < fraction, column] = code
                types, areas = network(strokes.numbers[rows], seen, config.dropout, generator)
                of_type = areas[torch.arange(size), shot[rows]]
                over_types = torch.logsumexp(functional.log_softmax(types, 1)[:, :, None] + functional.log_softmax(areas, 2), 1)
                loss = functional.cross_entropy(types, shot[rows])
                loss = loss + functional.cross_entropy(of_type, area[rows], ignore_index=-1, reduction="sum") / size
                # The marginal probability of the area is fitted too: it follows from the other two, but less sharply.
                loss = loss + 0.5 * functional.nll_loss(over_types, area[rows], ignore_index=-1, reduction="sum") / size
                optimiser.zero_grad()
                torch.autograd.backward(loss)
                optimiser.step()
                schedule.step()

    def predict(self, contexts: HitContexts, players: I64) -> F64:
        """``[N, 13, 9]`` probability of each shot type and area; players as in :meth:`inputs`."""
        numbers, columns = self.inputs(contexts, players)
        out = np.zeros((len(contexts), N_SHOTS, N_AREAS))
        with torch.no_grad():
            for start in range(0, len(contexts), _CHUNK):
                part = slice(start, start + _CHUNK)
                for k, member in enumerate(self.members):
                    shot, area = member(numbers[part], _member_columns(columns[part], k))
                    joint = functional.softmax(shot.double(), dim=1)[:, :, None] * functional.softmax(area.double(), dim=2)
                    out[part] += joint.numpy() / len(self.members)
        return out

    @property
    def _starts(self) -> I64:
        """``[20 + F]`` first column of each code; for striker and receiver it is the average player."""
        sizes = [*CODES.values(), *2 * [self.players + 1], *len(self.mean) * [self.config.steps + 1]]
        return np.cumsum([0, *sizes[:-1]])


def _scales(numbers: F32) -> tuple[F32, F32]:
    """Mean ``[F]`` and standard deviation ``[F]`` of numbers ``[N, F]``, NaN ignored."""
    known = [column[np.isfinite(column)].astype(np.float64) for column in numbers.T]
    known = [column if len(column) else np.zeros(1) for column in known]
    return (
        np.array([column.mean() for column in known], dtype=np.float32),
        np.array([max(column.std(), 1e-6) for column in known], dtype=np.float32),
    )


def _network(numbers: int, players: int, config: NetworksConfig, member: int) -> _Network:
    """An untrained member."""
    columns = sum(CODES.values()) + 2 * (players + 1)
    return _Network(numbers, columns + (numbers * (config.steps + 1) if member % 2 else 0), config)


def _member_columns(columns: Tensor, member: int) -> Tensor:
    """Input columns of a member: every second one reads the steps as well."""
    return columns if member % 2 else columns[:, : _STRIKER + 2]
