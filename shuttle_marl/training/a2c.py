"""Advantage actor-critic: Mnih et al. 2016, arXiv 1602.01783, the synchronous form.

One gradient step an iteration: log pi(a|s) times the advantage, a value loss, an entropy bonus. In self-play the next state
belongs to the opponent, whose value is minus ours: gamma = -1 makes the same recursion that of a zero-sum game.
"""

import torch
from tensordict import TensorDictBase
from torchrl.objectives import A2CLoss, ValueEstimators

from shuttle_marl.game.rally import Game
from shuttle_marl.training.config import A2CConfig
from shuttle_marl.training.learner import (
    Tensors,
    checked,
    module_state,
    optimizer_state,
    restore_module,
    restore_optimizer,
    set_rate,
)
from shuttle_marl.training.networks import make_actor, make_critic


class A2C:
    """See :class:`shuttle_marl.training.learner.Learner`."""

    def __init__(self, config: A2CConfig, game: Game) -> None:
        self.config = config
        self.actor = make_actor(game, width=config.width, hidden=config.hidden).to(config.device)
        self.critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)
        self.loss = A2CLoss(self.actor, self.critic, entropy_coeff=config.entropy, critic_coeff=config.critic)
        self.loss.entropy_bonus = True  # with a weight of 0 it would leave the entropy out
        # A vectorised estimator fails on a negative gamma.
        gamma = -1.0 if config.self_play else 1.0
        self.loss.make_value_estimator(ValueEstimators.GAE, gamma=gamma, lmbda=config.lmbda, vectorized=False)
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate)

    def learn(self, data: TensorDictBase, left: float) -> dict[str, float]:
        """One iteration: advantages, then one gradient step."""
        config = self.config
        set_rate(self.optimizer, config.learning_rate, left)
        self.loss.entropy_coeff.fill_(config.entropy * left)
        with torch.no_grad():
            self.loss.value_estimator(data)
        strokes = data.reshape(-1)
        advantage = strokes["advantage"]
        strokes["advantage"] = (advantage - advantage.mean()) / advantage.std().clamp_min(1e-6)
        terms = self.loss(strokes)
        total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        self.optimizer.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(self.loss.parameters(), config.gradient_norm)
        self.optimizer.step()
        return checked({name: terms[name].item() for name in ("loss_objective", "loss_critic", "entropy")})

    def state(self) -> Tensors:
        """Networks and moments of the gradient."""
        return {**module_state("loss", self.loss), **optimizer_state("optimizer", self.optimizer)}

    def restore(self, tensors: Tensors) -> None:
        """Take over what :meth:`state` gave."""
        restore_module("loss", self.loss, tensors)
        restore_optimizer("optimizer", self.optimizer, tensors)
