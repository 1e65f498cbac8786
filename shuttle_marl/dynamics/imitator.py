"""The imitator: what a player will do next, from all that can be seen at the moment of the hit.

The players of the game (``bc``) know the state of the game only. The imitator reads positions, tempo, four strokes and the
players as well (:mod:`shuttle_marl.dynamics.moments`), so it predicts people better and cannot play the game. An ensemble of
residual networks gives the shot type, and the area given the shot type. During the fit the contact height and each player are
hidden now and then, so one model answers with and without them, and knows an average player for those it never saw. Every
second network reads each number as the step of a quantile scale as well: it finds thresholds, as trees do, where the others
are smooth, and the two err differently.

    imitator = Imitator.fit(load_strokes("train.parquet"))
    probability = imitator.predict(load_strokes("new.parquet"))  # [N, 13, 9]
"""

import contextlib
import dataclasses
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import torch
from safetensors.torch import save
from torch import Tensor, nn
from torch.nn import functional

from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import rows_from_strokes
from shuttle_marl.dynamics.fitted import ModelError
from shuttle_marl.dynamics.moments import CODES, UNSEEN_HEIGHT, Moments, moments_of
from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import replace_file
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.tensor_files import checked, parsed, read_tensors

Floats = npt.NDArray[np.float64]

WORKERS: Final = 2
"""Networks that are fitted at the same time, each in one thread: sums in another order would give other weights."""
_LIMIT: Final = 4.0
"""Standardised numbers are cut off here: single points in the files are far off."""
_CHUNK: Final = 4096
_HEIGHT: Final = list(CODES).index("height")
_STRIKER: Final = len(CODES)
"""Column of the striker; that of the receiver follows, and then those of the steps."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ImitatorConfig:
    """Settings of the fit; chosen on matches left out of the training matches.

    Attributes:
        members: networks of the ensemble.
        epochs: passes over the strokes.
        batch: strokes a step.
        learning_rate: peak of the one-cycle schedule of AdamW.
        decay: weight decay of matrices and embeddings.
        width: hidden units of a layer.
        layers: number of hidden layers.
        dropout: share of hidden units left out.
        steps: of the quantile scales that every second network reads.
        hide_height: share of strokes whose contact height is hidden during the fit.
        hide_player: share of strokes whose striker is hidden during the fit, and share of those whose receiver is.
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


