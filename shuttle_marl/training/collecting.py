"""Strokes to learn from, as TorchRL's collectors give them: ``for data in collector``.

The network is asked once for each state that is played, not once for each stroke; rallies are then played from the table of its
answers, by the kernel (:mod:`shuttle_marl.kernel.sampling`) or on a GPU (:mod:`shuttle_marl.training.torch_sampler`). A learner
gets its strokes in one of two forms:

- **distinct**: U states, each once, with the number of strokes played there, and R strokes in them with the sums of their
  advantages, the positive and the negative ones apart. A loss over them, weighted, has the gradient of the loss over all
  strokes, at a fraction of its cost;
- **one by one**: transitions, for a replay buffer.
"""

import itertools
import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import BaseCollector

from shuttle_marl.arrays import F32, I32
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel import RallySampler
from shuttle_marl.training.config import TrainingConfig
from shuttle_marl.training.learner import DivergedError
from shuttle_marl.training.shaping import added_rewards
from shuttle_marl.training.torch_sampler import TorchSampler

Assess = Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]]
"""``[U, 6]`` observations to ``[U, n]`` logits and ``[U]`` values."""

SEEDS: Final = 1 << 31
"""torch and numpy take seeds of 32 bits."""


class Observer:
    """Input of the network for states, as tensors of a device.

    Args:
        game: the tables.
        device: of the tensors.
    """

    def __init__(self, game: Game, device: str) -> None:
        self.device = torch.device(device)
        states = np.arange(game.n_states)
        self._observation = torch.from_numpy(game.observation(states)).to(self.device)
        self._masks = torch.from_numpy(game.reply_mask.reshape(-1, game.n_strokes).copy()).to(self.device)
        self._mask_row = torch.from_numpy((2 * game.incoming(states) + game.contact(states)).astype(np.int64)).to(self.device)
        self._stroke = torch.from_numpy(game.base_pair_stroke.astype(np.int64)).to(self.device)

    def observations(self, states: torch.Tensor) -> torch.Tensor:
        """``[U, 6]`` of ``[U]`` states."""
        return self._observation[states.long().to(self.device)]

    def seen(self, states: torch.Tensor) -> dict[str, torch.Tensor]:
        """``[U, 6]`` observation and ``[U, n]`` action mask of ``[U]`` states."""
        where = states.long().to(self.device)
        return {"observation": self._observation[where], "action_mask": self._masks[self._mask_row[where]]}

    def strokes(self, pairs: torch.Tensor) -> torch.Tensor:
        """``[R]`` catalogue index of ``[R]`` legal pairs."""
        return self._stroke[pairs.long().to(self.device) % len(self._stroke)]


def _sampler(config: TrainingConfig, game: Game, opponents: Sequence[TabulatedPolicy]) -> RallySampler:
    options: dict[str, Any] = {
        "decay": config.lmbda,
        "age": config.age,
        "shaping": added_rewards(config, game) if config.shapes_rewards else None,
    }
    device = torch.device(config.device)
    if config.sampler == "torch" or (config.sampler == "auto" and device.type == "cuda"):
        return TorchSampler(game, opponents, device=device, **options)
    return RallySampler(game, opponents, **options)


