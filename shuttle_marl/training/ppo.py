"""Proximal policy optimisation: Schulman, Wolski, Dhariwal, Radford & Klimov 2017, arXiv 1707.06347.

The clipped surrogate objective of eq. 7, with generalised advantages (Schulman et al. 2016, arXiv 1506.02438). The collector
computes them backwards through each rally (:mod:`shuttle_marl.training.learner`); gamma is 1 against opponents, and -1 in
self-play, where the next state is the opponent's:

    delta_t = r_t + gamma V(s_{t+1}) - V(s_t),    A_t = delta_t + gamma lambda A_{t+1},    V_target(s_t) = A_t + V(s_t),
    L_CLIP = E[min(rho A, clip(rho, 1 - epsilon, 1 + epsilon) A)],    rho = pi(a|s) / pi_old(a|s),
    loss = -L_CLIP + c_1 E[(V(s) - V_target(s))^2] - c_2 E[H(pi(.|s))].
"""

import torch
from tensordict import TensorDictBase
from torchrl.objectives import ClipPPOLoss

from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import PPOConfig
from shuttle_marl.training.learner import Learner, Mean, minibatches, normalised, set_learning_rate, weighted_sums
from shuttle_marl.training.networks import logit_network, make_actor, make_critic, set_temperature
from shuttle_marl.training.self_play import ReferencePolicy


class PPO(Learner):
    """Networks, loss and update of PPO."""

    def __init__(self, config: PPOConfig, game: Game) -> None:
        self.config = config
        self.actor = make_actor(game, width=config.width, hidden=config.hidden, distinct=True).to(config.device)
        self.critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)
        self.loss = ClipPPOLoss(
            self.actor,
            self.critic,
            clip_epsilon=config.clip,
            entropy_coeff=config.entropy,
            critic_coeff=config.critic,
            loss_critic_type="l2",  # at equal states, its gradient depends on the mean of the targets alone
            normalize_advantage=False,
            reduction="none",
        )
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate, fused=True)
        self.modules, self.optimizers = {"loss": self.loss}, {"optimizer": self.optimizer}
        self.reference: ReferencePolicy | None = None
        if config.variant in ("magnet", "nash"):
            self.reference = ReferencePolicy(config, logit_network(self.actor))
            self.modules["reference"] = self.reference.network

    def predict(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits and values, see :meth:`Learner.predict`."""
        return logit_network(self.actor)(observation), self.critic.module(observation).squeeze(-1)

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
        config, loss = self.config, self.loss
        set_learning_rate(self.optimizer, config.learning_rate, remaining)
        loss.entropy_coeff.fill_(config.entropy * remaining)
        if self.reference is not None:
            self.reference.update(self.iteration)
        mean = Mean("loss_objective", "loss_critic", "loss_entropy", "clip_fraction", "kl_approx")
        data = normalised(data)  # w(s) = N(s) / N, and A / (N std(A))
        for _ in range(config.epochs):
            for part in minibatches(data, config.minibatches):
                # -L_CLIP is a sum over rows of (s, a, sign of A), the other terms are sums over states with weights w(s).
                terms = weighted_sums(loss(part), part["weight"])
                total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
                if self.reference is not None:
                    total = total + config.magnet_coef * (part["weight"] * self.reference.divergence(part)).sum()
                self.optimizer.zero_grad()
                total.backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), config.gradient_norm)
                self.optimizer.step()
                mean.add(terms)
        return mean.values()
