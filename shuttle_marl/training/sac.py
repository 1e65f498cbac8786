"""Soft actor-critic: Haarnoja et al. 2018, arXiv 1801.01290, for discrete actions: Christodoulou 2019, arXiv 1910.07207.

    V(s') = E[min_i Q_i'(s', a) - alpha log pi(a|s')],    y = r + gamma V(s'),    a ~ pi(.|s'),
    loss_Q = E[(Q_i(s, a) - y)^2],    loss_pi = E[sum_a pi(a|s) (alpha log pi(a|s) - min_i Q_i(s, a))],

with target networks Q', and the temperature alpha keeping the entropy of pi near a target. The entropy is over legal strokes, so
the target is a fraction of their mean entropy: ln n of all strokes is out of reach. In self-play the next state belongs to the
opponent, whose value is minus ours: gamma = -1.
"""

import copy
import logging
from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import DiscreteSACLoss, SoftUpdate, ValueEstimators

from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import SACConfig
from shuttle_marl.training.learner import IDLE, Callback, Learner, Mean, set_learning_rate, with_prefix
from shuttle_marl.training.networks import Tensors, logit_network, make_actor, make_q_network

_FINAL_ENTROPY: Final = 0.02  # target entropy at the end of the run, as a fraction of the mean entropy of uniform play
_TRANSITION: Final = ("state", "pair", "following", "reward")


