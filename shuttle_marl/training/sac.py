"""Soft actor-critic: Haarnoja et al. 2018, arXiv 1801.01290, for discrete actions: Christodoulou 2019, arXiv 1910.07207.

Two critics Q(s, a), the smaller one counts; the temperature alpha keeps the entropy of pi near a target. "Entropy of the
policy" is over the legal strokes, so the target is a share of their mean entropy: ln n of all strokes could never be
reached. In self-play the next state belongs to the opponent, whose value is minus ours: gamma = -1.
"""

import dataclasses
import logging
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from shuttle_marl.game.rally import Game
from shuttle_marl.training.config import Count, CountOrZero, Fraction, FractionOrZero, Positive, TrainingConfig

if TYPE_CHECKING:
    from shuttle_marl.training.learner import Learner, Tensors

_LEAST_SHARE: Final = 0.02
"""Share of the entropy that is left at the end."""
_STORED: Final = ("state", "action", "following", "reward")
"""Entries of the replay buffer: 4 + 8 + 4 + 4 bytes a stroke."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SACConfig(TrainingConfig):
    """Soft actor-critic (Haarnoja et al. 2018) for discrete actions (Christodoulou 2019)."""

    algorithm: ClassVar[str] = "sac"

    strokes: Count = 1_500_000
    """Strokes of the learner to train on."""
    batch: Count = 4096
    """Strokes of the learner in the first iteration; its rallies are played to their end."""
    age: Count = 8
    """Iterations for which what the network says of a state that is met now and then is played without asking again."""
    evaluate_every: Count = 100
    """Iterations between two exact evaluations."""
    checkpoint_every: Count = 200
    """Iterations between two checkpoints; all draws are named again at each, so it is part of what decides a run."""
    learning_rate: Positive = 1e-3
    """Learning rate of Adam, for actor and critics; falls linearly to a fiftieth."""
    temperature_rate: Positive = 1e-3
    """Learning rate of Adam, for the temperature alpha."""
    temperature: Fraction = 0.05
    """Temperature alpha at the start."""
    entropy_share: Fraction = 0.3
    """Target entropy, as a share of the mean entropy of choosing equally among the legal strokes; falls linearly to 0.02."""
    buffer: Count = 400_000
    """Strokes that the replay buffer holds."""
    minibatch: Count = 1024
    """Strokes in one gradient step."""
    updates: Count = 2
    """Gradient steps an iteration."""
    warm_up: CountOrZero = 20_000
    """Strokes that are collected before the first gradient step."""
    polyak: FractionOrZero = 0.99
    """Share of the old weights that a target network keeps at each step."""

    def memory(self, n_strokes: int) -> dict[str, int]:
        """Bytes that a run needs at least, by the flags that decide how many; see :class:`TrainingConfig`."""
        return {**super().memory(n_strokes), "--buffer": 20 * self.buffer, "--minibatch": 6 * n_strokes * self.minibatch}


def make_sac(config: SACConfig, game: Game) -> "Learner":
    """Networks, losses, replay buffer and update of SAC."""
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
    from torchrl.objectives import DiscreteSACLoss, SoftUpdate, ValueEstimators

    from shuttle_marl.training.learner import Learner, Mean, set_rate
    from shuttle_marl.training.networks import logit_network, make_actor, make_q_network

    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports that a buffer was made
    actor = make_actor(game, width=config.width, hidden=config.hidden, log_prob=False).to(config.device)
    loss = DiscreteSACLoss(
        actor,
        make_q_network(game, width=config.width, hidden=config.hidden).to(config.device),
        action_space="categorical",
        num_actions=game.n_strokes,
        alpha_init=config.temperature,
        target_entropy=config.entropy_share,
        loss_function="l2",
        delay_qvalue=True,
    )
    loss.make_value_estimator(ValueEstimators.TD0, gamma=config.discount)
    targets = SoftUpdate(loss, eps=config.polyak)
    networks = [weight for name, weight in loss.named_parameters() if name != "log_alpha"]
    optimizer = torch.optim.Adam(networks, lr=config.learning_rate)
    temperature = torch.optim.Adam([loss.log_alpha], lr=config.temperature_rate)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(config.buffer), batch_size=config.minibatch)
    counts = game.legal_count(np.arange(game.n_states))
    mean_entropy = float(np.log(counts[counts > 0]).mean())
    # Masks are read off the incoming stroke and the contact when they are needed; stored, they would be nine tenths.
    masks = torch.tensor(game.reply_mask).to(config.device)
    observations = torch.from_numpy(game.observation(np.arange(game.n_states))).to(config.device)
    network = logit_network(actor)
    collected = 0

    def learn(data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Store what was collected, then take a few gradient steps on strokes of the buffer."""
        nonlocal collected
        store(data)
        collected += data.numel()
        if collected < config.warm_up:
            return {}
        set_rate(optimizer, config.learning_rate, remaining)
        share = _LEAST_SHARE + (config.entropy_share - _LEAST_SHARE) * remaining
        loss.target_entropy.fill_(share * mean_entropy)
        logged = Mean("loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy")
        for _ in range(config.updates):
            terms = loss(sample())
            total = terms["loss_actor"] + terms["loss_qvalue"] + terms["loss_alpha"]
            optimizer.zero_grad()
            temperature.zero_grad()
            total.backward()
            optimizer.step()
            temperature.step()
            targets.step()
            logged.add(terms)
        return logged.values()

    def store(strokes: TensorDictBase) -> None:
        buffer.extend(strokes.select(*_STORED))

    def sample() -> TensorDict:
        """Draw a minibatch of the buffer, with observations and masks."""
        drawn = buffer.sample()
        over = drawn["following"] < 0
        ended = over.unsqueeze(-1).to(config.device)
        following = {
            **seen(drawn["following"].clamp_min(0)),
            "reward": drawn["reward"].unsqueeze(-1).to(config.device),
            "done": ended,
            "terminated": ended,
        }
        return TensorDict(
            {**seen(drawn["state"]), "action": drawn["action"].to(config.device), "next": following}, batch_size=drawn.batch_size
        )

    def seen(states: torch.Tensor) -> dict[str, torch.Tensor]:
        """``[..., 6]`` observations of states, and ``[..., n]`` their legal strokes."""
        observation = observations[states.long().to(config.device)]
        return {"observation": observation, "action_mask": masks[observation[..., 1].long(), observation[..., 2].long()]}

    def remembered() -> "Tensors":
        """The buffer as tensors."""
        stored = buffer[:] if len(buffer) else {}
        return {
            **{f"buffer.{name}": stored[name].contiguous() for name in (_STORED if len(buffer) else ())},
            "cursor": torch.tensor(buffer.writer.state_dict()["_cursor"]),
            "collected": torch.tensor(collected),
        }

    def remember(tensors: "Tensors") -> None:
        """Take over what :func:`remembered` gave."""
        nonlocal collected
        collected = int(tensors["collected"])
        entries = {name.removeprefix("buffer."): value for name, value in tensors.items() if name.startswith("buffer.")}
        buffer.empty()
        if entries:
            buffer.extend(TensorDict(entries, batch_size=[len(entries["action"])]))
            # Where the next stroke goes decides which ones are drawn later.
            buffer.writer.load_state_dict({**buffer.writer.state_dict(), "_cursor": int(tensors["cursor"])})

    return Learner(
        actor=actor,
        assess=lambda observation: (network(observation), torch.zeros(len(observation))),
        distinct=False,
        learn=learn,
        modules={"loss": loss},
        optimizers={"optimizer": optimizer, "temperature": temperature},
        remembered=remembered,
        remember=remember,
    )
