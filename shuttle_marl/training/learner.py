"""What algorithms share: a :class:`RallyCollector` gives the strokes of an iteration, a :class:`Learner` learns from them.

The kernel computes the generalised advantages (Schulman et al. 2016, arXiv 1506.02438) of every rally, backwards from its last
stroke:

    delta_t = r_t + gamma V(s_{t+1}) - V(s_t),    A_t = delta_t + gamma lambda A_{t+1}.

In self-play the next state belongs to the opponent, whose value is minus ours: gamma = -1 gives the recursion of a zero-sum game.

**Distinct states**: the network runs once for each state, and the loss once for each stroke in it, however often they are played.
Few states make up most of the play: late in self-play 181,043 strokes of an iteration are in 770 states. So rallies are played
from a table of the network's outputs in each state (:mod:`shuttle_marl.kernel.sampling`), and the learner gets

- U distinct states s with the number N(s) of strokes in each, and
- R rows of a stroke a in one of them, with the sum of its advantages: a row for the positive ones, a row for the negative ones.

The gradient is that over all strokes. The objective of PPO, min(rho A, clip(rho) A), is linear in A for either sign of A, and all
strokes a in s have the same rho: the sum over them is the objective of the sums. Entropy and value depend on the state alone, and
the gradient of (V(s) - V_target)^2 on the mean of the targets.

:func:`normalised` turns sums over rows and weighted sums over states into means over the N strokes, :func:`minibatches` splits by
state, and :func:`weighted_sums` reduces a loss of TorchRL.
"""

import abc
import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, ClassVar, Final

import numpy as np
import torch
from safetensors.torch import save
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torch.optim import Optimizer
from torchrl.modules import ProbabilisticActor

from shuttle_marl.base.arrays import F32, I32
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import RallySampler
from shuttle_marl.training.config import SEEDS, TrainingConfig
from shuttle_marl.training.environment import EnvironmentCollector
from shuttle_marl.training.networks import DivergedError, Observer, Tensors


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


Predict = Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]]
"""``[U, 7]`` observations to ``[U, n]`` logits, with recovery ``[U, 8]`` to ``[U, n + 9]``, and ``[U]`` values."""

STATE: Final = "state.safetensors"


class Callback:
    """What a run does in an iteration beside learning: opponents, the rally log, evaluations, checkpoints. By default nothing."""

    def begin(self, learner: "Learner") -> None:
        """Called before the rallies of iteration ``learner.iteration``, counted from 0."""

    def collected(self, learner: "Learner") -> None:
        """Called after the rallies of an iteration, while their strokes are in ``learner.collector.sampler``."""

    def learned(self, learner: "Learner", losses: dict[str, float]) -> None:
        """Called after the update of an iteration, with figures to log."""


IDLE: Final = Callback()


class Learner(abc.ABC):
    """A learning algorithm with its networks and its collector.

    Args:
        opponents: opponents of the learner; empty in plain self-play.

    Attributes:
        distinct: whether it learns from distinct states or from transitions, see :meth:`RallyCollector.collect`.
        iteration, strokes: numbers of iterations and of own strokes.
    """

    distinct: ClassVar[bool] = True
    config: TrainingConfig
    actor: ProbabilisticActor
    modules: Mapping[str, nn.Module]
    optimizers: Mapping[str, Optimizer]

    def __init__(self, config: TrainingConfig, game: Game, opponents: Sequence[TabulatedPolicy] = ()) -> None:
        self.config = config
        kind: Any = RallyCollector if config.collector == "kernel" else EnvironmentCollector  # which has what learners use
        self.collector: RallyCollector = kind(config, game, opponents, self.predict, distinct=self.distinct)
        self.iteration, self.strokes = 0, 0

    @property
    def eval_actor(self) -> ProbabilisticActor:
        """The policy that is evaluated and saved."""
        return self.actor

    @abc.abstractmethod
    def predict(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """``[U, n]`` logits, ``[U]`` values for ``[U, 7]`` observations; with recovery ``[U, n + 9]`` logits for ``[U, 8]``."""

    @abc.abstractmethod
    def iterate(self, remaining: float, run: Callback = IDLE) -> None:
        """Collect the strokes of an iteration, and learn from them.

        Args:
            remaining: fraction of the run that remains, from 1 to 0.
            run: is called in between.

        Raises:
            DivergedError: a term of the loss or an output of the network is not finite.
        """

    def collect(self) -> TensorDictBase:
        """Play the rallies of the next iteration, see :meth:`RallyCollector.collect`."""
        data = self.collector.collect()
        self.iteration += 1
        self.strokes += self.collector.strokes
        return data

    def state_dict(self) -> Tensors:
        """State for a checkpoint, as tensors by name, without random generators. Raises DivergedError: a number is not finite."""
        tensors = {f"collector.{name}": tensor for name, tensor in self.collector.state_dict().items()}
        for name, module in self.modules.items():
            tensors |= {f"{name}.{part}": tensor.detach().cpu().contiguous() for part, tensor in module.state_dict().items()}
        for name, optimizer in self.optimizers.items():
            moments: dict[int, dict[str, Any]] = optimizer.state_dict()["state"]
            for number, entries in moments.items():
                for entry, value in entries.items():
                    tensors[f"{name}.{number}.{entry}"] = torch.as_tensor(value).detach().cpu().clone()
        if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values() if tensor.is_floating_point()):
            raise DivergedError("a weight is not finite")
        return tensors

    def load_state_dict(self, tensors: Tensors) -> None:
        """Restore :meth:`state_dict`. Raises KeyError, ValueError, RuntimeError: the state of another kind of learner."""
        for name, module in self.modules.items():
            module.load_state_dict(with_prefix(name, tensors))
        for name, optimizer in self.optimizers.items():
            moments: dict[int, Tensors] = {}
            for part, tensor in with_prefix(name, tensors).items():
                number, _, entry = part.partition(".")
                moments.setdefault(int(number), {})[entry] = tensor
            optimizer.load_state_dict({"state": moments, "param_groups": optimizer.state_dict()["param_groups"]})
        self.collector.load_state_dict(OrderedDict(with_prefix("collector", tensors)))