class RallyCollector(BaseCollector):
    """Collects the strokes of one iteration after another.

    Args:
        config: sizes, device, shaping.
        game: the tables.
        opponents: of the learner; none in plain self-play.
        assess: the network; it is asked whenever strokes are collected, so it is always the present one.
        distinct: which of the two forms the strokes have.
    """

    def __init__(
        self, config: TrainingConfig, game: Game, opponents: Sequence[TabulatedPolicy], assess: Assess, *, distinct: bool
    ) -> None:
        super().__init__()
        self._config, self._assess, self._distinct = config, assess, distinct
        self.sampler = _sampler(config, game, opponents)
        self._look_up = Observer(game, config.device)
        self.iteration = 0
        """Iterations that were collected."""
        self.strokes = 0
        """Strokes of the last one."""

    def begin(self, seed: int) -> None:
        """Begin again: from here on, what is collected depends on this seed, the weights and the state of the collector alone."""
        self.set_seed(seed)

    def __len__(self) -> int:
        """Iterations that are left."""
        return max(0, self._config.iterations - self.iteration)

    def iterator(self) -> Iterator[TensorDictBase]:
        """The strokes of every iteration that is left, by the weights that the network has when they are asked for."""
        while self.iteration < self._config.iterations:
            yield self.collect()

    def collect(self) -> TensorDictBase:
        """The strokes of the next iteration.

        Raises:
            DivergedError: the network gives numbers that are not finite.
        """
        self.sampler.collect(self._config.batch_of(self.iteration), self._ask, keep=not self._distinct)
        self.iteration += 1
        self.strokes = self.sampler.count
        return self._distinct_strokes() if self._distinct else self._single_strokes()

    def _ask(self, states: I32) -> tuple[F32, F32]:
        with torch.inference_mode():
            logits, value = self._assess(self._look_up.observations(torch.from_numpy(states)))
        if not math.isfinite(logits.sum() + value.sum()):  # in one pass: a sum with NaN or infinity is not finite
            raise DivergedError("the network gives no finite numbers")
        return logits.cpu().numpy(), value.cpu().numpy()

    def _distinct_strokes(self) -> TensorDictBase:
        """Entries of :class:`~shuttle_marl.kernel.Distinct`.

        ``weight`` and ``advantage`` are divided by the number of strokes, the advantages also by their deviation.
        """
        order = torch.randperm(len(self.sampler.known)).numpy()
        found = self.sampler.take(order)
        scale = 1 / (found.strokes * max(found.deviation, 1e-6))
        entries = {
            "weight": found.visits / np.float32(found.strokes),
            "value_target": found.returns[:, None],
            "start": found.start,
            "row": found.row,
            "action": found.stroke,
            "action_log_prob": found.log_probability,
            "advantage": found.advantage[:, None] * np.float32(scale),
        }
        tensors = {name: torch.from_numpy(entry).to(self._look_up.device) for name, entry in entries.items()}
        counted = {"strokes": torch.tensor(found.strokes), "deviation": torch.tensor(found.deviation)}
        return TensorDict({**self._look_up.seen(torch.from_numpy(found.state)), **tensors, **counted}, batch_size=[])

    def _single_strokes(self) -> TensorDictBase:
        """``[N]`` transitions: states and legal pairs as numbers, ``following`` -1 where the rally ends."""
        strokes = self.sampler.strokes
        self.sampler.take()
        columns = {name: getattr(strokes, name) for name in ("state", "pair", "following", "reward")}
        entries = {name: torch.from_numpy(column) for name, column in columns.items()}
        return TensorDict(entries, batch_size=[len(strokes.pair)])

    def set_seed(self, seed: int, static_seed: bool = False) -> int:  # noqa: ARG002  TorchRL's
        """Name all draws from here on; see :meth:`begin`. Returns the seed."""
        torch.manual_seed(seed % SEEDS)
        self.sampler.reset(seed % SEEDS)
        return seed % SEEDS

    def state_dict(self) -> OrderedDict[str, Any]:
        """State that a resumed run needs: the states whose entries are asked for first."""
        return OrderedDict(known=torch.from_numpy(self.sampler.known.copy()), iteration=torch.tensor(self.iteration))

    def load_state_dict(self, state_dict: OrderedDict[str, Any]) -> None:
        """Take over what :meth:`state_dict` gave."""
        self.iteration = int(state_dict["iteration"])
        self.sampler.reset(0, state_dict["known"].numpy())

    def shutdown(self, timeout: float | None = None, close_env: bool = True, raise_on_error: bool = True) -> None:
        """Nothing to end: rallies are played in this process."""


def minibatches(data: TensorDictBase, count: int) -> Iterator[TensorDictBase]:
    """Distinct strokes in parts of about as many states, which come in random order; each is weighted like the whole.

    Args:
        data: as a collector gives them.
        count: of the parts; fewer where there are fewer states.
    """
    states = len(data["weight"])
    count = max(1, min(count, states))
    cuts = [states * part // count for part in range(count + 1)]
    starts = data["start"].tolist() if count > 1 else [0] * states + [len(data["row"])]
    for a, b in itertools.pairwise(cuts):
        rows = slice(starts[a], starts[b])
        entries = {name: data[name][a:b] for name in ("observation", "action_mask", "value_target")}
        entries |= {name: data[name][rows] for name in ("action", "action_log_prob")}
        entries |= {
            "row": data["row"][rows] - a,
            "weight": data["weight"][a:b] * count,
            "advantage": data["advantage"][rows] * count,
        }
        yield TensorDict(entries, batch_size=[])
