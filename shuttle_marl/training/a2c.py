"""Advantage actor-critic: Mnih et al. 2016, arXiv 1602.01783, the synchronous form, with one gradient step per iteration.

The advantages A_t = delta_t + gamma lambda A_{t+1} are generalised (Schulman et al. 2016, arXiv 1506.02438); the collector
computes them (:mod:`shuttle_marl.training.learner`):

    loss = -E[log pi(a|s) A] + c_1 E[(V(s) - V_target(s))^2] - c_2 E[H(pi(.|s))].
"""

from tensordict import TensorDictBase
from torchrl.objectives import A2CLoss

from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import A2CConfig
from shuttle_marl.training.learner import ActorCritic, Mean, normalised


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