def _silent(line: str) -> None:
    del line


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Network(nn.Module):
    """Standardised numbers ``[B, F]`` and columns of codes ``[B, C]`` to logits ``[B, 13]`` and ``[B, 13, 9]``."""

    def __init__(self, numbers: int, columns: int, config: ImitatorConfig) -> None:
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
            kept = (torch.rand(hidden.shape, generator=generator) >= dropout).to(hidden.dtype)
            return hidden * (kept / (1 - dropout))

        hidden = drop(self.norms[0](functional.silu(self.numbers(numbers) + self.codes(columns))))
        for inner, norm in zip(self.inner, list(self.norms)[1:], strict=True):
            hidden = drop(norm(hidden + functional.silu(inner(hidden))))
        logits = self.last(hidden)
        return logits[:, :N_SHOTS], logits[:, N_SHOTS:].view(-1, N_SHOTS, N_AREAS)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Imitator:
    """A fitted imitator.

    Attributes:
        config: of the fit.
        players: identifiers of the players that it knows; everyone else is the average player.
        mean, scale: ``[F]`` of the numbers of a moment.
        cuts: ``[F, steps - 1]`` rising, between the steps of the quantile scale of each number.
        members: the networks.
    """

    config: ImitatorConfig
    players: tuple[str, ...]
    mean: npt.NDArray[np.float32]
    scale: npt.NDArray[np.float32]
    cuts: npt.NDArray[np.float32]
    members: nn.ModuleList

    @classmethod
    def fit(
        cls,
        strokes: pa.Table,
        *,
        config: ImitatorConfig | None = None,
        seed: int = 0,
        report: Callable[[str], None] = _silent,
    ) -> "Imitator":
        """Fit an imitator; about a minute on two cores for 50,000 strokes.

        The area of a fault does not say where it was aimed, so faults teach the shot type alone. That of a winner is the one in
        which a receiver would have met it (:mod:`shuttle_marl.dynamics.landings`).

        Args:
            strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`.
            config: settings.
            seed: of all random numbers; the same seed gives the same weights.
            report: called with a line before each member.

        Raises:
            ShuttleError: a table without strokes.
        """
        if not strokes.num_rows:
            raise ShuttleError("no stroke to learn from; is the data complete?")
        config = config or ImitatorConfig()
        moments = moments_of(strokes)
        mean, scale, cuts = _scales(moments.numbers, config.steps)
        imitator = cls(
            config=config,
            players=tuple(sorted({*moments.striker.tolist(), *moments.receiver.tolist()})),
            mean=mean,
            scale=scale,
            cuts=cuts,
            members=nn.ModuleList(),
        )
        numbers, columns = imitator._inputs(moments)
        rows = rows_from_strokes(strokes)
        shot = torch.from_numpy(rows.codes["shot"].astype(np.int64))
        area = torch.from_numpy(np.where(rows.outcome == Outcome.FAULT, -1, rows.codes["area"]).astype(np.int64))
        with torch.random.fork_rng(devices=()):
            torch.manual_seed(seed)
            imitator.members.extend(_network(len(mean), len(imitator.players), config, k) for k in range(config.members))

        def train(member: int) -> None:
            report(f"imitator, network {member + 1} of {config.members}")
            _train(imitator, member, 1000 * seed + member, numbers, columns, shot, area)

        with _one_thread(), ThreadPoolExecutor(WORKERS) as pool:
            list(pool.map(train, range(config.members)))
        imitator.members.requires_grad_(False).eval()
        return imitator

    def predict(self, strokes: pa.Table, *, height_known: bool = True, striker: str | None = None) -> Floats:
        """``[N, 13, 9]`` probability of each shot type and area, for every stroke of a table.

        Nothing after the hit is read: outcome, landing and shot type of a stroke change nothing, nor do later rows.

        Args:
            strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, whole rallies.
            height_known: whether the height at which the shuttle is met may be read.
            striker: play every stroke as this player would; an unknown name means the average player.
        """
        moments = moments_of(strokes)
        if not height_known:
            moments = moments.without_height()
        if striker is not None:
            moments = dataclasses.replace(moments, striker=np.full(len(moments), striker))
        numbers, columns = self._inputs(moments)
        out = np.zeros((len(moments), N_SHOTS, N_AREAS))
        with torch.no_grad():
            for start in range(0, len(moments), _CHUNK):
                part = slice(start, start + _CHUNK)
                for k, member in enumerate(self.members):
                    shot, area = member(numbers[part], _read(columns[part], k))
                    joint = functional.softmax(shot.double(), dim=1)[:, :, None] * functional.softmax(area.double(), dim=2)
                    out[part] += joint.numpy() / len(self.members)
        return out

    def save(self, path: Path) -> None:
        """Write a safetensors file.

        Raises:
            FileWriteError: the file cannot be written.
        """
        tensors = {name: weight.contiguous() for name, weight in self.members.state_dict().items()}
        tensors |= {
            "mean": torch.from_numpy(self.mean),
            "scale": torch.from_numpy(self.scale),
            "cuts": torch.from_numpy(self.cuts),
        }
        described = {"config": dataclasses.asdict(self.config), "players": self.players}
        # One entry only: safetensors writes several in no fixed order, and the same fit must give the same file.
        replace_file(path, save(tensors, metadata={"imitator": json.dumps(described, sort_keys=True)}))

    @classmethod
    def load(cls, path: Path) -> "Imitator":
        """Read a file written by :meth:`save`.

        Raises:
            ModelError: there is no such file, or it holds no imitator.
        """
        try:
            header, arrays = read_tensors(path)
            described = parsed(header["imitator"])
            config = ImitatorConfig(**described["config"])
            players = tuple(map(str, described["players"]))
            f = arrays["mean"].shape
            shapes = {"mean": f, "scale": f, "cuts": (*f, config.steps - 1)}
            # Without memory of its own: what a file describes may be of any size, its weights are as large as the file.
            with torch.device("meta"):
                members = nn.ModuleList(_network(f[0], len(players), config, k) for k in range(config.members))
            state = {name: torch.from_numpy(checked(weight, np.float32, weight.shape)) for name, weight in arrays.items()}
            scales = {name: checked(state.pop(name).numpy(), np.float32, shape) for name, shape in shapes.items()}
            members.load_state_dict(state, assign=True)
            members.requires_grad_(False).eval()
            return cls(config=config, players=players, members=members, **scales)
        except (OSError, KeyError, TypeError, ValueError, RuntimeError, AttributeError, IndexError) as error:
            raise ModelError(f"{path}: no readable imitator ({error}); fit it again") from error

    def _inputs(self, moments: Moments) -> tuple[Tensor, Tensor]:
        """``[N, F]`` standardised numbers, 0 where not known; ``[N, 20 + F]`` columns of codes, players, and steps."""
        numbers = np.clip((moments.numbers - self.mean) / self.scale, -_LIMIT, _LIMIT)
        position = {player: i for i, player in enumerate(self.players, start=1)}
        who = [[position.get(name, 0) for name in names.tolist()] for names in (moments.striker, moments.receiver)]
        steps = np.stack(
            [np.searchsorted(cuts, values) for cuts, values in zip(self.cuts, moments.numbers.T, strict=True)], axis=1
        )
        steps[np.isnan(moments.numbers)] = self.config.steps
        codes = np.concatenate([moments.codes, np.array(who, dtype=np.int64).reshape(2, -1).T, steps], axis=1)
        return torch.from_numpy(np.nan_to_num(numbers)), torch.from_numpy(codes + self._starts)

    @property
    def _starts(self) -> npt.NDArray[np.int64]:
        """``[20 + F]`` first column of each code; of striker and receiver it is that of the average player."""
        sizes = [*CODES.values(), *2 * [len(self.players) + 1], *len(self.mean) * [self.config.steps + 1]]
        return np.cumsum([0, *sizes[:-1]])