def stored(tensors: Tensors) -> bytes:
    """Tensors as a file."""
    # Some share their memory, which safetensors refuses.
    return save({name: tensor.clone() for name, tensor in tensors.items()})


def with_prefix(prefix: str, tensors: Tensors) -> Tensors:
    """The tensors whose names start with ``prefix.``, by the rest of their names."""
    return {name.removeprefix(f"{prefix}."): tensor for name, tensor in tensors.items() if name.startswith(f"{prefix}.")}


def set_learning_rate(optimizer: Optimizer, initial: float, remaining: float) -> None:
    """Decay the learning rate linearly to 1/50 of its initial value."""
    for group in optimizer.param_groups:
        group["lr"] = initial * max(remaining, 0.02)


class Mean:
    """Means of the terms of a loss over gradient steps."""

    def __init__(self, *names: str) -> None:
        self._totals, self._count = dict.fromkeys(names, 0.0), 0

    def add(self, terms: TensorDictBase) -> None:
        """Add the terms of a gradient step. Raises DivergedError: a term is not finite."""
        self._count += 1
        for name in self._totals:
            value = terms[name].mean().item()
            if not math.isfinite(value):
                raise DivergedError(f"{name} became {value}")
            self._totals[name] += value

    def values(self) -> dict[str, float]:
        """The means by name; none without a step."""
        return {name: total / self._count for name, total in self._totals.items() if self._count}


class RallyCollector:
    """The strokes of one iteration after another, from the compiled kernel.

    Args:
        config: sizes, device, reward shaping, and lambda of the advantages.
        opponents: opponents of the learner; empty in plain self-play.
        predict: network; called in every iteration, so its weights are current.
    """

    def __init__(
        self, config: TrainingConfig, game: Game, opponents: Sequence[TabulatedPolicy], predict: Predict, *, distinct: bool
    ) -> None:
        self._config, self._predict, self._distinct = config, predict, distinct
        self.sampler = RallySampler(
            game,
            opponents,
            gae_lambda=config.gae_lambda,
            cache_iterations=config.cache_iterations,
            shaping=added_rewards(config, game) if config.shapes_rewards else None,
        )
        self.observer = Observer(game, config.device)
        self.generator = torch.Generator()  # random numbers of rollouts and updates; `set_seed` seeds it
        self.iteration = 0  # number of collected iterations
        self.strokes = 0  # strokes of the learner in the last iteration

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
        tensors = {name: torch.from_numpy(column).to(self.observer.device) for name, column in columns.items()}
        totals = {"strokes": torch.tensor(taken.strokes), "deviation": torch.tensor(taken.deviation, dtype=torch.float64)}
        return TensorDict({**self.observer.inputs(torch.from_numpy(taken.state)), **tensors, **totals}, batch_size=[])

    def _outputs(self, states: I32) -> tuple[F32, F32]:
        with torch.inference_mode():
            logits, value = self._predict(self.observer.observations(torch.from_numpy(states)))
        if not math.isfinite(logits.sum() + value.sum()):  # one pass: NaN and infinity propagate to the sum
            raise DivergedError("an output of the network is not finite")
        return logits.cpu().numpy(), value.cpu().numpy()

    def minibatches(self, data: TensorDictBase, count: int) -> Iterator[TensorDictBase]:
        """See :func:`minibatches`."""
        return minibatches(normalised(data), count)

    def set_seed(self, seed: int) -> int:
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
    for a, b in pairwise(cuts):
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
