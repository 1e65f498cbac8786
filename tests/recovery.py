"""Small games with recovery, and players who wait in places of their own."""

import dataclasses
import functools

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.policy import States, UniformPolicy
from shuttle_marl.game.recovery import Recovery
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game
from tests.reduced import reduced_game


@functools.cache
def small_recovery_game() -> Game:
    """The game with recovery with a third of its strokes; its positions are the shipped ones."""
    return dataclasses.replace(reduced_game(), recovery=load_game("default:recovery").recovery)


def with_recovery(game: Game, seed: int, positions: int = 2) -> Game:
    """A game in which receivers choose between few positions, drawn at random, as is what they change."""
    shipped, rng = load_game("default:recovery").recovery, np.random.default_rng([seed, 5])
    weight = rng.uniform(0.2, 1, shipped.people.shape)
    weight[np.argsort(np.argsort(rng.random(weight.shape))) >= positions] = 0
    total = np.cumsum(weight / weight.sum(axis=-1, keepdims=True), axis=-1)
    people = np.diff(np.rint(CHOICE_ONE * total).astype(np.int64), axis=-1, prepend=0).astype(np.uint16)
    effect = rng.integers(-2000, 2000, shipped.effect.shape).astype(np.int16)
    return dataclasses.replace(game, recovery=Recovery(people=people, effect=effect))


@dataclasses.dataclass(frozen=True)
class Prefers(UniformPolicy):
    """Strikes at random, and waits at each feasible position in proportion to fixed weights."""

    weights: tuple[float, ...]

    def positions(self, states: States) -> F64:
        p = (states.game.people_positions(states.state) > 0) * np.array(self.weights)
        return np.asarray(p / p.sum(axis=1, keepdims=True))
