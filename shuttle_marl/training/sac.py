"""Soft actor-critic: Haarnoja et al. 2018, arXiv 1801.01290, for discrete actions: Christodoulou 2019, arXiv 1910.07207.

A critic Q(s, a), or several of which the smallest counts; the temperature alpha keeps the entropy of pi near a target. "Entropy
of the policy" is over the legal strokes, so the target is a share of their mean entropy: ln n of all strokes could never be
reached. In self-play the next state belongs to the opponent, whose value is minus ours: gamma = -1.
"""

import copy
import dataclasses
import logging
from typing import TYPE_CHECKING, Annotated, ClassVar, Final

import numpy as np

from shuttle_marl.game.tables import Game
from shuttle_marl.training.config import Count, CountOrZero, Fraction, FractionOrZero, Positive, TrainingConfig, Within

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torchrl.objectives import DiscreteSACLoss

    from shuttle_marl.training.collecting import Observer
    from shuttle_marl.training.learner import Learner, Tensors

_LEAST_SHARE: Final = 0.02
"""Share of the entropy that is left at the end."""
_STORED: Final = ("state", "pair", "following", "reward")
"""Entries of the replay buffer, 4 bytes each."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SACConfig(TrainingConfig):
    """Soft actor-critic (Haarnoja et al. 2018) for discrete actions (Christodoulou 2019)."""

    algorithm: ClassVar[str] = "sac"

    strokes: Count = 8_000_000
    """Strokes of the learner to train on."""
    batch: Count = 16_384
    """Strokes of the learner in the first iteration; its rallies are played to their end."""
    age: Count = 8
    """Iterations for which what the network says of a state that is met now and then is played without asking again."""
    evaluate_every: Count = 40
    """Iterations between two exact evaluations."""
    checkpoint_every: Count = 80
    """Iterations between two checkpoints; all draws are named again at each, so it is part of what decides a run."""
    learning_rate: Positive = 6e-3
    """Learning rate of Adam, for actor and critics; falls linearly to a fiftieth."""
    temperature_rate: Positive = 1e-2
    """Learning rate of Adam, for the temperature alpha."""
    temperature: Fraction = 0.02
    """Temperature alpha at the start."""
    entropy_share: Fraction = 0.3
    """Target entropy, as a share of the mean entropy of choosing equally among the legal strokes; falls linearly to 0.02."""
    buffer: Count = 4_000_000
    """Strokes that the replay buffer holds."""
    minibatch: Count = 16_384
    """Strokes in one gradient step; those that are alike are learned from together."""
    updates: Count = 4
    """Gradient steps an iteration."""
    warm_up: CountOrZero = 20_000
    """Strokes that are collected before the first gradient step."""
    critics: Annotated[int, Within(low=1, high=8, text="a whole number from 1 to 8")] = 1
    """Networks of values, of which the smallest value counts."""
    polyak: FractionOrZero = 0.95
    """Share of the old weights that a target network keeps at each step."""
    averaging: FractionOrZero = 0.98
    """Share of the old weights that the agent that is evaluated and saved keeps at each step; 0 for the weights that learn."""

    def memory(self, n_strokes: int) -> dict[str, int]:
        """Bytes that a run needs at least, by the flags that decide how many; see :class:`TrainingConfig`."""
        return {**super().memory(n_strokes), "--buffer": 16 * self.buffer, "--minibatch": 6 * n_strokes * self.minibatch}


def sac_terms(loss: "DiscreteSACLoss", drawn: "TensorDictBase", look_up: "Observer") -> "TensorDictBase":
    """The terms of the loss over some strokes, computed once for each distinct state, stroke and next state.

    The losses of values are squares, so at equal pairs their gradient depends on the mean of the targets alone; those of the
    actor and of the temperature depend on the state.

    Args:
        loss: without reduction, and without a look at the next states of rows that are over.
        drawn: ``[N]`` strokes as the collector gives them one by one.
        look_up: of the game.
    """
    import torch
    from tensordict import TensorDict

    share = 1 / len(drawn)
    following, of = torch.unique(drawn["following"], return_inverse=True)
    value = torch.zeros(len(following))
    playing = following >= 0
    if bool(playing.any()):
        # The target of a stroke without a reward is what follows it, with the sign of the discount.
        none = torch.zeros(int(playing.sum()), 1, device=look_up.device)
        ahead = {**look_up.seen(following[playing]), "reward": none, "done": none.bool(), "terminated": none.bool()}
        value[playing] = loss._compute_target(TensorDict({"next": TensorDict(ahead, [len(none)])}, [len(none)])).cpu()
    pairs, which, count = torch.unique(drawn["pair"], return_inverse=True, return_counts=True)
    target = torch.zeros(len(pairs)).index_add_(0, which, drawn["reward"] + value[of]) / count
    first = torch.empty(len(pairs), dtype=torch.long).scatter_(0, which, torch.arange(len(which)))
    states, row = torch.unique_consecutive(drawn["state"][first], return_inverse=True)
    seen = look_up.seen(states)
    row, strokes = row.to(look_up.device), look_up.strokes(pairs)
    over = torch.ones(len(pairs), 1, dtype=torch.bool, device=look_up.device)
    ends = {"reward": target[:, None].to(look_up.device), "done": over, "terminated": over}
    nothing = {name: part[:1].expand(len(pairs), *part.shape[1:]) for name, part in seen.items()}
    played = {"row": row, "played": strokes, "action": torch.zeros_like(strokes)}
    weight = count.to(look_up.device) * share
    visits = torch.zeros(len(states), device=look_up.device).index_add_(0, row, weight)
    loss_qvalue, _ = loss.qvalue_loss(TensorDict({**seen, **played, "next": TensorDict({**nothing, **ends}, [len(pairs)])}, []))
    loss_actor, about = loss.actor_loss(TensorDict(seen, [len(states)]))
    log_prob = about["log_prob"]
    terms = {
        "loss_qvalue": (loss_qvalue * weight).sum(),
        "loss_actor": (loss_actor * visits).sum(),
        "loss_alpha": (loss.alpha_loss(log_prob) * visits).sum(),
        "alpha": loss.log_alpha.detach().exp(),
        "entropy": -(log_prob * visits).sum(),
    }
    return TensorDict(terms, [])


def make_sac(config: SACConfig, game: Game) -> "Learner":
    """Networks, losses, replay buffer and update of SAC."""
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
    from torchrl.objectives import DiscreteSACLoss, SoftUpdate, ValueEstimators

    from shuttle_marl.training.collecting import Observer
    from shuttle_marl.training.learner import Learner, Mean, set_rate
    from shuttle_marl.training.networks import logit_network, make_actor, make_q_network

    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports that a buffer was made
    actor = make_actor(game, width=config.width, hidden=config.hidden, log_prob=False).to(config.device)
    averaged = copy.deepcopy(actor).requires_grad_(False)
    loss = DiscreteSACLoss(
        actor,
        make_q_network(game, width=config.width, hidden=config.hidden).to(config.device),
        action_space="categorical",
        num_actions=game.n_strokes,
        alpha_init=config.temperature,
        target_entropy=config.entropy_share,
        loss_function="l2",
        delay_qvalue=True,
        reduction="none",
        num_qvalue_nets=config.critics,
        scalar_output_mode="exclude",
        skip_done_states=True,
    )
    loss.make_value_estimator(ValueEstimators.TD0, gamma=config.discount)
    targets = SoftUpdate(loss, eps=config.polyak)
    networks = [weight for name, weight in loss.named_parameters() if name != "log_alpha"]
    optimizer = torch.optim.Adam(networks, lr=config.learning_rate, fused=True)
    temperature = torch.optim.Adam([loss.log_alpha], lr=config.temperature_rate)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(config.buffer), batch_size=config.minibatch)
    counts = game.legal_count(np.arange(game.n_states))
    mean_entropy = float(np.log(counts[counts > 0]).mean())
    look_up = Observer(game, config.device)
    network = logit_network(actor)
    collected = 0

    def learn(data: TensorDictBase, remaining: float) -> dict[str, float]:
        """Store what was collected, then take a few gradient steps on strokes of the buffer."""
        nonlocal collected
        buffer.extend(data)
        collected += data.numel()
        if collected < config.warm_up:
            return {}
        set_rate(optimizer, config.learning_rate, remaining)
        share = _LEAST_SHARE + (config.entropy_share - _LEAST_SHARE) * remaining
        loss.target_entropy.fill_(share * mean_entropy)
        logged = Mean("loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy")
        for _ in range(config.updates):
            terms = sac_terms(loss, buffer.sample(), look_up)
            total = terms["loss_actor"] + terms["loss_qvalue"] + terms["loss_alpha"]
            optimizer.zero_grad()
            temperature.zero_grad()
            total.backward()
            optimizer.step()
            temperature.step()
            targets.step()
            with torch.no_grad():
                for mean, present in zip(averaged.parameters(), actor.parameters(), strict=True):
                    mean.lerp_(present, 1 - config.averaging)
            logged.add(terms)
        return logged.values()

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
            buffer.extend(TensorDict(entries, batch_size=[len(entries["pair"])]))
            # Where the next stroke goes decides which ones are drawn later.
            buffer.writer.load_state_dict({**buffer.writer.state_dict(), "_cursor": int(tensors["cursor"])})

    return Learner(
        actor=actor,
        assess=lambda observation: (network(observation), torch.zeros(len(observation))),
        distinct=False,
        learn=learn,
        shown=averaged,
        modules={"loss": loss, "averaged": averaged},
        optimizers={"optimizer": optimizer, "temperature": temperature},
        remembered=remembered,
        remember=remember,
    )
