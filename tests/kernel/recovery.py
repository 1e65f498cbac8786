"""The small game with recovery, and policies that wait somewhere in it."""

import dataclasses

import numpy as np

from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.policy import TabulatedPolicy, cumulative_positions, tabulate
from shuttle_marl.game.recovery import NO_CHOICE
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from tests.recovery import small_recovery_game
from tests.reduced import reduced_game, reduced_model

GAME = small_recovery_game()
RECOVERY = GAME.recovery
PAIR = dataclasses.replace(pair_game("viktor-axelsen", "kento-momota", game=reduced_model()), recovery=RECOVERY)


def people(name: str, game: Game = GAME) -> TabulatedPolicy:
    """A policy of the game without recovery, which waits as people do."""
    plain = dataclasses.replace(game, recovery=NO_CHOICE)
    policy = resolve(name, reduced_game()) if game is GAME else resolve(name, plain)
    return dataclasses.replace(tabulate(policy, plain), game=game)


def with_positions(policy: TabulatedPolicy, seed: int) -> TabulatedPolicy:
    """The same strokes with random positions."""
    game = policy.game
    mask = game.seats[0].waiting.mask(game.base(np.arange(game.n_states)))
    p = mask * np.random.default_rng(seed).random(mask.shape) ** 3
    return dataclasses.replace(policy, waits=cumulative_positions(p / p.sum(axis=1, keepdims=True)))


_PEOPLE = [people(name) for name in ("bc", "random", "attacking@greedy")]
TABLES = [_PEOPLE[0], *(with_positions(table, seed) for seed, table in enumerate(_PEOPLE[1:]))]
"""People's positions, then two policies with random ones."""
