"""Proximal policy optimisation (Schulman, Wolski, Dhariwal, Radford & Klimov 2017, arXiv 1707.06347), and advantage actor-critic.

The clipped surrogate objective of eq. 7, with generalised advantages (Schulman et al. 2016, arXiv 1506.02438). The collector
computes them backwards through each rally (:mod:`shuttle_marl.training.learner`); gamma is 1 against opponents, and -1 in
self-play, where the next state is the opponent's:

    delta_t = r_t + gamma V(s_{t+1}) - V(s_t),    A_t = delta_t + gamma lambda A_{t+1},    V_target(s_t) = A_t + V(s_t),
    L_CLIP = E[min(rho A, clip(rho, 1 - epsilon, 1 + epsilon) A)],    rho = pi(a|s) / pi_old(a|s),
    loss = -L_CLIP + c_1 E[(V(s) - V_target(s))^2] - c_2 E[H(pi(.|s))].

A2C (Mnih et al. 2016, arXiv 1602.01783, the synchronous form) takes one gradient step per iteration, at rho = 1, where the loss
is not clipped and has the gradient of

    loss = -E[log pi(a|s) A] + c_1 E[(V(s) - V_target(s))^2] - c_2 E[H(pi(.|s))].
"""

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.objectives import A2CLoss, ClipPPOLoss, LossModule

from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import A2CConfig, PPOConfig
from shuttle_marl.training.learner import Learner, Mean, minibatches, normalised, set_learning_rate, weighted_sums
from shuttle_marl.training.networks import logit_network, make_actor, make_critic, set_temperature
from shuttle_marl.training.self_play import ReferencePolicy


class ActorCritic(Learner):
    """Networks and gradient steps of A2C and PPO, whose losses are a sum of objective, value error and entropy.

    Args:
        **options: of the loss, besides those that both have.
    """

    def __init__(self, config: A2CConfig | PPOConfig, game: Game, loss: type[LossModule], **options: Any) -> None:
        self.actor = make_actor(game, width=config.width, hidden=config.hidden, distinct=True).to(config.device)
        self.critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)
        self.loss: Any = loss(
            self.actor,
            self.critic,
            entropy_coeff=config.entropy,
            critic_coeff=config.critic,
            loss_critic_type="l2",  # at equal states, its gradient depends on the mean of the targets alone
            reduction="none",
            **options,
        )
        self._config, self.optimizer = config, torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate, fused=True)
        self.modules, self.optimizers = {"loss": self.loss}, {"optimizer": self.optimizer}

    def predict(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits and values, see :meth:`Learner.predict`."""
        return logit_network(self.actor)(observation), self.critic.module(observation).squeeze(-1)

    def decay(self, remaining: float) -> None:
        """Set the learning rate and the weight of the entropy for an iteration."""
        set_learning_rate(self.optimizer, self._config.learning_rate, remaining)
        self.loss.entropy_coeff.fill_(self._config.entropy * remaining)

    def step(self, part: TensorDictBase, penalty: Callable[[TensorDictBase], torch.Tensor] | None = None) -> TensorDictBase:
        """Take a gradient step on a minibatch; returns the terms of the loss.

        The objective is a sum over rows of (s, a, sign of A), the other terms are sums over states with weights w(s).
        """
        terms = weighted_sums(self.loss(part), part["weight"])
        total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        if penalty is not None:
            total = total + penalty(part)
        self.optimizer.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(self.loss.parameters(), self._config.gradient_norm)
        self.optimizer.step()
        return terms


class PPO(ActorCritic):
    """Networks, loss and update of PPO."""

    def __init__(self, config: PPOConfig, game: Game) -> None:
        super().__init__(config, game, ClipPPOLoss, clip_epsilon=config.clip, normalize_advantage=False)
        self.config = config
        self.reference: ReferencePolicy | None = None
        if config.variant in ("magnet", "emagnet", "nash"):
            self.reference = ReferencePolicy(config, logit_network(self.actor))
            self.modules = {**self.modules, "reference": self.reference.network}

    def prepare(self, remaining: float) -> None:
        """Anneal the softmax temperature geometrically from 1 to ``final_temperature``, after ``anneal_after`` of the run."""
        start = self.config.anneal_after
        assert start is not None  # set by the configuration
        progress = max(0.0, 1 - remaining - start) / (1 - start) if start < 1 else 0.0
        set_temperature(logit_network(self.actor), self.config.final_temperature**progress)
        if self.reference is not None:
            set_temperature(self.reference.network, self.config.final_temperature**progress)

    def update(self, data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Take ``epochs * minibatches`` gradient steps, see :meth:`Learner.update`."""
        config, reference = self.config, self.reference
        self.decay(remaining)
        if reference is not None:
            reference.update(self.iteration)
        if config.variant == "emagnet":
            self.loss.entropy_coeff.zero_()

        def penalty(part: TensorDictBase) -> torch.Tensor:
            assert reference is not None
            return config.magnet_coef * (part["weight"] * reference.divergence(part)).sum()

        mean = Mean("loss_objective", "loss_critic", "loss_entropy", "clip_fraction", "kl_approx")
        data = normalised(data)  # w(s) = N(s) / N, and A / (N std(A))
        for _ in range(config.epochs):
            for part in minibatches(data, config.minibatches):
                mean.add(self.step(part, None if reference is None else penalty))
        return mean.values()


class A2C(ActorCritic):
    """Networks, loss and update of A2C."""

    def __init__(self, config: A2CConfig, game: Game) -> None:
        super().__init__(config, game, A2CLoss)
        self.loss.entropy_bonus = True  # otherwise a weight of 0 removes the entropy from the output

    def update(self, data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Take one gradient step, see :meth:`Learner.update`."""
        self.decay(remaining)
        mean = Mean("loss_objective", "loss_critic", "loss_entropy")
        mean.add(self.step(normalised(data)))  # w(s) = N(s) / N, and A / (N std(A))
        return mean.values()
