"""Ways to be met by more than oneself in self-play.

What a learner that plays itself leaves exploitable are states that its own play rarely comes to. So a share of the rallies may be
played against a best response to it, begin where a best response takes it, or be played against what it was before:

- **best-response**: against the best response to the present policy, solved exactly now and then;
- **restarts**: from states that this best response brings about;
- **pool**: against earlier policies of the run, kept now and then.

Two more change the loss and not the rallies (:mod:`shuttle_marl.training.ppo`): **magnet**, mirror descent with a reference that
follows slowly (Sokota et al. 2023, arXiv 2206.05825), and **nash**, with a reference that is the present policy now and then
(NashPG, arXiv 2510.18183).
"""

from typing import Final

import numpy as np
import torch

from shuttle_marl import exact
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel import RallySampler
from shuttle_marl.policy.network import PolicyNetwork
from shuttle_marl.training.learner import Learner, Tensors
from shuttle_marl.training.networks import tabulated, weights_of
from shuttle_marl.training.ppo import PPOConfig

_HUNDRED: Final = 100
"""Of so many rallies one after another the share is met exactly."""
_DRAWN: Final = 1 << 15
_TOLERANCE: Final = 1e-4


class SelfPlay:
    """Keeps the rallies of a learner in self-play as its configuration wants them.

    Args:
        config: which way, how much, and how often.
        game: the tables.
        learner: whose policy is met.
        sampler: plays; it has :func:`slots` opponents.
    """

    def __init__(self, config: PPOConfig, game: Game, learner: Learner, sampler: RallySampler) -> None:
        self._config, self._game, self._learner, self._sampler = config, game, learner, sampler
        self._pool: list[Tensors] = []

    def prepare(self, iteration: int, *, first: bool, seed: int) -> None:
        """Make what is to be met, before an iteration.

        Args:
            iteration: number of the iteration, counted from 0.
            first: whether a checkpoint lies before it: then everything that follows from the weights is made.
            seed: of the draws.
        """
        way, now = self._config.way, iteration % self._config.renew == 0
        if way == "pool" and now:
            weights = {
                name: torch.from_numpy(part)
                for name, part in weights_of(self._learner.actor, self._config.play_temperature).items()
            }
            self._keep(iteration // self._config.renew % self._config.pool, weights)
        elif way in ("best-response", "restarts") and (now or first):
            policy = tabulated(self._learner.actor, self._game, self._config.play_temperature)
            answer = exact.best_response(policy, tolerance=_TOLERANCE).policy
            if way == "best-response":
                self._sampler.replace_opponent(0, answer)
                self._assign(1)
                return
            visits = exact.visits(policy, answer, tolerance=_TOLERANCE).states[0]
            rng = np.random.default_rng((seed, iteration))
            drawn = rng.choice(len(visits), _DRAWN, p=visits / visits.sum())
            self._sampler.restart(drawn, self._config.share)

    def _keep(self, slot: int, weights: Tensors) -> None:
        self._pool[slot : slot + 1] = [weights]
        self._sampler.replace_opponent(slot, _table(weights, self._game))
        self._assign(len(self._pool))

    def _assign(self, opponents: int) -> None:
        """Meet these opponents in turn, in the share of the rallies that the configuration says."""
        met = round(self._config.share * _HUNDRED)
        # Spread evenly, so that the share is the same from every rally on.
        turn = np.floor(np.arange(1, opponents * _HUNDRED + 1) * met / _HUNDRED).astype(np.int64)
        chosen = np.diff(turn, prepend=0) > 0
        self._sampler.assign(np.where(chosen, (turn - 1) % opponents, -1))

    def state(self) -> Tensors:
        """State that a resumed run needs and that does not follow from its weights."""
        return {f"pool.{slot}.{name}": part for slot, weights in enumerate(self._pool) for name, part in weights.items()}

    def restore(self, tensors: Tensors) -> None:
        """Take over what :meth:`state` gave."""
        kept: dict[int, Tensors] = {}
        for name, part in tensors.items():
            if name.startswith("pool."):
                _, slot, rest = name.split(".", 2)
                kept.setdefault(int(slot), {})[rest] = part
        self._pool = []
        for number in sorted(kept):
            self._keep(number, kept[number])


def slots(config: PPOConfig) -> int:
    """Number of opponents that a way of self-play has room for."""
    return {"best-response": 1, "pool": config.pool}.get(config.way, 0)


def _table(weights: Tensors, game: Game) -> TabulatedPolicy:
    return PolicyNetwork.of_tensors({name: part.numpy() for name, part in weights.items()}, game).table(game)
