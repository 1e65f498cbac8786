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
from shuttle_marl.training.learner import ActorCritic, Mean, minibatches, normalised
from shuttle_marl.training.networks import logit_network, set_temperature
from shuttle_marl.training.self_play import ReferencePolicy


class PPO(ActorCritic):
    """Networks, loss and update of PPO."""

    def __init__(self, config: PPOConfig, game: Game) -> None:
        super().__init__(config, game, ClipPPOLoss, clip_epsilon=config.clip, normalize_advantage=False)
        self.config = config
        self.reference: ReferencePolicy | None = None
        if config.variant in ("magnet", "nash"):
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

        def penalty(part: TensorDictBase) -> torch.Tensor:
            assert reference is not None
            return config.magnet_coef * (part["weight"] * reference.divergence(part)).sum()

        mean = Mean("loss_objective", "loss_critic", "loss_entropy", "clip_fraction", "kl_approx")
        data = normalised(data)  # w(s) = N(s) / N, and A / (N std(A))
        for _ in range(config.epochs):
            for part in minibatches(data, config.minibatches):
                mean.add(self.step(part, None if reference is None else penalty))
        return mean.values()
