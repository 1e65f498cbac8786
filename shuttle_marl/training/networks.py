"""The networks that learn: attribute embeddings of what a striker observes, a masked head, and values.

A state is two strokes, a contact, the length of a duel at the net and both players' efforts; a stroke is its shot type, area,
contact height and technique. The first layer is the sum of an embedding of each attribute, one of the stroke as a whole, and
one of each of the others, separately for the striker's own last stroke and for the incoming one: so what is learned about a
smash is shared by all smashes.
"""

from typing import Any, ClassVar, Final

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn
from torch.distributions import Categorical, Distribution
from torch.nn import functional
from torchrl.modules import ProbabilisticActor, ValueOperator

from shuttle_marl.arrays import F32, F64
from shuttle_marl.game.policy import PolicyError, States
from shuttle_marl.game.tables import LONGEST_DUEL, Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.policy.network import PolicyNetwork, attribute_rows
from shuttle_marl.training.config import DivergedError

ILLEGAL: Final = -1e9
"""Logit of an illegal stroke: finite, because minus infinity turns into NaN where a loss multiplies it by its probability 0."""
LEAST: Final = -87.0
"""Logarithm of the least normal number, about: exponentials of what is below take ten times as long."""

_LAST_LAYER: Final = ("1.weight", "1.bias")
"""Weights of the layer that gives the logits (:func:`head`)."""


class LegalStrokes(Categorical):
    """A distribution over the legal strokes, for TorchRL's actors and losses.

    Built on the softmax kernels throughout: on a CPU, `exp` and `logsumexp` of a masked row cost ten times as much. Sampled
    by the inverse of the cumulative probabilities, because `torch.multinomial` costs more than the network.

    Args:
        logits: ``[..., n]`` of all strokes.
        mask: ``[..., n]`` bool, which strokes are legal.
    """

    def __init__(self, logits: torch.Tensor, *, mask: torch.Tensor) -> None:
        masked = torch.where(mask, logits, ILLEGAL)
        self.logits = functional.log_softmax(masked, dim=-1)
        if not self.logits.requires_grad:
            self.logits.clamp_min_(LEAST)  # targets of SAC take the exponential of all of them
        self.probs = functional.softmax(masked, dim=-1)
        self._param = self.logits
        self._num_events = logits.shape[-1]
        Distribution.__init__(self, logits.shape[:-1], validate_args=False)

    @torch.no_grad()
    def sample(self, sample_shape: torch.Size | list[int] | tuple[int, ...] = ()) -> torch.Tensor:
        """``[*sample_shape, *batch]`` strokes, none of them illegal."""
        total = self.probs.expand(*sample_shape, *self.probs.shape).cumsum(-1)
        # A draw in (0, total]: the first entry that reaches it belongs to a stroke whose probability is not zero.
        draw = (1 - torch.rand(*total.shape[:-1], 1, device=total.device)) * total[..., -1:]
        return torch.searchsorted(total, draw).squeeze(-1).clamp_max_(total.shape[-1] - 1)

    @property
    def deterministic_sample(self) -> torch.Tensor:
        """The most likely stroke."""
        return self.probs.argmax(-1)

    def log_prob(self, value: torch.Tensor) -> torch.Tensor:
        """Log-probability of ``[*sample_shape, *batch]`` strokes; that of an illegal one is :data:`LEAST` or less."""
        return self.logits.expand(*value.shape, -1).gather(-1, value.unsqueeze(-1)).squeeze(-1)

    def entropy(self) -> torch.Tensor:
        """In nats, over the legal strokes."""
        return -(self.probs * self.logits).sum(-1)


class DistinctStrokes(LegalStrokes):
    """The same over U distinct states, for R strokes of which each says in which of the states it was played.

    Args:
        logits: ``[U, n]`` of all strokes.
        mask: ``[U, n]`` bool, which strokes are legal.
        row: ``[R]`` state of each stroke.
    """

    def __init__(self, logits: torch.Tensor, *, mask: torch.Tensor, row: torch.Tensor) -> None:
        super().__init__(logits, mask=mask)
        self._row = row

    def log_prob(self, value: torch.Tensor) -> torch.Tensor:
        """``[R]`` log-probability of ``[R]`` strokes; of ``[K, U]`` strokes, one in each state, that of :class:`LegalStrokes`."""
        return self.logits[self._row, value] if value.dim() == 1 else super().log_prob(value)


