"""Implicit Q-learning from a log (IQL, Kostrikov et al. 2022, arXiv 2110.06169).

V is an expectile of Q, and the policy is regressed with weights ``exp(beta (Q - V))``.

A rally is an episode without discount; its reward is 1 for winning it. Illegal strokes are masked everywhere, efforts not seen.
"""

import copy
import dataclasses
from typing import Final

import numpy as np
import torch
from torch.nn import functional

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.pytorch import InitialWeights, own_settings
from shuttle_marl.recording.logs import Transitions
from shuttle_marl.training.networks import ILLEGAL, head

_LARGEST_WEIGHT: Final = 100.0


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


@own_settings(1)
def implicit_q(data: Transitions, config: QConfig, seed: int) -> F64:
    """``[base pairs]`` logits of the policy of IQL, for the legal strokes of all states at effort 0."""
    game, rng = data.game, np.random.default_rng(seed)
    with InitialWeights(seed):
        q, value, policy = (
            head(game, outputs, width=config.width, hidden=config.hidden, scale=0.1)
            for outputs in (game.n_strokes, 1, game.n_strokes)
        )
    target_q = copy.deepcopy(q)
    weights = [*q.parameters(), *value.parameters(), *policy.parameters()]
    optimiser = torch.optim.Adam(weights, lr=config.learning_rate)
    for step in range(1, config.steps + 1):
        rows = rng.integers(len(data), size=config.batch)
        state, following = game.base(data.state[rows]), game.base(np.maximum(data.following[rows], 0))
        s, s_next = torch.from_numpy(game.observation(state)), torch.from_numpy(game.observation(following))
        a = torch.from_numpy(data.stroke[rows].astype(np.int64))[:, None]
        going = torch.from_numpy((data.following[rows] >= 0).astype(np.float32))
        v = value(s)[:, 0]
        with torch.no_grad():
            target = torch.from_numpy(data.reward[rows]) + going * value(s_next)[:, 0]
            advantage = target_q(s).gather(1, a)[:, 0] - v
            weight = torch.exp(config.beta * advantage).clamp_max(_LARGEST_WEIGHT)
            above = torch.where(advantage > 0, config.expectile, 1 - config.expectile)
            goal = advantage + v
        log_pi = functional.log_softmax(torch.where(torch.from_numpy(game.mask(state)), policy(s), ILLEGAL), 1)
        error = functional.mse_loss(q(s).gather(1, a)[:, 0], target)
        loss = error + (above * (goal - v) ** 2).mean() - (weight * log_pi.gather(1, a)[:, 0]).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step % config.target_interval == 0:
            target_q.load_state_dict(q.state_dict())
    with torch.no_grad():
        logits = policy(torch.from_numpy(game.observation(np.arange(game.n_base_states)))).numpy()
    return np.asarray(logits[game.base_pair_state, game.base_pair_stroke], dtype=np.float64)
