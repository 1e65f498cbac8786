"""Small games with recovery, and players who wait in places of their own."""

import dataclasses
import functools

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.game.policy import States, UniformPolicy
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tables import Game
from tests.reduced import reduced_game


@functools.cache
def small_recovery_game() -> Game:
    """The game with recovery with a third of its strokes; its positions are the shipped ones."""
    return dataclasses.replace(reduced_game(), recovery=load_game("default:recovery").recovery)


@dataclasses.dataclass(frozen=True)
class Prefers(UniformPolicy):
    """Strikes at random, and waits at each feasible position in proportion to fixed weights."""

    weights: tuple[float, ...]

    def positions(self, states: States) -> F64:
        p = (states.game.people_positions(states.state) > 0) * np.array(self.weights)
        return np.asarray(p / p.sum(axis=1, keepdims=True))
