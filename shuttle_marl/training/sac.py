"""Soft actor-critic: Haarnoja et al. 2018, arXiv 1801.01290, for discrete actions: Christodoulou 2019, arXiv 1910.07207.

Two critics Q(s, a), the smaller one counts; the temperature alpha keeps the entropy of pi near a target. "Entropy of the
policy" is over the legal strokes, so the target is a share of their mean entropy: ln n of all strokes could never be
reached. In self-play the next state belongs to the opponent, whose value is minus ours: gamma = -1.
"""

import logging

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.objectives import DiscreteSACLoss, SoftUpdate, ValueEstimators

from shuttle_marl.game.rally import Game
from shuttle_marl.training.config import SACConfig
from shuttle_marl.training.learner import (
    Tensors,
    checked,
    module_state,
    optimizer_state,
    restore_module,
    restore_optimizer,
    set_rate,
)
from shuttle_marl.training.networks import make_actor, make_quality

logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports that a buffer was made
_LEAST_SHARE = 0.02
"""Share of the entropy that is left at the end."""
_STORED = ("observation", "action", "following", "reward", "terminated")


class SAC:
    """See :class:`shuttle_marl.training.learner.Learner`."""

    def __init__(self, config: SACConfig, game: Game) -> None:
        self.config = config
        self.actor = make_actor(game, width=config.width, hidden=config.hidden, log_prob=False).to(config.device)
        self.loss = DiscreteSACLoss(
            self.actor,
            make_quality(game, width=config.width, hidden=config.hidden).to(config.device),
            action_space="categorical",
            num_actions=game.n_strokes,
            alpha_init=config.temperature,
            target_entropy=config.entropy_share,
            loss_function="l2",
            delay_qvalue=True,
        )
        self.loss.make_value_estimator(ValueEstimators.TD0, gamma=-1.0 if config.self_play else 1.0)
        self.targets = SoftUpdate(self.loss, eps=config.polyak)
        networks = [weight for name, weight in self.loss.named_parameters() if name != "log_alpha"]
        self.optimizer = torch.optim.Adam(networks, lr=config.learning_rate)
        self.temperature = torch.optim.Adam([self.loss.log_alpha], lr=config.temperature_rate)
        self.buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(config.buffer), batch_size=config.minibatch)
        # Masks are read off the incoming stroke and the contact when they are needed; stored, they would be nine tenths.
        self.masks = torch.from_numpy(game.reply_mask).to(config.device)
        counts = game.legal_count(np.arange(game.n_states))
        self.mean_entropy = float(np.log(counts[counts > 0]).mean())
        self.collected = 0

    def learn(self, data: TensorDictBase, left: float) -> dict[str, float]:
        """One iteration: store what was collected, then a few gradient steps on strokes of the buffer."""
        config = self.config
        strokes = data.reshape(-1)
        self.buffer.extend(
            TensorDict(
                {
                    "observation": strokes["observation"],
                    "action": strokes["action"],
                    "following": strokes["next", "observation"],
                    "reward": strokes["next", "reward"],
                    "terminated": strokes["next", "terminated"],
                },
                batch_size=strokes.batch_size,
            )
        )
        self.collected += len(strokes)
        if self.collected < config.warm_up:
            return {}
        set_rate(self.optimizer, config.learning_rate, left)
        share = _LEAST_SHARE + (config.entropy_share - _LEAST_SHARE) * left
        self.loss.target_entropy.fill_(share * self.mean_entropy)
        totals: dict[str, float] = {}
        for _ in range(config.updates):
            terms = self.loss(self.sample())
            total = terms["loss_actor"] + terms["loss_qvalue"] + terms["loss_alpha"]
            self.optimizer.zero_grad()
            self.temperature.zero_grad()
            total.backward()
            self.optimizer.step()
            self.temperature.step()
            self.targets.step()
            for name in ("loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy"):
                totals[name] = totals.get(name, 0.0) + terms[name].mean().item() / config.updates
        return checked(totals)

    def sample(self) -> TensorDict:
        """A minibatch of the buffer, with masks."""
        drawn = self.buffer.sample().to(self.config.device)
        return TensorDict(
            {
                "observation": drawn["observation"],
                "action_mask": self.mask(drawn["observation"]),
                "action": drawn["action"],
                "next": {
                    "observation": drawn["following"],
                    "action_mask": self.mask(drawn["following"]),
                    "reward": drawn["reward"],
                    "done": drawn["terminated"],
                    "terminated": drawn["terminated"],
                },
            },
            batch_size=drawn.batch_size,
        )

    def mask(self, observation: torch.Tensor) -> torch.Tensor:
        """``[..., n]`` legal strokes of ``[..., 3]`` observations."""
        return self.masks[observation[..., 1].long(), observation[..., 2].long()]

    def state(self) -> Tensors:
        """Networks, temperature, moments of the gradient, and the buffer."""
        stored = self.buffer[:] if len(self.buffer) else {}
        return {
            **module_state("loss", self.loss),
            **optimizer_state("optimizer", self.optimizer),
            **optimizer_state("temperature", self.temperature),
            **{f"buffer.{name}": stored[name].contiguous() for name in (_STORED if len(self.buffer) else ())},
            "cursor": torch.tensor(self.buffer.writer.state_dict()["_cursor"]),
            "collected": torch.tensor(self.collected),
        }

    def restore(self, tensors: Tensors) -> None:
        """Take over what :meth:`state` gave."""
        restore_module("loss", self.loss, tensors)
        restore_optimizer("optimizer", self.optimizer, tensors)
        restore_optimizer("temperature", self.temperature, tensors)
        self.collected = int(tensors["collected"])
        entries = {name.removeprefix("buffer."): value for name, value in tensors.items() if name.startswith("buffer.")}
        self.buffer.empty()
        if entries:
            self.buffer.extend(TensorDict(entries, batch_size=[len(entries["action"])]))
            # Where the next stroke goes decides which ones are drawn later.
            self.buffer.writer.load_state_dict({**self.buffer.writer.state_dict(), "_cursor": int(tensors["cursor"])})