class StateEncoder(nn.Module):
    """Turns ``[..., 6]`` observations into ``[..., width]`` numbers, then through hidden layers of the same width.

    Args:
        game: whose strokes they are.
        width: numbers in a layer.
        hidden: layers behind the embedding.
    """

    attributes: torch.Tensor

    def __init__(self, game: Game, width: int, hidden: int) -> None:
        super().__init__()
        rows = attribute_rows(game.catalogue)
        self.register_buffer("attributes", torch.from_numpy(rows), persistent=False)
        total = int(rows.max()) + 1
        self.own = nn.Embedding(total, width)
        self.incoming = nn.Embedding(total, width)
        self.contact = nn.Embedding(2, width)
        self.duel = nn.Embedding(LONGEST_DUEL + 1, width)
        self.effort = nn.Embedding(game.levels, width)
        self.opponent_effort = nn.Embedding(game.levels, width)
        for table in (self.own, self.incoming, self.contact):
            nn.init.normal_(table.weight, std=0.4)
        for table in (self.duel, self.effort, self.opponent_effort):
            # They change little of what a stroke is worth; what they do is learned from none.
            nn.init.zeros_(table.weight)
        layers: list[nn.Module] = [nn.ReLU()]
        for _ in range(hidden):
            layers += [nn.Linear(width, width), nn.ReLU()]
        self.layers = nn.Sequential(*layers)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """``[..., width]`` from ``[..., 6]`` observations, see :meth:`shuttle_marl.game.tables.Game.observation`."""
        # The strokes are few, so their vectors are made once and looked up; what comes with the incoming one is added before.
        own = functional.embedding(self.attributes, self.own.weight).sum(-2)
        incoming = functional.embedding(self.attributes, self.incoming.weight).sum(-2)
        offered = (incoming[:, None, None] + self.contact.weight[:, None] + self.duel.weight).flatten(0, 2)
        efforts = (self.effort.weight[:, None] + self.opponent_effort.weight).flatten(0, 1)
        of = observation.long()
        first = functional.embedding(of[..., 0], own)
        first = first + functional.embedding((2 * of[..., 1] + of[..., 2]) * (LONGEST_DUEL + 1) + of[..., 3], offered)
        if len(efforts) > 1:
            first = first + functional.embedding(len(self.opponent_effort.weight) * of[..., 4] + of[..., 5], efforts)
        encoded: torch.Tensor = self.layers(first)
        return encoded


class Logits(nn.Linear):
    """The last layer of a policy, with a temperature of its softmax that is no weight.

    Attributes:
        temperature: divides what the layer gives.
    """

    temperature: float = 1.0

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """``[..., n]`` logits."""
        logits = super().forward(input)
        return logits if self.temperature == 1 else logits / self.temperature


def head(game: Game, outputs: int, *, width: int, hidden: int, scale: float, layer: type[nn.Linear] = nn.Linear) -> nn.Sequential:
    """A network from observations to ``outputs`` numbers; ``scale`` shrinks the last layer, of some type, at the start."""
    last = layer(width, outputs)
    with torch.no_grad():
        last.weight.mul_(scale)
        last.bias.zero_()
    return nn.Sequential(StateEncoder(game, width, hidden), last)


def make_actor(game: Game, *, width: int, hidden: int, log_prob: bool = True, distinct: bool = False) -> ProbabilisticActor:
    """A stochastic policy: observation and action mask to action (and its log-probability).

    Args:
        game: the tables.
        width: numbers in a layer.
        hidden: layers behind the embedding.
        log_prob: whether it gives the log-probability.
        distinct: whether strokes say by ``row`` in which of some distinct states they were played (:class:`DistinctStrokes`).
    """
    network = head(game, game.n_strokes, width=width, hidden=hidden, scale=0.01, layer=Logits)
    keywords: dict[str, Any] = {"return_log_prob": True} if log_prob else {}
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["logits"]),
        in_keys={"logits": "logits", "mask": "action_mask", **({"row": "row"} if distinct else {})},
        out_keys=["action"],
        distribution_class=DistinctStrokes if distinct else LegalStrokes,
        **keywords,
    )


