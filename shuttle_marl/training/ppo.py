"""Proximal policy optimisation: Schulman, Wolski, Dhariwal, Radford & Klimov 2017, arXiv 1707.06347.

The clipped surrogate of eq. 7, with the advantages of Schulman et al. 2016 (arXiv 1506.02438). In self-play the next state
belongs to the opponent, whose value is minus ours: gamma = -1 makes the same recursion that of a zero-sum game.
"""

import dataclasses
from typing import TYPE_CHECKING, ClassVar

from shuttle_marl.game.rally import Game
from shuttle_marl.training.config import Count, Fraction, FractionOrZero, Positive, TrainingConfig, Weight

if TYPE_CHECKING:
    from shuttle_marl.training.learner import Learner


@dataclasses.dataclass(frozen=True, kw_only=True)
class PPOConfig(TrainingConfig):
    """Proximal policy optimisation (Schulman et al. 2017) with generalised advantages (Schulman et al. 2016)."""

    algorithm: ClassVar[str] = "ppo"

    strokes: Count = 4_000_000
    """Strokes of the learner to train on."""
    rows: Count = 2048
    """Rallies that are played side by side."""
    evaluate_every: Count = 5
    """Iterations between two exact evaluations."""
    checkpoint_every: Count = 10
    """Iterations between two checkpoints; all draws are named again at each, so it is part of what decides a run."""
    learning_rate: Positive = 2e-3
    """Learning rate of Adam; falls linearly to a fiftieth."""
    clip: Fraction = 0.2
    """The ratio of probabilities is clipped to 1 - clip and 1 + clip."""
    lmbda: FractionOrZero = 0.7
    """Lambda of the generalised advantages."""
    entropy: Weight = 0.01
    """Weight of the entropy bonus; falls linearly to 0."""
    critic: Positive = 1.0
    """Weight of the value loss."""
    epochs: Count = 1
    """Passes over what was collected."""
    minibatch: Count = 4096
    """Strokes in one gradient step."""
    gradient_norm: Positive = 0.5
    """Gradients are scaled down to this norm."""


def make_ppo(config: PPOConfig, game: Game) -> "Learner":
    """Networks, loss and update of PPO."""
    import torch
    from tensordict import TensorDictBase
    from torchrl.objectives import ClipPPOLoss, ValueEstimators

    from shuttle_marl.training.learner import Learner, Mean, set_rate
    from shuttle_marl.training.networks import make_actor, make_critic

    actor = make_actor(game, width=config.width, hidden=config.hidden).to(config.device)
    critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)
    loss = ClipPPOLoss(
        actor,
        critic,
        clip_epsilon=config.clip,
        entropy_coeff=config.entropy,
        critic_coeff=config.critic,
        normalize_advantage=True,
    )
    # A vectorised estimator fails on a negative gamma.
    loss.make_value_estimator(ValueEstimators.GAE, gamma=config.discount, lmbda=config.lmbda, vectorized=False)
    optimizer = torch.optim.Adam(loss.parameters(), lr=config.learning_rate)

    def learn(data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Compute the advantages, then pass over them several times in random order."""
        set_rate(optimizer, config.learning_rate, remaining)
        loss.entropy_coeff.fill_(config.entropy * remaining)
        with torch.no_grad():
            loss.value_estimator(data)
        strokes = data.reshape(-1)
        logged = Mean("loss_objective", "loss_critic", "entropy", "clip_fraction", "kl_approx")
        for _ in range(config.epochs):
            order = torch.randperm(len(strokes), device=strokes.device)
            for chosen in torch.split(order, config.minibatch):
                terms = loss(strokes[chosen])
                total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
                optimizer.zero_grad()
                total.backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), config.gradient_norm)
                optimizer.step()
                logged.add(terms)
        return logged.values()

    return Learner(actor=actor, learn=learn, modules={"loss": loss}, optimizers={"optimizer": optimizer})
