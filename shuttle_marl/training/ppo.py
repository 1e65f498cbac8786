"""Proximal policy optimisation: Schulman, Wolski, Dhariwal, Radford & Klimov 2017, arXiv 1707.06347.

The clipped surrogate of eq. 7, with the advantages of Schulman et al. 2016 (arXiv 1506.02438). In self-play the next state
belongs to the opponent, whose value is minus ours: gamma = -1 makes the same recursion that of a zero-sum game.
"""

import copy
import dataclasses
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import Count, Fraction, FractionOrZero, Positive, TrainingConfig, TrainingError, Weight, Within

if TYPE_CHECKING:
    from shuttle_marl.training.learner import Learner

Way = Literal["plain", "best-response", "restarts", "pool", "magnet", "nash"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PPOConfig(TrainingConfig):
    """Proximal policy optimisation (Schulman et al. 2017) with generalised advantages (Schulman et al. 2016)."""

    algorithm: ClassVar[str] = "ppo"

    strokes: Count = 60_000_000
    """Strokes of the learner to train on."""
    batch: Count = 8192
    """Strokes of the learner in the first iteration; its rallies are played to their end."""
    growth: Annotated[float, Within(low=0, high=1000, text="a number from 0 to 1,000")] = 0.1
    """Strokes by which each iteration is longer than the one before, as a share of the first."""
    lmbda: FractionOrZero = 0.6
    """Lambda of the generalised advantages."""
    age: Count = 8
    """Iterations for which what the network says of a state that is met now and then is played without asking again."""
    evaluate_every: Count = 25
    """Iterations between two exact evaluations."""
    checkpoint_every: Count = 50
    """Iterations between two checkpoints; all draws are named again at each, so it is part of what decides a run."""
    learning_rate: Positive = 8e-3
    """Learning rate of Adam; falls linearly to a fiftieth."""
    clip: Fraction = 0.4
    """The ratio of probabilities is clipped to 1 - clip and 1 + clip."""
    entropy: Weight = 0.05
    """Weight of the entropy bonus; falls linearly to 0."""
    sharpen_after: Annotated[float | None, Within(low=0, high=1, text="a number from 0 to 1")] = None
    """Share of the run after which strokes are collected at a temperature below 1, so that states are valued more and more as
    they are played in the end; 1 for never. Default: 0.2 in self-play, else 1."""
    last_temperature: Fraction = 0.25
    """Temperature at which strokes are collected at the end of the run."""
    critic: Positive = 1.0
    """Weight of the value loss."""
    epochs: Count = 1
    """Passes over what was collected."""
    minibatches: Count = 3
    """Gradient steps in a pass; each takes its share of the states, with all that was played there."""
    gradient_norm: Positive = 0.5
    """Gradients are scaled down to this norm."""
    way: Way = "plain"
    """Way of self-play: plain, or with a share of rallies against best responses or earlier policies, of restarts in the states
    of a best response, or with a reference that follows slowly (magnet) or now and then (nash)."""
    share: FractionOrZero = 0.2
    """Share of the rallies of self-play that are not plain."""
    renew: Count = 40
    """Iterations after which the best response, the pool or the reference of self-play is made again."""
    pool: Annotated[int, Within(low=1, high=64, text="a whole number from 1 to 64")] = 8
    """Earlier policies that are kept to be met in self-play."""
    magnet: Weight = 0.05
    """Weight of the divergence from the reference in self-play."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sharpen_after is None:
            object.__setattr__(self, "sharpen_after", 0.2 if self.self_play else 1.0)
        if self.way != "plain" and not self.self_play:
            raise TrainingError(f"--way {self.way}: only in self-play, with --opponent self")


def make_ppo(config: PPOConfig, game: Game) -> "Learner":
    """Networks, loss and update of PPO."""
    import torch
    from tensordict import TensorDictBase
    from torchrl.objectives import ClipPPOLoss

    from shuttle_marl.training.collecting import minibatches
    from shuttle_marl.training.learner import Learner, Mean, set_rate, weighted_sums
    from shuttle_marl.training.networks import divergence, logit_network, make_actor, make_critic, set_temperature

    late = config.sharpen_after
    assert late is not None  # since the configuration was made
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

    reference = copy.deepcopy(network).requires_grad_(False) if config.way in ("magnet", "nash") else None

    def begin(remaining: float) -> None:
        """Collect and learn at the temperature that it is time for."""
        done = max(0.0, 1 - remaining - late) / (1 - late) if late < 1 else 0.0
        for each in (network, reference):
            if each is not None:
                set_temperature(each, config.last_temperature**done)

    def follow(iteration: int) -> None:
        """Let the reference follow: slowly, or all the way now and then."""
        assert reference is not None
        step = 1 / config.renew if config.way == "magnet" else float(iteration % config.renew == 0)
        with torch.no_grad():
            for mine, present in zip(reference.parameters(), network.parameters(), strict=True):
                mine.lerp_(present, step)

    def learn(data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Pass over the strokes, some of the states at a time."""
        set_rate(optimizer, config.learning_rate, remaining)
        loss.entropy_coeff.fill_(config.entropy * remaining)
        logged = Mean("loss_objective", "loss_critic", "loss_entropy", "clip_fraction", "kl_approx")
        if reference is not None:
            follow(round((1 - remaining) * config.iterations))
        for _ in range(config.epochs):
            for part in minibatches(data, config.minibatches):
                terms = weighted_sums(loss(part), part["weight"])
                total = terms["loss_objective"] + terms["loss_critic"] + terms["loss_entropy"]
                if reference is not None:
                    total = total + config.magnet * (part["weight"] * divergence(network, reference, part)).sum()
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
        begin=begin,
        learn=learn,
        modules={"loss": loss} if reference is None else {"loss": loss, "reference": reference},
        optimizers={"optimizer": optimizer},
    )
