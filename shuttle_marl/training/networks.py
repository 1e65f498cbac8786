"""Networks: attribute embeddings of the observation, a masked policy head, and values.

A state consists of two strokes, a contact, the length of a duel at the net and both players' efforts; a stroke has a shot type,
area, contact height and technique. The first layer is the sum of an embedding of each attribute, of each stroke as a whole, and
of the other parts of the state, separately for the striker's own last stroke and the incoming one; so all smashes share weights.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical, Distribution
from torch.nn import functional
from torchrl.modules import ProbabilisticActor, ValueOperator

from shuttle_marl.base.arrays import F32, I32, Bools, Ints
from shuttle_marl.game.layout import LONGEST_DUEL, SWAP_TOKENS
from shuttle_marl.game.policy import PolicyError, TabulatedPolicy
from shuttle_marl.game.shipped import default_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.agents import read_card, read_weights
from shuttle_marl.policy.network import PolicyNetwork, attribute_rows
from shuttle_marl.training.config import TrainingError

ILLEGAL: Final = -1e9  # logit of an illegal stroke; finite, because a loss multiplies it by its probability 0
MIN_LOG: Final = -87.0  # approximate logarithm of the smallest normal float32; exponentials below it are ten times slower

Tensors = dict[str, torch.Tensor]

_LAST_LAYER: Final = ("1.weight", "1.bias")


class DivergedError(TrainingError):
    """Learning diverged: a loss, a weight or a probability is not finite."""


def decision_observations(game: Game, decisions: Ints) -> I32:
    """``[U, 7]`` observations of states; with recovery ``[U, 8]`` of decisions, see :data:`shuttle_marl.kernel.Assess`.

    A player who is to choose a position sees the strokes and efforts with their own first, and 1 as the last number.
    """
    own, position = game.observation(decisions % game.n_states), (decisions >= game.n_states)[:, None]
    seen = np.hstack([np.where(position, own[:, SWAP_TOKENS], own), position], dtype=np.int32)
    return seen[:, : own.shape[1] + game.hides]


def decision_masks(game: Game, decisions: Ints) -> Bools:
    """``[U, n]`` legal strokes of states; with recovery ``[U, n + 9]`` legal actions of decisions."""
    position, states = (decisions >= game.n_states)[:, None], decisions % game.n_states
    return np.hstack([game.mask(states) & ~position, game.waiting.mask(game.base(states)) & position])[:, : game.n_actions]


class Observer:
    """Network inputs of states, or with recovery of decisions, as tensors on a device."""

    def __init__(self, game: Game, device: str) -> None:
        self.device, self._game = torch.device(device), game
        seen = decision_observations(game, np.arange(game.n_decisions))
        self._observation = torch.from_numpy(seen).to(self.device)
        self._stroke = torch.from_numpy(game.base_pair_stroke.astype(np.int64)).to(self.device)
        self._position = torch.from_numpy(np.maximum(game.waiting.position, 0).astype(np.int64).ravel()).to(self.device)

    def observations(self, states: torch.Tensor) -> torch.Tensor:
        """``[U, 7]`` observations of ``[U]`` states, with recovery ``[U, 8]`` of decisions."""
        return self._observation[states.long().to(self.device)]

    def inputs(self, states: torch.Tensor) -> Tensors:
        """``[U, 7]`` observations and ``[U, n]`` masks of ``[U]`` states; with recovery ``[U, 8]``, ``[U, n + 9]``."""
        masks = torch.from_numpy(decision_masks(self._game, states.numpy())).to(self.device)
        return {"observation": self.observations(states), "action_mask": masks}

    def strokes(self, pairs: torch.Tensor) -> torch.Tensor:
        """``[R]`` catalogue indices of ``[R]`` legal pairs; n + p of positions, see :mod:`shuttle_marl.kernel.table_play`."""
        pairs = pairs.long().to(self.device)
        stroke = self._stroke[pairs % len(self._stroke)]
        positions = self._position[(pairs - self._game.n_pairs) % len(self._position)]
        return torch.where(pairs < self._game.n_pairs, stroke, self._game.n_strokes + positions)


class LegalStrokes(Categorical):
    """Distribution over the legal strokes, for TorchRL's actors and losses.

    It uses softmax kernels, because `exp` and `logsumexp` of masked rows are ten times slower on a CPU, and samples by the
    inverse CDF, because `torch.multinomial` takes longer than the network.

    Args:
        logits: ``[..., n]`` logits of all strokes.
        mask: ``[..., n]`` bool, True for legal strokes.
        row: of distinct states, ``[R]`` index of the state of each stroke.
        generator: of the random numbers of samples; None: PyTorch's own.
    """

    def __init__(
        self,
        logits: torch.Tensor,
        *,
        mask: torch.Tensor,
        row: torch.Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        self._row, self._generator = row, generator
        masked = torch.where(mask, logits, ILLEGAL)
        self.logits = functional.log_softmax(masked, dim=-1)
        if not self.logits.requires_grad:
            self.logits.clamp_min_(MIN_LOG)  # targets of SAC use all exponentials
        self.probs = functional.softmax(masked, dim=-1)
        self._param = self.logits
        self._num_events = logits.shape[-1]
        Distribution.__init__(self, logits.shape[:-1], validate_args=False)

    @torch.no_grad()
    def sample(self, sample_shape: torch.Size | list[int] | tuple[int, ...] = ()) -> torch.Tensor:
        """``[*sample_shape, *batch]`` legal strokes."""
        total = self.probs.expand(*sample_shape, *self.probs.shape).cumsum(-1)
        # A draw in (0, total]: the first entry that reaches it has a positive probability.
        draw = (1 - torch.rand(*total.shape[:-1], 1, device=total.device, generator=self._generator)) * total[..., -1:]
        return torch.searchsorted(total, draw).squeeze(-1).clamp_max_(total.shape[-1] - 1)

    @property
    def deterministic_sample(self) -> torch.Tensor:
        """The most probable stroke."""
        return self.probs.argmax(-1)

    def log_prob(self, value: torch.Tensor) -> torch.Tensor:
        """Log-probability of ``[*sample_shape, *batch]`` strokes, :data:`MIN_LOG` or less for illegal ones; or of ``[R]``."""
        if self._row is not None and value.dim() == 1:
            return self.logits[self._row, value]
        return self.logits.expand(*value.shape, -1).gather(-1, value.unsqueeze(-1)).squeeze(-1)

    def entropy(self) -> torch.Tensor:
        """Entropy over the legal strokes, in nats."""
        return -(self.probs * self.logits).sum(-1)


class StateEncoder(nn.Module):
    """Embedding of ``[..., 7]`` observations, ``[..., 8]`` with recovery; then hidden layers, with ``[..., width]`` outputs."""

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
        self.hurried = nn.Embedding(2, width)
        self.position = nn.Embedding(2, width) if game.hides else None
        for table in filter(None, (self.own, self.incoming, self.contact, self.position)):
            nn.init.normal_(table.weight, std=0.4)
        for table in (self.duel, self.effort, self.opponent_effort, self.hurried):
            # These attributes change values little, so their effect is learned from zero.
            nn.init.zeros_(table.weight)
        layers: list[nn.Module] = [nn.ReLU()]
        for _ in range(hidden):
            layers += [nn.Linear(width, width), nn.ReLU()]
        self.layers = nn.Sequential(*layers)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """``[..., width]`` from ``[..., 7]`` observations, see :meth:`shuttle_marl.game.tables.Game.observation`."""
        # There are few strokes, so their vectors are computed once and looked up, together with contact, duel and hurried.
        own = functional.embedding(self.attributes, self.own.weight).sum(-2)
        incoming = functional.embedding(self.attributes, self.incoming.weight).sum(-2)
        offered = incoming[:, None, None, None] + self.contact.weight[:, None, None] + self.duel.weight[:, None]
        offered = (offered + self.hurried.weight).flatten(0, 3)
        efforts = (self.effort.weight[:, None] + self.opponent_effort.weight).flatten(0, 1)
        of = observation.long()
        first = functional.embedding(of[..., 0], own)
        duel = (2 * of[..., 1] + of[..., 2]) * (LONGEST_DUEL + 1) + of[..., 3]
        first = first + functional.embedding(2 * duel + of[..., 6], offered)
        if len(efforts) > 1:
            first = first + functional.embedding(len(self.opponent_effort.weight) * of[..., 4] + of[..., 5], efforts)
        if self.position is not None:
            first = first + self.position(of[..., 7])
        encoded: torch.Tensor = self.layers(first)
        return encoded


class Logits(nn.Linear):
    """Last layer of a policy."""

    temperature: float = 1.0  # softmax temperature, which divides the output; it is not a weight

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        """``[..., n]`` logits."""
        logits = super().forward(input)
        return logits if self.temperature == 1 else logits / self.temperature


def head(game: Game, outputs: int, *, width: int, hidden: int, scale: float, layer: type[nn.Linear] = nn.Linear) -> nn.Sequential:
    """Network from observations to ``outputs`` numbers; ``scale`` multiplies the initial weights of the last layer."""
    last = layer(width, outputs)
    with torch.no_grad():
        last.weight.mul_(scale)
        last.bias.zero_()
    return nn.Sequential(StateEncoder(game, width, hidden), last)


def make_actor(game: Game, *, width: int, hidden: int, log_prob: bool = True, distinct: bool = False) -> ProbabilisticActor:
    """Stochastic policy from observation and action mask to action; ``distinct``: whether it has the entry ``row``."""
    network = head(game, game.n_actions, width=width, hidden=hidden, scale=0.01, layer=Logits)
    keywords: dict[str, Any] = {"return_log_prob": True} if log_prob else {}
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["logits"]),
        in_keys={"logits": "logits", "mask": "action_mask", **({"row": "row"} if distinct else {})},
        out_keys=["action"],
        distribution_class=LegalStrokes,
        **keywords,
    )


def make_critic(game: Game, *, width: int, hidden: int) -> ValueOperator:
    """Value of a state to its striker."""
    return ValueOperator(head(game, 1, width=width, hidden=hidden, scale=0.1), in_keys=["observation"])


def make_q_network(game: Game, *, width: int, hidden: int) -> "StrokeValues":
    """Values Q(s, a) of strokes, see :class:`StrokeValues`."""
    return StrokeValues(head(game, game.n_actions, width=width, hidden=hidden, scale=0.1))


class StrokeValues(TensorDictModule):
    """Values ``[U, n]`` of all strokes in ``[U, 7]`` observations, or of R strokes if ``row`` and ``played`` are there."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__(network, in_keys=["observation", "row", "played"], out_keys=["action_value"])

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Set ``action_value``: ``[U, n]``, or ``[R, 1]`` of stroke ``played[r]`` in state ``row[r]``."""
        value = self.module(tensordict["observation"])
        if "row" in tensordict.keys():  # noqa: SIM118  a tensordict iterates over its rows
            value = value[tensordict["row"], tensordict["played"]].unsqueeze(-1)
        return tensordict.set("action_value", value)


def logit_network(actor: ProbabilisticActor) -> nn.Module:
    """The network of an actor from observations to logits."""
    network: nn.Module = actor.module[0].module
    return network


def agent_network(folder: Path | str, game: Game | None = None) -> nn.Module:
    """The network of a trained agent, from ``[..., 7]`` observations (:meth:`~shuttle_marl.game.tables.Game.observation`) to
    logits of all strokes ``[..., n]``; in the game with recovery from ``[..., 8]`` to strokes and positions, ``[..., n + 9]``.

    Args:
        folder: of the agent, such as ``runs/ppo-0/agent``.
        game: that of the agent; None: the benchmark's.

    Raises:
        PolicyError: the folder holds no agent, a damaged one, or one of another game.
    """
    game = game or default_game()
    _, weights = read_weights(Path(folder), read_card(Path(folder)))
    try:
        layers = sum(name.startswith("0.layers.") and name.endswith(".weight") for name in weights)
        network = head(game, game.n_actions, width=weights["1.weight"].shape[1], hidden=layers, scale=1.0, layer=Logits)
        network.load_state_dict({name: torch.from_numpy(np.array(part)) for name, part in weights.items()})
    except (KeyError, RuntimeError, IndexError) as error:
        raise PolicyError(f"{folder}: the network of another game, or of another program ({error!s:.200})") from error
    return network.eval()


def set_temperature(network: nn.Module, temperature: float) -> None:
    """Set the softmax temperature of a network of :func:`logit_network`; no weight changes."""
    for module in network.modules():
        if isinstance(module, Logits):
            module.temperature = temperature


def weights_of(actor: ProbabilisticActor, temperature: float = 1.0) -> dict[str, F32]:
    """Weights of an actor by name; the last layer is divided by the softmax temperature."""
    weights = {name: tensor.detach().cpu().numpy().copy() for name, tensor in logit_network(actor).state_dict().items()}
    for name in _LAST_LAYER:
        weights[name] /= np.float32(temperature)
    return weights


def tabulated(actor: ProbabilisticActor, game: Game, temperature: float = 1.0) -> TabulatedPolicy:
    """Tabulate an actor at a softmax temperature. Raises DivergedError: an output of the network is not finite."""
    try:
        return PolicyNetwork.of_tensors(weights_of(actor, temperature), game).table(game)
    except PolicyError as error:
        raise DivergedError(str(error)) from error