class SAC(Learner):
    """Networks, losses, replay buffer and update of SAC."""

    distinct = False
    config: SACConfig

    def __init__(self, config: SACConfig, game: Game, opponents: Sequence[TabulatedPolicy] = ()) -> None:
        super().__init__(config, game, opponents)
        logging.getLogger("torchrl").setLevel(logging.WARNING)  # it logs the creation of the buffer
        self.actor = make_actor(game, width=config.width, hidden=config.hidden, log_prob=False).to(config.device)
        self.averaged = copy.deepcopy(self.actor).requires_grad_(False)
        self.loss = DiscreteSACLoss(
            self.actor,
            make_q_network(game, width=config.width, hidden=config.hidden).to(config.device),
            action_space="categorical",
            num_actions=game.n_actions,
            alpha_init=config.alpha,
            target_entropy=config.target_entropy,
            loss_function="l2",
            delay_qvalue=True,
            reduction="none",
            num_qvalue_nets=config.critics,
            scalar_output_mode="exclude",
            skip_done_states=True,
        )
        self.loss.make_value_estimator(ValueEstimators.TD0, gamma=config.discount)
        self.target_update = SoftUpdate(self.loss, eps=config.polyak)
        weights = [weight for name, weight in self.loss.named_parameters() if name != "log_alpha"]
        self.optimizer = torch.optim.Adam(weights, lr=config.learning_rate, fused=True)
        self.alpha_optimizer = torch.optim.Adam([self.loss.log_alpha], lr=config.alpha_learning_rate)
        self.modules = {"loss": self.loss, "averaged": self.averaged}
        self.optimizers = {"optimizer": self.optimizer, "temperature": self.alpha_optimizer}
        storage = LazyTensorStorage(config.buffer, compilable=True)  # without the semaphores of one for several processes
        self.buffer = TensorDictReplayBuffer(storage=storage, batch_size=config.minibatch, compilable=True)
        self.buffer.set_rng(self.collector.generator)
        self.collected = 0
        self.observer = self.collector.observer
        counts = np.r_[game.legal_count(np.arange(game.n_states)), game.waiting.choices * game.hides]
        self.uniform_entropy = float(np.log(counts[counts > 0]).mean())

    @property
    def eval_actor(self) -> ProbabilisticActor:
        """The moving average of the policy."""
        return self.averaged

    def predict(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits, and zeros as values, which SAC does not use."""
        return logit_network(self.actor)(observation), torch.zeros(len(observation), dtype=torch.float32)

    def iterate(self, remaining: float, run: Callback = IDLE) -> None:
        """Collect rallies, store their transitions and take ``updates`` gradient steps, see :meth:`Learner.iterate`."""
        config = self.config
        run.begin(self)
        data = self.collect()
        run.collected(self)
        self.buffer.extend(data)
        self.collected += data.numel()
        mean = Mean("loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy")
        if self.collected >= config.warm_up:
            set_learning_rate(self.optimizer, config.learning_rate, remaining)
            fraction = _FINAL_ENTROPY + (config.target_entropy - _FINAL_ENTROPY) * remaining
            self.loss.target_entropy.fill_(fraction * self.uniform_entropy)
            for _ in range(config.updates):
                mean.add(self.step(self.buffer.sample()))
        run.learned(self, mean.values())

    def step(self, drawn: TensorDictBase) -> TensorDictBase:
        """Take a gradient step on a minibatch; returns the terms of the loss."""
        terms = self.terms(drawn)
        loss = terms["loss_actor"] + terms["loss_qvalue"] + terms["loss_alpha"]
        self.optimizer.zero_grad()
        self.alpha_optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.alpha_optimizer.step()
        self.target_update.step()
        with torch.no_grad():
            for average, weight in zip(self.averaged.parameters(), self.actor.parameters(), strict=True):
                average.lerp_(weight, 1 - self.config.averaging)
        return terms

    def terms(self, drawn: TensorDictBase) -> TensorDictBase:
        """Terms of the loss, computed once for each distinct state, stroke and next state.

        The losses of the critics are squares, so for equal pairs (s, a) their gradient depends on the mean of the targets alone;
        the losses of actor and temperature depend on the state.

        Args:
            drawn: ``[N]`` transitions.
        """
        loss, observer = self.loss, self.observer
        # y = r + gamma V(s'), as the mean over the transitions of each pair (s, a).
        following, which_next = torch.unique(drawn["following"], return_inverse=True)
        value = torch.zeros(len(following), dtype=torch.float32)
        value[following >= 0] = self.config.discount * self.soft_values(following[following >= 0]).cpu()
        pairs, which, count = torch.unique(drawn["pair"], return_inverse=True, return_counts=True)
        target = torch.zeros(len(pairs), dtype=torch.float32).index_add_(0, which, drawn["reward"] + value[which_next]) / count
        # Distinct states s, and the state of each pair.
        first = torch.empty(len(pairs), dtype=torch.long).scatter_(0, which, torch.arange(len(which)))
        states, row = torch.unique_consecutive(drawn["state"][first], return_inverse=True)
        inputs, row, strokes = observer.inputs(states), row.to(observer.device), observer.strokes(pairs)
        # w(s, a) = N(s, a) / N and w(s) = N(s) / N
        weight = count.to(observer.device).float() * (1 / len(drawn))
        visits = torch.zeros(len(states), dtype=torch.float32, device=observer.device).index_add_(0, row, weight)
        # The loss takes the target as the reward of a transition that ends the rally, so that it adds no value to it.
        ended = torch.ones(len(pairs), 1, dtype=torch.bool, device=observer.device)
        unused = {name: part[:1].expand(len(pairs), *part.shape[1:]) for name, part in inputs.items()}
        ends = {**unused, "reward": target[:, None].to(observer.device), "done": ended, "terminated": ended}
        played = {"row": row, "played": strokes, "action": torch.zeros_like(strokes)}
        loss_qvalue, _ = loss.qvalue_loss(TensorDict({**inputs, **played, "next": TensorDict(ends, [len(pairs)])}, []))
        loss_actor, about = loss.actor_loss(TensorDict(inputs, [len(states)]))
        log_prob = about["log_prob"]
        terms = {
            "loss_qvalue": (loss_qvalue * weight).sum(),
            "loss_actor": (loss_actor * visits).sum(),
            "loss_alpha": (loss.alpha_loss(log_prob) * visits).sum(),
            "alpha": loss.log_alpha.detach().exp(),
            "entropy": -(log_prob * visits).sum(),
        }
        return TensorDict(terms, [])

    @torch.no_grad()
    def soft_values(self, states: torch.Tensor) -> torch.Tensor:
        """``[U]`` V(s) = sum_a pi(a|s) (min_i Q_i'(s, a) - alpha log pi(a|s)) of ``[U]`` states, by the target networks Q'."""
        inputs, critic = TensorDict(self.observer.inputs(states), [len(states)]), self.loss.qvalue_network
        values = []
        for weights in self.loss.target_qvalue_network_params.unbind(0):
            with weights.to_module(critic):
                values.append(critic(inputs.copy())["action_value"])
        log_pi = self.actor.get_dist(inputs).logits
        return (log_pi.exp() * (torch.stack(values).amin(0) - self.loss.log_alpha.exp() * log_pi)).sum(-1)

    def state_dict(self) -> Tensors:
        """State for a checkpoint, with the replay buffer."""
        stored = self.buffer[:] if len(self.buffer) else {}
        return {
            **super().state_dict(),
            **{f"buffer.{name}": stored[name].contiguous() for name in (_TRANSITION if len(self.buffer) else ())},
            "cursor": torch.tensor(self.buffer.writer.state_dict()["_cursor"]),
            "collected": torch.tensor(self.collected),
        }

    def load_state_dict(self, tensors: Tensors) -> None:
        """Restore the output of :meth:`state_dict`."""
        super().load_state_dict(tensors)
        self.collected = int(tensors["collected"])
        entries = with_prefix("buffer", tensors)
        self.buffer.empty()
        if entries:
            self.buffer.extend(TensorDict(entries, batch_size=[len(entries["pair"])]))
            # The position of the next transition determines which ones are drawn later.
            self.buffer.writer.load_state_dict({**self.buffer.writer.state_dict(), "_cursor": int(tensors["cursor"])})
