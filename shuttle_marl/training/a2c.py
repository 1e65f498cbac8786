"""Advantage actor-critic: Mnih et al. 2016, arXiv 1602.01783, the synchronous form.

One gradient step an iteration: log pi(a|s) times the advantage, a value loss, an entropy bonus. In self-play the next state
belongs to the opponent, whose value is minus ours: gamma = -1 makes the same recursion that of a zero-sum game.
"""

import dataclasses
from typing import TYPE_CHECKING, ClassVar

from shuttle_marl.game.rally import Game
from shuttle_marl.training.config import Count, FractionOrZero, Positive, TrainingConfig, Weight

if TYPE_CHECKING:
    from shuttle_marl.training.learner import Learner


@dataclasses.dataclass(frozen=True, kw_only=True)
class A2CConfig(TrainingConfig):
    """Advantage actor-critic (Mnih et al. 2016), synchronous, with generalised advantages."""

    algorithm: ClassVar[str] = "a2c"

    strokes: Count = 6_000_000
    """Strokes of the learner to train on."""
    rows: Count = 2048
    """Rallies that are played side by side."""
    steps: Count = 4
    """Strokes of each row that are collected before the learner learns."""
    evaluate_every: Count = 50
    """Iterations between two exact evaluations."""
    checkpoint_every: Count = 100
    """Iterations between two checkpoints; all draws are named again at each, so it is part of what decides a run."""
    learning_rate: Positive = 2e-3
    """Learning rate of Adam; falls linearly to a fiftieth."""
    lmbda: FractionOrZero = 0.7
    """Lambda of the generalised advantages."""
    entropy: Weight = 0.03
    """Weight of the entropy bonus; falls linearly to 0."""
    critic: Positive = 1.0
    """Weight of the value loss."""
    gradient_norm: Positive = 0.5
    """Gradients are scaled down to this norm."""


def make_a2c(config: A2CConfig, game: Game) -> "Learner":
    """Networks, loss and update of A2C."""
    import torch
    from tensordict import TensorDictBase
    from torchrl.objectives import A2CLoss, ValueEstimators

    from shuttle_marl.training.learner import Learner, Mean, set_rate
    from shuttle_marl.training.networks import make_actor, make_critic

    actor = make_actor(game, width=config.width, hidden=config.hidden).to(config.device)
    critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)
    loss = A2CLoss(actor, critic, entropy_coeff=config.entropy, critic_coeff=config.critic)
    loss.entropy_bonus = True  # with a weight of 0 it would leave the entropy out
    # A vectorised estimator fails on a negative gamma.
    loss.make_value_estimator(ValueEstimators.GAE, gamma=config.discount, lmbda=config.lmbda, vectorized=False)
    optimizer = torch.optim.Adam(loss.parameters(), lr=config.learning_rate)

    def learn(data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Compute the advantages, then take one gradient step."""
        set_rate(optimizer, config.learning_rate, remaining)
        loss.entropy_coeff.fill_(config.entropy * remaining)
        with torch.no_grad():
            loss.value_estimator(data)
        strokes = data.reshape(-1)
        advantage = strokes["advantage"]
        strokes["advantage"] = (advantage - advantage.mean()) / advantage.std().clamp_min(1e-6)
        terms = loss(strokes)
        total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        optimizer.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(loss.parameters(), config.gradient_norm)
        optimizer.step()
        logged = Mean("loss_objective", "loss_critic", "entropy")
        logged.add(terms)
        return logged.values()

    return Learner(actor=actor, learn=learn, modules={"loss": loss}, optimizers={"optimizer": optimizer})
