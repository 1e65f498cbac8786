"""Proximal policy optimisation (Schulman, Wolski, Dhariwal, Radford & Klimov 2017, arXiv 1707.06347), and advantage actor-critic.

The clipped surrogate objective of eq. 7, with generalised advantages (Schulman et al. 2016, arXiv 1506.02438), computed backwards
through each rally by the collector; gamma is 1 against opponents, and -1 in self-play, where the next state is the opponent's:

    delta_t = r_t + gamma V(s_{t+1}) - V(s_t),    A_t = delta_t + gamma lambda A_{t+1},    V_target(s_t) = A_t + V(s_t),
    L_CLIP = E[min(rho A, clip(rho, 1 - epsilon, 1 + epsilon) A)],    rho = pi(a|s) / pi_old(a|s),
    loss = -L_CLIP + c_1 E[(V(s) - V_target(s))^2] - c_2 E[H(pi(.|s))].

A2C (Mnih et al. 2016, arXiv 1602.01783, the synchronous form) takes one gradient step per iteration, at rho = 1, where the loss
is not clipped and has the gradient of

    loss = -E[log pi(a|s) A] + c_1 E[(V(s) - V_target(s))^2] - c_2 E[H(pi(.|s))].

Each distinct state is computed once, and weighted by its number of strokes: :mod:`shuttle_marl.training.learner`.
"""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.objectives import A2CLoss, ClipPPOLoss, LossModule

from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import A2CConfig, PPOConfig
from shuttle_marl.training.learner import IDLE, Callback, Learner, Mean, set_learning_rate, weighted_sums
from shuttle_marl.training.networks import logit_network, make_actor, make_critic, set_temperature
from shuttle_marl.training.self_play import ReferencePolicy

_TERMS = ("loss_objective", "loss_critic", "loss_entropy")


class ActorCritic(Learner):
    """PPO and A2C, which differ in their loss, with options of its own, and in the number of gradient steps."""

    config: A2CConfig | PPOConfig
    reference: ReferencePolicy | None = None
    epochs, minibatches = 1, 1
    logged: tuple[str, ...] = _TERMS

    def __init__(
        self,
        config: A2CConfig | PPOConfig,
        game: Game,
        opponents: Sequence[TabulatedPolicy],
        loss: type[LossModule],
        **options: Any,
    ) -> None:
        super().__init__(config, game, opponents)
        self.actor = make_actor(game, width=config.width, hidden=config.hidden, distinct=True).to(config.device)  # pi(a|s)
        self.critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)  # V(s)
        self.loss: Any = loss(
            self.actor,
            self.critic,
            critic_coeff=config.critic,  # c_1
            entropy_coeff=config.entropy,  # c_2
            loss_critic_type="l2",  # at equal states, its gradient depends on the mean of the targets alone
            reduction="none",
            **options,
        )
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate, fused=True)
        self.modules, self.optimizers = {"loss": self.loss}, {"optimizer": self.optimizer}

    def predict(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits and values, see :meth:`Learner.predict`."""
        return logit_network(self.actor)(observation), self.critic.module(observation).squeeze(-1)

    def iterate(self, remaining: float, run: Callback = IDLE) -> None:
        """Collect rallies, and take ``epochs * minibatches`` gradient steps; a run repeats this, see :meth:`Learner.iterate`."""
        self.anneal(remaining)
        run.begin(self)
        # Collect: strokes (s, a) of pi_old, with A and V_target.
        data = self.collect()
        run.collected(self)
        # Update, with advantages A / (N std(A)) and weights w(s) = N(s) / N.
        mean = Mean(*self.logged)
        for _ in range(self.epochs):
            for part in self.collector.minibatches(data, self.minibatches):
                mean.add(self.step(part))
        run.learned(self, mean.values())

    def anneal(self, remaining: float) -> None:
        """Set the learning rate and the weight of the entropy."""
        set_learning_rate(self.optimizer, self.config.learning_rate, remaining)
        self.loss.entropy_coeff.fill_(self.config.entropy * remaining)

    def step(self, part: TensorDictBase) -> TensorDictBase:
        """Take a gradient step on a minibatch; returns the terms of the loss.

        The objective is a sum over rows of (s, a, sign of A), the other terms are sums over states with weights w(s).
        """
        terms = weighted_sums(self.loss(part), part["weight"])
        loss = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        if self.reference is not None:
            loss = loss + self.reference.penalty(part)
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.loss.parameters(), self.config.gradient_norm)
        self.optimizer.step()
        return terms


class PPO(ActorCritic):
    """The clipped loss, epochs of minibatches, a falling temperature of pi, and the penalties of some variants of self-play."""

    config: PPOConfig

    def __init__(self, config: PPOConfig, game: Game, opponents: Sequence[TabulatedPolicy] = ()) -> None:
        super().__init__(config, game, opponents, ClipPPOLoss, clip_epsilon=config.clip, normalize_advantage=False)
        self.epochs, self.minibatches = config.epochs, config.minibatches
        self.logged = (*_TERMS, "clip_fraction", "kl_approx")
        if config.variant in ("magnet", "emagnet", "nash"):
            self.reference = ReferencePolicy(config, logit_network(self.actor))
            self.modules = {**self.modules, "reference": self.reference.network}

    def anneal(self, remaining: float) -> None:
        """Lower the softmax temperature too, from ``anneal_after`` of the run on, and move the reference policy."""
        super().anneal(remaining)
        start = self.config.anneal_after
        assert start is not None  # set by the configuration
        progress = max(0.0, 1 - remaining - start) / (1 - start) if start < 1 else 0.0
        set_temperature(logit_network(self.actor), self.config.final_temperature**progress)
        if self.reference is not None:
            set_temperature(self.reference.network, self.config.final_temperature**progress)
            self.reference.update(self.iteration)
        if self.config.variant == "emagnet":
            self.loss.entropy_coeff.zero_()


class A2C(ActorCritic):
    """The loss at rho = 1, and one gradient step."""

    def __init__(self, config: A2CConfig, game: Game, opponents: Sequence[TabulatedPolicy] = ()) -> None:
        super().__init__(config, game, opponents, A2CLoss)
        self.loss.entropy_bonus = True  # otherwise a weight of 0 removes the entropy from the output
