"""Strokes from TorchRL's own collector over the environment: ``--collector torchrl``.

:class:`~shuttle_marl.training.learner.RallyCollector` plays whole rallies from a table of the network, and learns from distinct
states. Here all is TorchRL's: its ``Collector`` lets the actor play under the mask of
:class:`~shuttle_marl.env.batched.VersusEnv`, or of :class:`~shuttle_marl.env.batched.RallyEnv` in self-play, it computes the
advantages, and its replay buffers split the strokes into minibatches. The losses are the same, with weight 1 / N for each stroke.
"""

import dataclasses
import logging
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, SamplerWithoutReplacement, TensorDictReplayBuffer
from torchrl.modules import ProbabilisticActor
from torchrl.objectives.value.functional import generalized_advantage_estimate

from shuttle_marl.base.arrays import I32, I64
from shuttle_marl.env.batched import RallyEnv, VersusEnv
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.rally import Rallies
from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import SEEDS, TrainingConfig, TrainingError
from shuttle_marl.training.networks import DivergedError, LegalStrokes, Observer

_ROWS: Final = 256
_STEPS: Final = 16
_LEARNED: Final = ("observation", "action_mask", "action", "action_log_prob", "value_target")


class _Played:
    """The rallies of an iteration, which the log of a run asks as it asks :class:`shuttle_marl.kernel.RallySampler`."""

    def __init__(self, *, self_play: bool) -> None:
        self._self_play, self._parts = self_play, list[Rallies]()

    def begin(self) -> None:
        """Forget the rallies of the last iteration."""
        self._parts = []

    def add(self, rallies: Rallies) -> None:
        """Keep those that ended."""
        self._parts.append(rallies.select(rallies.finished))

    @property
    def numbers(self) -> I64:
        """``[R]`` numbers of the rallies since the seed."""
        return np.concatenate([np.empty(0, np.int64), *(np.asarray(part.episode, np.int64) for part in self._parts)])

    def record(self, numbers: I64, *, figures: bool = False) -> Rallies:  # noqa: ARG002  not known here
        """Some of the rallies, by their numbers."""
        rallies = Rallies.concatenate(self._parts)
        rallies = rallies.select(np.isin(self.numbers, numbers))
        policy = np.zeros_like(rallies.policy) if self._self_play else rallies.policy
        match = np.asarray(rallies.episode, np.uint32)
        return dataclasses.replace(rallies, match=match, policy=policy, seed=None, episode=None, ending=None)


