"""The training loop: a :class:`RallyCollector` gives the strokes of an iteration, a :class:`Learner` learns from them.

The network is evaluated once for each visited state, not for each stroke; rallies are then played from the table of its outputs,
by the kernel (:mod:`shuttle_marl.kernel.sampling`). The sampler also computes the generalised advantages (Schulman et al. 2016,
arXiv 1506.02438) of every rally, backwards from its last stroke:

    delta_t = r_t + gamma V(s_{t+1}) - V(s_t),    A_t = delta_t + gamma lambda A_{t+1}.

In self-play the next state belongs to the opponent, whose value is minus ours: gamma = -1 gives the recursion of a zero-sum game.
A learner gets its strokes in one of two forms:

- **distinct**: U distinct states with the number of strokes played in each, and R rows of a stroke in one of these states with
  the sum of its advantages, one row for the positive and one for the negative ones. A weighted loss over them has the gradient
  of the loss over all strokes (:func:`weighted_sums`), at a fraction of its cost;
- **transitions** for a replay buffer.
"""

import abc
import itertools
import math
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, Final

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torch.optim import Optimizer
from torchrl.collectors import BaseCollector
from torchrl.modules import ProbabilisticActor

from shuttle_marl.base.arrays import F32, I32
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.game.thresholds import ONE
from shuttle_marl.kernel import RallySampler
from shuttle_marl.training.config import TrainingConfig
from shuttle_marl.training.networks import DivergedError, decision_observations


def fault_penalty(cost: float, aversion: float) -> float:
    """Penalty k for a fault ``cost`` c >= 0 and a risk ``aversion`` b >= 0: a loss by an own fault counts -1 - k."""
    if aversion == 0:
        return cost
    return 2 * math.exp(aversion) * math.expm1(aversion * cost) / (2 * math.sinh(aversion))


def added_rewards(config: TrainingConfig, game: Game) -> F32:
    """``[L * base pairs]`` bonus and penalty of each stroke, by own effort and base pair."""
    bonus = np.zeros(len(SHOTS))
    for shot, points in config.bonuses().items():
        bonus[SHOTS.index(shot)] = points
    penalty = fault_penalty(config.fault_cost, config.risk_aversion)
    fault = game.limits[..., 0].astype(np.float64) / ONE
    added = bonus[game.catalogue.shot[game.base_pair_stroke]] - penalty * fault
    return added.astype(np.float32).ravel()


Tensors = dict[str, torch.Tensor]
Predict = Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]]
"""``[U, 7]`` observations, with recovery ``[U, 8]``, to ``[U, n]`` logits and ``[U]`` values."""

SEEDS: Final = 1 << 31
"""Seeds of generators are below this."""


