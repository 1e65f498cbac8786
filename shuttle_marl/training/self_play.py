"""Variants of self-play (:class:`~shuttle_marl.training.config.PPOConfig`).

A learner that plays only itself is exploitable in states that its own play rarely reaches. Three variants change a fraction of
its rallies:

- **best-response**: against the exact best response to the current policy, solved every ``update_interval`` iterations;
- **restarts**: from states that this best response reaches;
- **pool**: against earlier policies of the run, one of which joins every ``update_interval`` iterations.

Three change the loss of PPO, by the KL divergence from a reference policy:

- **magnet**: mirror descent with a slowly moving reference (Sokota et al. 2023, arXiv 2206.05825): the network whose parameters
  are the exponential moving average of those of the policy. The entropy bonus, which draws towards uniform play, stays;
- **emagnet**: the same without the entropy bonus (EMAgnet, Maidment et al. 2026, arXiv 2606.23995);
- **nash**: a copy of the policy every ``update_interval`` iterations (NashPG, arXiv 2510.18183).
"""

import copy
from typing import Final

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import nn
from torch.nn import functional

from shuttle_marl import exact
from shuttle_marl.base.arrays import F32
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.network import PolicyNetwork
from shuttle_marl.training.config import PPOConfig, TrainingConfig
from shuttle_marl.training.learner import Learner, with_prefix
from shuttle_marl.training.networks import ILLEGAL, Tensors, tabulated, weights_of

_HUNDRED: Final = 100
_RESTARTS: Final = 1 << 15
_TOLERANCE: Final = 1e-4  # error bound of the values of best responses


class SelfPlayOpponents:
    """Opponents and initial states of the variants best-response, restarts and pool; nothing changes in others."""

    def __init__(self, config: TrainingConfig, game: Game, learner: Learner) -> None:
        self._config = config if isinstance(config, PPOConfig) else PPOConfig()
        self._game, self._learner, self._sampler = game, learner, learner.collector.sampler
        self._pool: list[dict[str, F32]] = []
        self.set_seed(0)

    def set_seed(self, seed: int) -> None:
        """Reseed the generator; the next update then recomputes everything that follows from the weights."""
        self._seed, self._first = seed, True

    def update(self, iteration: int) -> None:
        """Update opponents and initial states before an iteration, counted from 0."""
        config, first, self._first = self._config, self._first, False
        due = iteration % config.update_interval == 0
        if config.variant == "pool" and due:
            weights = weights_of(self._learner.actor, config.temperature)
            self._join(iteration // config.update_interval % config.pool_size, weights)
        elif config.variant in ("best-response", "restarts") and (due or first):
            policy = tabulated(self._learner.actor, self._game, config.temperature)
            response = exact.best_response(policy, tolerance=_TOLERANCE).policy
            if config.variant == "best-response":
                self._sampler.replace_opponent(0, response)
                self._assign(1)
            else:
                visits = exact.visits(policy, response, tolerance=_TOLERANCE).states[0]
                rng = np.random.default_rng((self._seed, iteration))
                self._sampler.restart(rng.choice(len(visits), _RESTARTS, p=visits / visits.sum()), config.fraction)

    def _join(self, slot: int, weights: dict[str, F32]) -> None:
        self._pool[slot : slot + 1] = [weights]
        self._sampler.replace_opponent(slot, PolicyNetwork.of_tensors(weights, self._game).table(self._game))
        self._assign(len(self._pool))

    def _assign(self, opponents: int) -> None:
        rallies = round(self._config.fraction * _HUNDRED)
        count = np.floor(np.arange(1, opponents * _HUNDRED + 1) * rallies / _HUNDRED).astype(np.int64)
        chosen = np.diff(count, prepend=0) > 0
        self._sampler.assign(np.where(chosen, (count - 1) % opponents, -1))

    def state_dict(self) -> Tensors:
        """State for a checkpoint that does not follow from the weights of the learner: the pool."""
        pool = enumerate(self._pool)
        return {f"pool.{slot}.{name}": torch.from_numpy(part) for slot, weights in pool for name, part in weights.items()}

    def load_state_dict(self, tensors: Tensors) -> None:
        """Restore the output of :meth:`state_dict`."""
        pool = with_prefix("pool", tensors)
        self._pool = []
        for slot in range(len({name.partition(".")[0] for name in pool})):
            self._join(slot, {name: part.numpy() for name, part in with_prefix(str(slot), pool).items()})


def n_opponents(config: TrainingConfig) -> int:
    """Maximum number of opponents of a variant of self-play."""
    return {"best-response": 1, "pool": config.pool_size}.get(config.variant, 0) if isinstance(config, PPOConfig) else 0


class ReferencePolicy:
    """Reference policy of the variants magnet, emagnet and nash; ``network``: logits of the learner."""

    def __init__(self, config: PPOConfig, network: nn.Module) -> None:
        self._config, self._current = config, network
        self.network = copy.deepcopy(network).requires_grad_(False)

    def update(self, iteration: int) -> None:
        """Average the parameters (magnet, emagnet), or copy the policy every ``update_interval`` iterations (nash)."""
        config = self._config
        step = float(iteration % config.update_interval == 0) if config.variant == "nash" else config.magnet_rate
        with torch.no_grad():
            for reference, current in zip(self.network.parameters(), self._current.parameters(), strict=True):
                reference.lerp_(current, step)

    def penalty(self, data: TensorDictBase) -> torch.Tensor:
        """Term of the loss: the weighted mean of the divergence over states."""
        return self._config.magnet_coef * (data["weight"] * self.divergence(data)).sum()

    def divergence(self, data: TensorDictBase) -> torch.Tensor:
        """``[U]`` KL divergence of the policy from the reference in the states of ``data``, in nats."""
        observation, mask = data["observation"], data["action_mask"]
        log_pi = functional.log_softmax(torch.where(mask, self._current(observation), ILLEGAL), dim=-1)
        with torch.no_grad():
            log_ref = functional.log_softmax(torch.where(mask, self.network(observation), ILLEGAL), dim=-1)
        return (log_pi.exp() * (log_pi - log_ref)).sum(-1)