class EnvironmentCollector:
    """What a learner asks of :class:`~shuttle_marl.training.learner.RallyCollector`, over the environment.

    Args:
        predict: network, from ``[U, 7]`` observations to ``[U, n]`` logits and ``[U]`` values.
        distinct: whether strokes with advantages are wanted, or transitions.

    Raises:
        TrainingError: self-play with recovery.
    """

    def __init__(
        self,
        config: TrainingConfig,
        game: Game,
        opponents: Sequence[TabulatedPolicy],
        predict: Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]],
        *,
        distinct: bool,
    ) -> None:
        if game.hides:
            raise TrainingError("--collector torchrl: plays the game without recovery; --collector kernel plays both")
        logging.getLogger("torchrl").setLevel(logging.WARNING)  # it logs the creation of each buffer
        self._config, self._game, self._predict, self._distinct = config, game, predict, distinct
        self.sampler = _Played(self_play=not opponents)
        options: dict[str, Any] = {"game": game, "record": self.sampler.add}
        self.env = VersusEnv(_ROWS, opponents=list(opponents), **options) if opponents else RallyEnv(_ROWS, **options)
        self.generator = torch.Generator()
        self.observer = Observer(game, config.device)
        self._actor = ProbabilisticActor(
            TensorDictModule(self._outputs, in_keys=["observation"], out_keys=["logits", "state_value"]),
            in_keys={"logits": "logits", "mask": "action_mask"},
            out_keys=["action"],
            distribution_class=LegalStrokes,
            distribution_kwargs={"generator": self.generator},
            return_log_prob=True,
        )
        self.iteration = self.strokes = 0
        self._batches: Iterator[TensorDictBase] = iter(())

    def collect(self) -> TensorDictBase:
        """The strokes of the next iteration.

        Returns:
            ``[N]`` ``observation``, ``action_mask``, ``action``, ``action_log_prob``, ``advantage`` and ``value_target``; or
            transitions as of :meth:`shuttle_marl.training.learner.RallyCollector.collect`.

        Raises:
            DivergedError: an output of the network is not finite.
        """
        self.sampler.begin()
        wanted, batches, self.strokes = self._config.batch_of(self.iteration), list[TensorDictBase](), 0
        while self.strokes < wanted:
            played = next(self._batches)
            batches.append(self._with_advantages(played) if self._distinct else self._transitions(played))
            self.strokes += played.numel()
        self.env.read_rallies()
        self.iteration += 1
        return torch.cat(batches)

    def minibatches(self, data: TensorDictBase, count: int) -> Iterator[TensorDictBase]:
        """Minibatches in the form of :func:`shuttle_marl.training.learner.minibatches`: each stroke is a state of its own."""
        storage, size = LazyTensorStorage(len(data), compilable=True), -(-len(data) // count)
        buffer = TensorDictReplayBuffer(storage=storage, sampler=SamplerWithoutReplacement(), batch_size=size, compilable=True)
        buffer.set_rng(self.generator)
        buffer.extend(data)
        deviation = max(data["advantage"].std().item(), 1e-6)
        for _ in range(count):
            part = buffer.sample().to(self.observer.device)
            n = len(part)
            entries = {name: part[name] for name in _LEARNED}
            entries |= {"row": torch.arange(n, device=part.device), "weight": torch.full((n,), 1 / n, device=part.device)}
            yield TensorDict({**entries, "advantage": part["advantage"] / (n * deviation)}, batch_size=[])

    def set_seed(self, seed: int) -> int:
        """Reseed the actor and the environment, whose rallies start anew, and return the seed."""
        self.generator.manual_seed(seed % SEEDS)
        self.env.set_seed(seed % SEEDS)
        options = {"frames_per_batch": _ROWS * _STEPS, "total_frames": -1, "auto_register_policy_transforms": False}
        self._batches = iter(Collector(self.env, self._actor, **options))
        return seed % SEEDS

    def state_dict(self) -> OrderedDict[str, Any]:
        """State for a checkpoint, after which a run reseeds: the number of iterations."""
        return OrderedDict(iteration=torch.tensor(self.iteration))

    def load_state_dict(self, state_dict: OrderedDict[str, Any]) -> None:
        """Restore the output of :meth:`state_dict`."""
        self.iteration = int(state_dict["iteration"])

    def _outputs(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        with torch.no_grad():
            logits, value = self._predict(observation.to(self.observer.device))
        if not torch.isfinite(logits.sum() + value.sum()):
            raise DivergedError("an output of the network is not finite")
        return logits.cpu(), value.cpu().unsqueeze(-1)

    def _with_advantages(self, played: TensorDictBase) -> TensorDictBase:
        following, value = played["next"], played["state_value"]
        last = self._outputs(following["observation"][:, -1])[1]
        # After the end of a rally, where the estimate does not use it, the next value is that of another rally.
        next_value = torch.cat([value[:, 1:], last.unsqueeze(1)], dim=1)
        ends = following["reward"], following["done"], following["terminated"]
        discounts = self._config.discount, self._config.gae_lambda
        advantage, target = generalized_advantage_estimate(*discounts, value, next_value, *ends)
        strokes = played.set("advantage", advantage).set("value_target", target)
        return strokes.select(*_LEARNED, "advantage").reshape(-1).clone()

    def _transitions(self, played: TensorDictBase) -> TensorDictBase:
        flat = played.reshape(-1)
        following, over = flat["next"], flat["next", "terminated"].view(-1).numpy()
        state = self._states(flat["observation"])
        columns = {
            "state": state,
            "pair": self._game.pair(state, flat["action"].numpy()).astype(np.int64),
            "following": np.where(over, -1, self._states(following["observation"])).astype(np.int32),
            "reward": following["reward"].view(-1).numpy().copy(),
        }
        return TensorDict({name: torch.from_numpy(column) for name, column in columns.items()}, batch_size=[len(state)])

    def _states(self, observation: torch.Tensor) -> I32:
        return self._game.state_of(*observation.numpy().astype(np.int64).T)