def _scales(numbers: npt.NDArray[np.float32], steps: int) -> tuple[npt.NDArray[np.float32], ...]:
    """Mean ``[F]``, standard deviation ``[F]`` and quantiles ``[F, steps - 1]`` of numbers ``[N, F]``, of which some are NaN."""
    shares = np.linspace(0, 1, steps + 1)[1:-1]
    known = [column[np.isfinite(column)].astype(np.float64) for column in numbers.T]
    known = [column if len(column) else np.zeros(1) for column in known]
    return (
        np.array([column.mean() for column in known], dtype=np.float32),
        np.array([max(column.std(), 1e-6) for column in known], dtype=np.float32),
        np.array([np.quantile(column, shares) for column in known], dtype=np.float32),
    )


def _network(numbers: int, players: int, config: ImitatorConfig, member: int) -> _Network:
    """An untrained member."""
    columns = sum(CODES.values()) + 2 * (players + 1)
    return _Network(numbers, columns + (numbers * (config.steps + 1) if member % 2 else 0), config)


def _read(columns: Tensor, member: int) -> Tensor:
    """Columns that a member reads: every second one the steps as well."""
    return columns if member % 2 else columns[:, : _STRIKER + 2]


def _train(
    imitator: Imitator, member: int, seed: int, numbers: Tensor, columns: Tensor, shot: Tensor, area: Tensor
) -> None:  # fmt: skip
    """Fit one member to shot types and to the areas that are known (not -1)."""
    config, starts = imitator.config, imitator._starts
    network, columns = imitator.members[member], _read(columns, member)
    generator = torch.Generator().manual_seed(seed)
    weights = list(network.parameters())
    groups: list[dict[str, Any]] = [
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
            for column, code, share in hidden:
                seen[torch.rand(size, generator=generator) < share, column] = code
            types, areas = network(numbers[rows], seen, config.dropout, generator)
            of_type = areas[torch.arange(size), shot[rows]]
            over_types = torch.logsumexp(functional.log_softmax(types, 1)[:, :, None] + functional.log_softmax(areas, 2), 1)
            loss = functional.cross_entropy(types, shot[rows])
            loss = loss + functional.cross_entropy(of_type, area[rows], ignore_index=-1, reduction="sum") / size
            # What is asked of the area without the shot type is fitted as well; it follows from the two, but not as sharply.
            loss = loss + 0.5 * functional.nll_loss(over_types, area[rows], ignore_index=-1, reduction="sum") / size
            optimiser.zero_grad()
            torch.autograd.backward(loss)
            optimiser.step()
            schedule.step()
