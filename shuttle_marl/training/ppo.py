"""Proximal policy optimisation: Schulman, Wolski, Dhariwal, Radford & Klimov 2017, arXiv 1707.06347.

The clipped surrogate of eq. 7, with the advantages of Schulman et al. 2016 (arXiv 1506.02438). In self-play the next state
belongs to the opponent, whose value is minus ours: gamma = -1 makes the same recursion that of a zero-sum game.
"""

import torch
from tensordict import TensorDictBase
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from shuttle_marl.game.rally import Game
from shuttle_marl.training.config import PPOConfig
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


class PPO:
    """See :class:`shuttle_marl.training.learner.Learner`."""

    def __init__(self, config: PPOConfig, game: Game) -> None:
        self.config = config
        self.actor = make_actor(game, width=config.width, hidden=config.hidden).to(config.device)
        self.critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)
        self.loss = ClipPPOLoss(
            self.actor,
            self.critic,
            clip_epsilon=config.clip,
            entropy_coeff=config.entropy,
            critic_coeff=config.critic,
            normalize_advantage=True,
        )
        # A vectorised estimator fails on a negative gamma.
        gamma = -1.0 if config.self_play else 1.0
        self.loss.make_value_estimator(ValueEstimators.GAE, gamma=gamma, lmbda=config.lmbda, vectorized=False)
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=config.learning_rate)

    def learn(self, data: TensorDictBase, left: float) -> dict[str, float]:
        """One iteration: advantages, then several passes over them in random order."""
        config = self.config
        set_rate(self.optimizer, config.learning_rate, left)
        self.loss.entropy_coeff.fill_(config.entropy * left)
        with torch.no_grad():
            self.loss.value_estimator(data)
        strokes = data.reshape(-1)
        totals: dict[str, float] = {}
        count = 0
        for _ in range(config.epochs):
            order = torch.randperm(len(strokes), device=strokes.device)
            for chosen in torch.split(order, config.minibatch):
                terms = self.loss(strokes[chosen])
                total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
                self.optimizer.zero_grad()
                total.backward()
                torch.nn.utils.clip_grad_norm_(self.loss.parameters(), config.gradient_norm)
                self.optimizer.step()
                count += 1
                logged = ("loss_objective", "loss_critic", "entropy", "clip_fraction", "kl_approx")
                for name, value in checked({name: terms[name].item() for name in logged}).items():
                    totals[name] = totals.get(name, 0.0) + value
        return {name: total / count for name, total in totals.items()}

    def state(self) -> Tensors:
        """Networks and moments of the gradient."""
        return {**module_state("loss", self.loss), **optimizer_state("optimizer", self.optimizer)}

    def restore(self, tensors: Tensors) -> None:
        """Take over what :meth:`state` gave."""
        restore_module("loss", self.loss, tensors)
        restore_optimizer("optimizer", self.optimizer, tensors)
