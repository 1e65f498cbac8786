"""Advantage actor-critic: Mnih et al. 2016, arXiv 1602.01783, the synchronous form, with one gradient step per iteration.

The advantages A_t = delta_t + gamma lambda A_{t+1} are generalised (Schulman et al. 2016, arXiv 1506.02438); the collector
computes them (:mod:`shuttle_marl.training.learner`):

    loss = -E[log pi(a|s) A] + c_1 E[(V(s) - V_target(s))^2] - c_2 E[H(pi(.|s))].
"""

import torch
from tensordict import TensorDictBase
from torchrl.objectives import A2CLoss

from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import A2CConfig
from shuttle_marl.training.learner import Learner, Mean, normalised, set_learning_rate, weighted_sums
from shuttle_marl.training.networks import logit_network, make_actor, make_critic


class A2C(Learner):
    """Networks, loss and update of A2C."""

    def __init__(self, config: A2CConfig, game: Game) -> None:
        self.config = config
        self.actor = make_actor(game, width=config.width, hidden=config.hidden, distinct=True).to(config.device)
        self.critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)
        self.loss = A2CLoss(
            self.actor,
            self.critic,
            entropy_coeff=config.entropy,
            critic_coeff=config.critic,
            loss_critic_type="l2",  # at equal states, its gradient depends on the mean of the targets alone
            reduction="none",
        )
        self.loss.entropy_bonus = True  # otherwise a weight of 0 removes the entropy from the output
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate, fused=True)
        self.modules, self.optimizers = {"loss": self.loss}, {"optimizer": self.optimizer}

    def predict(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits and values, see :meth:`Learner.predict`."""
        return logit_network(self.actor)(observation), self.critic.module(observation).squeeze(-1)

    def update(self, data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Take one gradient step, see :meth:`Learner.update`."""
        config, loss = self.config, self.loss
        set_learning_rate(self.optimizer, config.learning_rate, remaining)
        loss.entropy_coeff.fill_(config.entropy * remaining)
        data = normalised(data)  # w(s) = N(s) / N, and A / (N std(A))
        # The objective is a sum over rows of (s, a, sign of A), the other terms are sums over states with weights w(s).
        terms = weighted_sums(loss(data), data["weight"])
        total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        self.optimizer.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(loss.parameters(), config.gradient_norm)
        self.optimizer.step()
        mean = Mean("loss_objective", "loss_critic", "loss_entropy")
        mean.add(terms)
        return mean.values()
