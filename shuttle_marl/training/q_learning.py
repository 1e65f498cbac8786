"""Implicit Q-learning from a log (IQL, Kostrikov et al. 2022, arXiv 2110.06169).

V is an expectile of Q, and the policy is regressed with weights ``exp(beta (Q - V))``.

A rally is an episode without discount; its reward is 1 for winning it. Illegal strokes are masked everywhere, efforts not seen.
"""

import copy
import dataclasses
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from shuttle_marl.base.arrays import F64, Ints
from shuttle_marl.base.pytorch import InitialWeights, own_settings
from shuttle_marl.game.tables import Game
from shuttle_marl.recording.logs import Transitions
from shuttle_marl.training.networks import ILLEGAL, head

_LARGEST_WEIGHT: Final = 100.0
"""Bound of the weights of IQL, as in its paper."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class QConfig:
    """Settings.

    Attributes:
        batch: transitions of a step of the optimiser.
        steps: of the optimiser, from a log.
        target_interval: steps between copies of the target network.
        beta: inverse temperature of the policy of IQL.
    """

    width: int = 64
    hidden: int = 1
    learning_rate: float = 1e-3
    batch: int = 256
    steps: int = 1000
    target_interval: int = 200
    expectile: float = 0.7
    beta: float = 10.0


class _Batch(NamedTuple):
    """Some transitions as tensors; ``mask`` is ``[M, n]`` legal strokes."""

    seen: torch.Tensor
    mask: torch.Tensor
    stroke: torch.Tensor
    reward: torch.Tensor
    going: torch.Tensor
    following: torch.Tensor


def _batch(data: Transitions, rows: Ints) -> _Batch:
    game = data.game
    state, following = game.base(data.state[rows]), game.base(np.maximum(data.following[rows], 0))
    return _Batch(
        seen=torch.from_numpy(game.observation(state)),
        mask=torch.from_numpy(game.mask(state)),
        stroke=torch.from_numpy(data.stroke[rows].astype(np.int64))[:, None],
        reward=torch.from_numpy(data.reward[rows]),
        going=torch.from_numpy((data.following[rows] >= 0).astype(np.float32)),
        following=torch.from_numpy(game.observation(following)),
    )


class _Learner:
    """A Q-network with its target and optimiser."""

    def __init__(self, game: Game, config: QConfig, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)
        self.game, self.config, self.steps = game, config, 0
        self.q = self.network(game.n_strokes)
        self.target = copy.deepcopy(self.q)

    def network(self, outputs: int) -> nn.Module:
        with InitialWeights(self.generator):
            return head(self.game, outputs, width=self.config.width, hidden=self.config.hidden, scale=0.1)

    def optimiser(self, *networks: nn.Module) -> torch.optim.Adam:
        return torch.optim.Adam([p for network in networks for p in network.parameters()], lr=self.config.learning_rate)

    def step(self, optimiser: torch.optim.Optimizer, loss: torch.Tensor) -> None:
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        self.steps += 1
        if self.steps % self.config.target_interval == 0:
            self.target.load_state_dict(self.q.state_dict())

    @torch.no_grad()
    def table(self, network: nn.Module) -> F64:
        """``[base pairs]`` outputs of a network for the legal strokes of all states at effort 0."""
        game = self.game
        values = network(torch.from_numpy(game.observation(np.arange(game.n_base_states)))).numpy()
        return np.asarray(values[game.base_pair_state, game.base_pair_stroke], dtype=np.float64)


@own_settings(1)
def implicit_q(data: Transitions, config: QConfig, seed: int) -> F64:
    """``[base pairs]`` logits of the policy of IQL."""
    learner, rng = _Learner(data.game, config, seed), np.random.default_rng(seed)
    value, policy = learner.network(1), learner.network(data.game.n_strokes)
    optimiser = learner.optimiser(learner.q, value, policy)
    for _ in range(config.steps):
        batch = _batch(data, rng.integers(len(data), size=config.batch))
        v = value(batch.seen)[:, 0]
        with torch.no_grad():
            target = batch.reward + batch.going * value(batch.following)[:, 0]
            advantage = learner.target(batch.seen).gather(1, batch.stroke)[:, 0] - v
            weight = torch.exp(config.beta * advantage).clamp_max(_LARGEST_WEIGHT)
            above = torch.where(advantage > 0, config.expectile, 1 - config.expectile)
            goal = advantage + v
        logits = torch.where(batch.mask, policy(batch.seen), ILLEGAL)
        chosen = functional.log_softmax(logits, 1).gather(1, batch.stroke)[:, 0]
        error = functional.mse_loss(learner.q(batch.seen).gather(1, batch.stroke)[:, 0], target)
        learner.step(optimiser, error + (above * (goal - v) ** 2).mean() - (weight * chosen).mean())
    return learner.table(policy)