class Learner(abc.ABC):
    """A learning algorithm with its networks.

    Attributes:
        distinct: whether it learns from distinct states or from transitions, see :mod:`shuttle_marl.training.learner`.
        iteration: number of the current iteration, counted from 0; set by :class:`Trainer`.
    """

    distinct: ClassVar[bool] = True
    iteration: int = 0
    actor: ProbabilisticActor
    modules: Mapping[str, nn.Module]
    optimizers: Mapping[str, Optimizer]

    @property
    def eval_actor(self) -> ProbabilisticActor:
        """The policy that is evaluated and saved."""
        return self.actor

    def draw_from(self, generator: torch.Generator) -> None:  # noqa: B027
        """Draw the random numbers of updates from a generator, instead of PyTorch's own."""

    @abc.abstractmethod
    def predict(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """``[U, n]`` logits, ``[U]`` values for ``[U, 7]`` observations; with recovery ``[U, n + 9]`` logits for ``[U, 8]``."""

    def prepare(self, remaining: float) -> None:  # noqa: B027
        """Prepare the actor for a rollout.

        Args:
            remaining: fraction of the run that remains, from 1 to 0.
        """

    @abc.abstractmethod
    def update(self, data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Learn from the strokes of one iteration.

        Args:
            remaining: fraction of the run that remains, from 1 to 0.

        Returns:
            Figures to log.

        Raises:
            DivergedError: a term of the loss is not finite.
        """

    def state_dict(self) -> Tensors:
        """State for a checkpoint, as tensors by name; random generators are not included."""
        tensors: Tensors = {}
        for name, module in self.modules.items():
            tensors |= {f"{name}.{part}": tensor.detach().cpu().contiguous() for part, tensor in module.state_dict().items()}
        for name, optimizer in self.optimizers.items():
            moments: dict[int, dict[str, Any]] = optimizer.state_dict()["state"]
            for number, entries in moments.items():
                for entry, value in entries.items():
                    tensors[f"{name}.{number}.{entry}"] = torch.as_tensor(value).detach().cpu().clone()
        return tensors

    def load_state_dict(self, tensors: Tensors) -> None:
        """Restore the output of :meth:`state_dict`.

        Raises:
            KeyError, ValueError, RuntimeError: tensors are missing, or have other shapes or dtypes.
        """
        for name, module in self.modules.items():
            found, present = with_prefix(name, tensors), module.state_dict()
            for part, tensor in present.items():
                if found[part].shape != tensor.shape or found[part].dtype != tensor.dtype:
                    raise ValueError(f"{name}.{part}: {found[part].dtype} of shape {tuple(found[part].shape)}")
            # Indices of embeddings follow from the game; those of a damaged file could lead out of the tables.
            module.load_state_dict(found | {part: tensor for part, tensor in present.items() if part.endswith("attributes")})
        for name, optimizer in self.optimizers.items():
            parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
            moments: dict[int, dict[str, torch.Tensor]] = {}
            for part, tensor in with_prefix(name, tensors).items():
                number, _, entry = part.partition(".")
                moments.setdefault(int(number), {})[entry] = tensor
            for index, entries in moments.items():
                moments_have_shape = [entries[entry].shape == parameters[index].shape for entry in ("exp_avg", "exp_avg_sq")]
                if not all(moments_have_shape) or entries["step"].shape != ():
                    raise ValueError(f"{name}.{index}: moments of other shapes than the weights")
            optimizer.load_state_dict({"state": moments, "param_groups": optimizer.state_dict()["param_groups"]})


def with_prefix(prefix: str, tensors: Tensors) -> Tensors:
    """The tensors whose names start with ``prefix.``, by the rest of their names."""
    return {name.removeprefix(f"{prefix}."): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}.")}


def check_finite(tensors: Iterable[torch.Tensor]) -> None:
    """Check that all numbers are finite.

    Raises:
        DivergedError: a number is not finite.
    """
    if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors if tensor.is_floating_point()):
        raise DivergedError("a weight is not finite")


def set_learning_rate(optimizer: Optimizer, initial: float, remaining: float) -> None:
    """Decay the learning rate linearly to 1/50 of its initial value."""
    for group in optimizer.param_groups:
        group["lr"] = initial * max(remaining, 0.02)


def normalised(data: TensorDictBase) -> TensorDictBase:
    """Distinct states with weights, and with advantages that are divided by their standard deviation.

    Args:
        data: distinct states of N strokes, from :meth:`RallyCollector.collect`.

    Returns:
        The same with ``weight`` w(s) = N(s) / N, and ``advantage`` divided by N and by the standard deviation, so that weighted
        sums over states and sums over rows are means over the N strokes.
    """
    strokes, deviation = int(data["strokes"]), float(data["deviation"])
    scale = 1 / (strokes * max(deviation, 1e-6))
    return data.copy().update({"weight": data["visits"].float() / strokes, "advantage": data["advantage"] * scale})


def minibatches(data: TensorDictBase, count: int) -> Iterator[TensorDictBase]:
    """Minibatches of about as many states each, in the order of the states, which is random.

    Args:
        data: output of :func:`normalised`.
        count: number of minibatches; fewer if there are fewer states.

    Yields:
        Each with weights and advantages multiplied by the number of minibatches, so that means over minibatches are unbiased.
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


def weighted_sums(terms: TensorDictBase, weight: torch.Tensor) -> TensorDictBase:
    """Reduce the terms of a loss over distinct states to their means over all strokes.

    Args:
        terms: output of a TorchRL loss with ``reduction="none"``: the objective of each row, other terms of each state.
        weight: ``[U]`` weight w(s) of each state.
    """
    summed = {name: (terms[name].reshape(-1) * weight).sum() for name in ("loss_critic", "loss_entropy")}
    return terms.copy().update({**summed, "loss_objective": terms["loss_objective"].sum()})


class Mean:
    """Means of the terms of a loss over gradient steps."""

    def __init__(self, *names: str) -> None:
        self._totals, self._count = dict.fromkeys(names, 0.0), 0

    def add(self, terms: TensorDictBase) -> None:
        """Add the terms of a gradient step.

        Raises:
            DivergedError: a term is not finite.
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


class Observer:
    """Network inputs of states, or with recovery of decisions, as tensors on a device."""

    def __init__(self, game: Game, device: str) -> None:
        self.device = torch.device(device)
        states = np.arange(game.n_states)
        masks, row = game.reply_mask.reshape(-1, game.n_strokes), 2 * game.incoming(states) + game.contact(states)
        if game.recovery is not None:
            masks = np.pad(masks, ((0, game.n_base_states), (0, N_POSITIONS)))
            masks[-game.n_base_states :, game.n_strokes :] = game.waiting.mask(np.arange(game.n_base_states))
            row, states = np.r_[row, len(masks) - game.n_base_states + game.base(states)], np.arange(2 * game.n_states)
        self._observation = torch.from_numpy(decision_observations(game, states)).to(self.device)
        self._masks = torch.from_numpy(masks.copy()).to(self.device)
        self._mask_row = torch.from_numpy(row.astype(np.int64)).to(self.device)
        self._stroke = torch.from_numpy(game.base_pair_stroke.astype(np.int64)).to(self.device)
        self._game, self._position = game, None
        if game.recovery is not None:
            self._position = torch.from_numpy(np.maximum(game.waiting.position, 0).astype(np.int64).ravel()).to(self.device)

    def observations(self, states: torch.Tensor) -> torch.Tensor:
        """``[U, 7]`` observations of ``[U]`` states, with recovery ``[U, 8]`` of decisions."""
        return self._observation[states.long().to(self.device)]

    def inputs(self, states: torch.Tensor) -> Tensors:
        """``[U, 7]`` observations and ``[U, n]`` masks of ``[U]`` states; with recovery ``[U, 8]``, ``[U, n + 9]``."""
        states = states.long().to(self.device)
        return {"observation": self._observation[states], "action_mask": self._masks[self._mask_row[states]]}

    def strokes(self, pairs: torch.Tensor) -> torch.Tensor:
        """``[R]`` catalogue indices of ``[R]`` legal pairs; n + p of positions, see :mod:`shuttle_marl.kernel.table_play`."""
        pairs = pairs.long().to(self.device)
        stroke = self._stroke[pairs % len(self._stroke)]
        if self._position is None:
            return stroke
        positions = self._position[(pairs - self._game.n_pairs) % len(self._position)]
        return torch.where(pairs < self._game.n_pairs, stroke, self._game.n_strokes + positions)


class RallyCollector(BaseCollector):
    """TorchRL collector of the strokes of one iteration after another.

    Args:
        config: sizes, device, reward shaping, and lambda of the advantages.
        opponents: opponents of the learner; empty in plain self-play.
        predict: network; called in every iteration, so its weights are current.
    """

    def __init__(
        self, config: TrainingConfig, game: Game, opponents: Sequence[TabulatedPolicy], predict: Predict, *, distinct: bool
    ) -> None:
        super().__init__()
        self._config, self._predict, self._distinct = config, predict, distinct
        self.sampler = RallySampler(
            game,
            opponents,
            gae_lambda=config.gae_lambda,
            cache_iterations=config.cache_iterations,
            shaping=added_rewards(config, game) if config.shapes_rewards else None,
        )
        self._observer = Observer(game, config.device)
        self.generator = torch.Generator()
        """Random numbers of rollouts and updates; :meth:`set_seed` seeds it."""
        self.iteration = 0
        """Number of collected iterations."""
        self.strokes = 0
        """Strokes of the learner in the last iteration."""

    def __len__(self) -> int:
        """Remaining iterations."""
        return max(0, self._config.iterations - self.iteration)

    def iterator(self) -> Iterator[TensorDictBase]:
        """The strokes of all remaining iterations."""
        while self.iteration < self._config.iterations:
            yield self.collect()

    def collect(self) -> TensorDictBase:
        """Play the rallies of the next iteration.

        Returns:
            Distinct states:

            - ``observation`` ``[U, 7]``, ``action_mask`` ``[U, n]``: the states, in random order; with recovery decisions on
              strokes and positions, ``[U, 8]`` and ``[U, n + 9]``;
            - ``visits`` ``[U]``: number N(s) of strokes in each state;
            - ``value_target`` ``[U, 1]``: mean of A + V(s) over the strokes in each state;
            - ``start`` ``[U + 1]``: first row of each state;
            - ``row`` ``[R]``: state of each row; ``action`` ``[R]``: stroke, a catalogue index;
            - ``action_log_prob`` ``[R]``: log-probability of the stroke when it was played;
            - ``advantage`` ``[R, 1]``: sum of the positive or of the negative advantages of the stroke in the state;
            - ``strokes``, ``deviation``: number N of strokes, and standard deviation of their advantages.

            Or transitions, each ``[N]``: ``state``, ``pair`` (legal pair), ``following`` (next state, -1: none), ``reward``.

        Raises:
            DivergedError: an output of the network is not finite.
        """
        self.sampler.collect(self._config.batch_of(self.iteration), self._outputs, keep=not self._distinct)
        self.iteration += 1
        self.strokes = self.sampler.count
        if not self._distinct:
            strokes = self.sampler.strokes
            self.sampler.take()
            columns = {name: getattr(strokes, name) for name in ("state", "pair", "following", "reward")}
            return TensorDict({name: torch.from_numpy(part) for name, part in columns.items()}, batch_size=[len(strokes.pair)])
        taken = self.sampler.take(torch.randperm(len(self.sampler.known), generator=self.generator).numpy())
        columns = {
            "visits": taken.visits,
            "value_target": taken.returns[:, None],
            "start": taken.start,
            "row": taken.row,
            "action": taken.stroke,
            "action_log_prob": taken.log_probability,
            "advantage": taken.advantage[:, None],
        }
        tensors = {name: torch.from_numpy(column).to(self._observer.device) for name, column in columns.items()}
        totals = {"strokes": torch.tensor(taken.strokes), "deviation": torch.tensor(taken.deviation, dtype=torch.float64)}
        return TensorDict({**self._observer.inputs(torch.from_numpy(taken.state)), **tensors, **totals}, batch_size=[])

    def _outputs(self, states: I32) -> tuple[F32, F32]:
        with torch.inference_mode():
            logits, value = self._predict(self._observer.observations(torch.from_numpy(states)))
        if not math.isfinite(logits.sum() + value.sum()):  # one pass: NaN and infinity propagate to the sum
            raise DivergedError("an output of the network is not finite")
        return logits.cpu().numpy(), value.cpu().numpy()

    def set_seed(self, seed: int, static_seed: bool = False) -> int:  # noqa: ARG002  TorchRL's
        """Reseed sampler and generator, and return the seed; later strokes depend on seed, weights and state alone."""
        self.generator.manual_seed(seed % SEEDS)
        self.sampler.reset(seed % SEEDS)
        return seed % SEEDS

    def state_dict(self) -> OrderedDict[str, Any]:
        """State for a checkpoint: number of iterations, and states whose network outputs are computed first."""
        return OrderedDict(known=torch.from_numpy(self.sampler.known.copy()), iteration=torch.tensor(self.iteration))

    def load_state_dict(self, state_dict: OrderedDict[str, Any]) -> None:
        """Restore the output of :meth:`state_dict`."""
        self.iteration = int(state_dict["iteration"])
        self.sampler.reset(0, state_dict["known"].numpy())

    def shutdown(self, timeout: float | None = None, close_env: bool = True, raise_on_error: bool = True) -> None:
        """Do nothing: rallies are played in this process."""


class Trainer:
    """Alternates rollouts and updates, for training runs and for leagues.

    Args:
        update_opponents: called before each iteration with its number; may change the opponents of the sampler.
    """

    def __init__(
        self, learner: Learner, collector: RallyCollector, update_opponents: Callable[[int], None] | None = None
    ) -> None:
        self.learner, self.collector, self._update_opponents = learner, collector, update_opponents
        learner.draw_from(collector.generator)
        self.iteration, self.strokes = 0, 0
        """Iterations, and strokes of the learner."""

    def iterate(self, remaining: float, collected: Callable[[], None] | None = None) -> dict[str, float]:
        """Collect strokes and learn from them.

        Args:
            remaining: fraction of the run that remains, from 1 to 0.

        Returns:
            Figures to log.

        Raises:
            DivergedError: a weight, a term of the loss or an output of the network is not finite.
        """
        self.learner.iteration = self.iteration
        self.learner.prepare(remaining)
        if self._update_opponents is not None:
            self._update_opponents(self.iteration)
        data = self.collector.collect()
        self.iteration += 1
        self.strokes += self.collector.strokes
        if collected is not None:
            collected()
        losses = self.learner.update(data, remaining)
        check_finite(self.learner.actor.parameters())  # checkpoints check the rest
        return losses

    def state_dict(self) -> Tensors:
        """State for a checkpoint, as tensors by name.

        Raises:
            DivergedError: a number is not finite.
        """
        state = self.learner.state_dict() | {f"collector.{name}": part for name, part in self.collector.state_dict().items()}
        check_finite(state.values())
        return state

    def load_state_dict(self, state: Tensors) -> None:
        """Restore the output of :meth:`state_dict`.

        Raises:
            KeyError, RuntimeError: the state of another kind of learner.
        """
        self.learner.load_state_dict(state)
        self.collector.load_state_dict(OrderedDict((name, state[f"collector.{name}"]) for name in ("known", "iteration")))
