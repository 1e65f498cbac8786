"""Proximal policy optimisation: Schulman, Wolski, Dhariwal, Radford & Klimov 2017, arXiv 1707.06347.

The clipped surrogate of eq. 7, with the advantages of Schulman et al. 2016 (arXiv 1506.02438). In self-play the next state
belongs to the opponent, whose value is minus ours: gamma = -1 makes the same recursion that of a zero-sum game.
"""

import dataclasses
from typing import TYPE_CHECKING, Annotated, ClassVar

from shuttle_marl.game.rally import Game
from shuttle_marl.training.config import Count, Fraction, Positive, TrainingConfig, Weight, Within

if TYPE_CHECKING:
    from shuttle_marl.training.learner import Learner


@dataclasses.dataclass(frozen=True, kw_only=True)
class PPOConfig(TrainingConfig):
    """Proximal policy optimisation (Schulman et al. 2017) with generalised advantages (Schulman et al. 2016)."""

    algorithm: ClassVar[str] = "ppo"

    strokes: Count = 40_000_000
    """Strokes of the learner to train on."""
    growth: Annotated[float, Within(low=0, high=1000, text="a number from 0 to 1,000")] = 0.05
    """Strokes by which each iteration is longer than the one before, as a share of the first."""
    age: Count = 8
    """Iterations for which what the network says of a state that is met now and then is played without asking again."""
    evaluate_every: Count = 20
    """Iterations between two exact evaluations."""
    checkpoint_every: Count = 40
    """Iterations between two checkpoints; all draws are named again at each, so it is part of what decides a run."""
    learning_rate: Positive = 3e-3
    """Learning rate of Adam; falls linearly to a fiftieth."""
    clip: Fraction = 0.2
    """The ratio of probabilities is clipped to 1 - clip and 1 + clip."""
    entropy: Weight = 0.01
    """Weight of the entropy bonus; falls linearly to 0."""
    critic: Positive = 1.0
    """Weight of the value loss."""
    epochs: Count = 1
    """Passes over what was collected."""
    minibatches: Count = 4
    """Gradient steps in a pass; each takes its share of the states, with all that was played there."""
    gradient_norm: Positive = 0.5
    """Gradients are scaled down to this norm."""


def make_ppo(config: PPOConfig, game: Game) -> "Learner":
    """Networks, loss and update of PPO."""
    import torch
    from tensordict import TensorDictBase
    from torchrl.objectives import ClipPPOLoss

    from shuttle_marl.training.collecting import minibatches
    from shuttle_marl.training.learner import Learner, Mean, set_rate, weighted_sums
    from shuttle_marl.training.networks import logit_network, make_actor, make_critic

    actor = make_actor(game, width=config.width, hidden=config.hidden, distinct=True).to(config.device)
    critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)
    loss = ClipPPOLoss(
        actor,
        critic,
        clip_epsilon=config.clip,
        entropy_coeff=config.entropy,
        critic_coeff=config.critic,
        loss_critic_type="l2",  # whose gradient at equal states depends on the mean of the returns alone
        normalize_advantage=False,
        reduction="none",
    )
    network, value = logit_network(actor), critic.module
    optimizer = torch.optim.Adam(loss.parameters(), lr=config.learning_rate, fused=True)

    def learn(data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Pass over the strokes, some of the states at a time."""
        set_rate(optimizer, config.learning_rate, remaining)
        loss.entropy_coeff.fill_(config.entropy * remaining)
        logged = Mean("loss_objective", "loss_critic", "loss_entropy", "clip_fraction", "kl_approx")
        for _ in range(config.epochs):
            for part in minibatches(data, config.minibatches):
                terms = weighted_sums(loss(part), part["weight"])
                total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
                optimizer.zero_grad()
                total.backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), config.gradient_norm)
                optimizer.step()
                logged.add(terms)
        return logged.values()

    return Learner(
        actor=actor,
        assess=lambda observation: (network(observation), value(observation).squeeze(-1)),
        distinct=True,
        learn=learn,
        modules={"loss": loss},
        optimizers={"optimizer": optimizer},
    )
