"""Advantage actor-critic: Mnih et al. 2016, arXiv 1602.01783, the synchronous form.

One gradient step an iteration: log pi(a|s) times the advantage, a value loss, an entropy bonus. In self-play the next state
belongs to the opponent, whose value is minus ours: gamma = -1 makes the same recursion that of a zero-sum game.
"""

import dataclasses
from typing import TYPE_CHECKING, Annotated, ClassVar

from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import Count, Positive, TrainingConfig, Weight, Within

if TYPE_CHECKING:
    from shuttle_marl.training.learner import Learner


@dataclasses.dataclass(frozen=True, kw_only=True)
class A2CConfig(TrainingConfig):
    """Advantage actor-critic (Mnih et al. 2016), synchronous, with generalised advantages."""

    algorithm: ClassVar[str] = "a2c"

    strokes: Count = 40_000_000
    """Strokes of the learner to train on."""
    batch: Count = 8192
    """Strokes of the learner in the first iteration; its rallies are played to their end."""
    growth: Annotated[float, Within(low=0, high=1000, text="a number from 0 to 1,000")] = 0.03
    """Strokes by which each iteration is longer than the one before, as a share of the first."""
    age: Count = 8
    """Iterations for which what the network says of a state that is met now and then is played without asking again."""
    evaluate_every: Count = 50
    """Iterations between two exact evaluations."""
    checkpoint_every: Count = 100
    """Iterations between two checkpoints; all draws are named again at each, so it is part of what decides a run."""
    learning_rate: Positive = 8e-3
    """Learning rate of Adam; falls linearly to a fiftieth."""
    entropy: Weight = 0.05
    """Weight of the entropy bonus; falls linearly to 0."""
    critic: Positive = 1.0
    """Weight of the value loss."""
    gradient_norm: Positive = 0.5
    """Gradients are scaled down to this norm."""


def make_a2c(config: A2CConfig, game: Game) -> "Learner":
    """Networks, loss and update of A2C."""
    import torch
    from tensordict import TensorDictBase
    from torchrl.objectives import A2CLoss

    from shuttle_marl.training.learner import Learner, Mean, set_rate, weighted_sums
    from shuttle_marl.training.networks import logit_network, make_actor, make_critic

    actor = make_actor(game, width=config.width, hidden=config.hidden, distinct=True).to(config.device)
    critic = make_critic(game, width=config.width, hidden=config.hidden).to(config.device)
    # The gradient of l2 at equal states depends on the mean of the returns alone.
    loss = A2CLoss(
        actor, critic, entropy_coeff=config.entropy, critic_coeff=config.critic, loss_critic_type="l2", reduction="none"
    )
    loss.entropy_bonus = True  # with a weight of 0 it would leave the entropy out
    network, value = logit_network(actor), critic.module
    optimizer = torch.optim.Adam(loss.parameters(), lr=config.learning_rate, fused=True)

    def learn(data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Take one gradient step."""
        set_rate(optimizer, config.learning_rate, remaining)
        loss.entropy_coeff.fill_(config.entropy * remaining)
        terms = weighted_sums(loss(data), data["weight"])
        total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
        optimizer.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(loss.parameters(), config.gradient_norm)
        optimizer.step()
        logged = Mean("loss_objective", "loss_critic", "loss_entropy")
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