def make_critic(game: Game, *, width: int, hidden: int) -> ValueOperator:
    """The value of a state to its striker, in [-1, 1] when it has learned."""
    return ValueOperator(head(game, 1, width=width, hidden=hidden, scale=0.1), in_keys=["observation"])


def make_q_network(game: Game, *, width: int, hidden: int) -> "StrokeValues":
    """The value of every stroke in each of U states, or of R strokes alone (:class:`StrokeValues`)."""
    return StrokeValues(head(game, game.n_strokes, width=width, hidden=hidden, scale=0.1))


class StrokeValues(TensorDictModuleBase):
    """Values of strokes: of all in every state, or, where ``row`` and ``played`` are given, of those alone.

    Args:
        network: ``[U, 6]`` observations to ``[U, n]`` values.
    """

    in_keys: ClassVar[list[str]] = ["observation", "row", "played"]
    out_keys: ClassVar[list[str]] = ["action_value"]

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Add ``action_value``: ``[U, n]``, or ``[R, 1]`` of stroke ``played[r]`` in state ``row[r]``."""
        value = self.network(tensordict["observation"])
        if "row" in tensordict.keys():  # noqa: SIM118  a tensordict iterates over its rows
            value = value[tensordict["row"], tensordict["played"]].unsqueeze(-1)
        return tensordict.set("action_value", value)


def logit_network(actor: ProbabilisticActor) -> nn.Module:
    """The part of an actor that turns observations into logits."""
    network: nn.Module = actor.module[0].module
    return network


def set_temperature(network: nn.Module, temperature: float) -> None:
    """Set the temperature at which a network of :func:`logit_network` plays; no weight changes."""
    for module in network.modules():
        if isinstance(module, Logits):
            module.temperature = temperature


def weights_of(actor: ProbabilisticActor, temperature: float = 1.0) -> dict[str, F32]:
    """The weights of an actor by name, as an agent's folder holds them.

    Args:
        actor: the policy.
        temperature: of the softmax; the last layer is divided by it.
    """
    weights = {name: tensor.detach().cpu().numpy().copy() for name, tensor in logit_network(actor).state_dict().items()}
    for name in _LAST_LAYER:
        weights[name] /= np.float32(temperature)
    return weights


def tabulated(actor: ProbabilisticActor, game: Game, temperature: float = 1.0) -> TabulatedPolicy:
    """An actor on every state, as it is played from its folder.

    Args:
        actor: the policy.
        game: the tables.
        temperature: of the softmax.

    Raises:
        DivergedError: the network gives numbers that are not finite.
    """
    try:
        return PolicyNetwork.of_tensors(weights_of(actor, temperature), game).table(game)
    except PolicyError as error:
        raise DivergedError(str(error)) from error


def imitate(actor: ProbabilisticActor, policy: TabulatedPolicy, weight: F64, *, steps: int = 600) -> float:
    """Teach an actor to play like a policy; its draws come from torch's generator.

    Args:
        actor: changed in place.
        policy: to be imitated.
        weight: ``[S]`` how often each state is visited.
        steps: gradient steps.

    Returns:
        Cross-entropy beyond the policy's own entropy, in nats a stroke, at the end.
    """
    game = policy.game
    network = logit_network(actor)
    device = next(network.parameters()).device
    # Half of the states as they are visited, half from anywhere: rare states matter when play changes.
    playable = torch.tensor(game.playable).double()
    cumulative = (torch.from_numpy(weight) / weight.sum() + playable / playable.sum()).cumsum(0)
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    gap = torch.tensor(float("nan"))
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = 3e-3 * (1 - step / steps)
        drawn = torch.searchsorted(cumulative, torch.rand(1024, dtype=torch.float64) * cumulative[-1]).clamp_max(
            len(cumulative) - 1
        )
        states = drawn.numpy()
        target = torch.from_numpy(policy.probabilities(States(game=game, state=states.astype(np.int32)))).float().to(device)
        mask = torch.from_numpy(game.mask(states)).to(device)
        observation = torch.from_numpy(game.observation(states)).to(device)
        logits = functional.log_softmax(torch.where(mask, network(observation), ILLEGAL), dim=-1)
        gap = (torch.special.xlogy(target, target) - target * logits).sum(-1).mean()
        optimizer.zero_grad()
        gap.backward()
        optimizer.step()
    return float(gap.detach())
