"""Policies made of others: mixtures, sharpened and deterministic ones."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from shuttle_marl.base.arrays import Floats
from shuttle_marl.exact.profile import positions_of
from shuttle_marl.game.policy import TabulatedPolicy, TemperedPolicy, cumulative_positions, from_pair_probabilities, tabulate
from shuttle_marl.game.recovery import N_POSITIONS


def mixture(policies: Sequence[TabulatedPolicy], probabilities: Sequence[float] | Floats) -> TabulatedPolicy:
    """The mean of policies of a game in every state, in strokes and positions.

    It draws one of them for every choice and not once a rally, so it is a policy of the game, and exact figures are its own.

    Args:
        probabilities: ``[K]`` probabilities of the policies.
    """
    mixed = [(policy, float(p)) for policy, p in zip(policies, probabilities, strict=True) if p > 0]
    if len(mixed) == 1:
        return mixed[0][0]
    game = mixed[0][0].game
    blocks = (sum(p * policy.block_probabilities(block) for policy, p in mixed) for block in range(game.n_blocks))
    mean = from_pair_probabilities(game, np.concatenate(list(blocks)))
    if all(policy.waits is None for policy, _ in mixed):
        return mean
    positions = np.sum([p * positions_of(policy) for policy, p in mixed], axis=0)
    return dataclasses.replace(mean, waits=cumulative_positions(positions))


def sharpened(policy: TabulatedPolicy, temperature: float) -> TabulatedPolicy:
    """The policy with stroke probabilities p^(1 / temperature), normalised.

    The entropy bonus lets a learner play strokes that are nearly optimal; a temperature below 1 makes them rare.
    """
    return tabulate(TemperedPolicy(policy, temperature), policy.game)


def deterministic(policy: TabulatedPolicy) -> TabulatedPolicy:
    """The policy that always makes the likeliest choice of another one, of strokes and of positions."""
    pure = sharpened(policy, 0.0)
    if policy.game.recovery is None:
        return pure
    likeliest = np.eye(N_POSITIONS)[positions_of(policy).argmax(axis=1)]
    return dataclasses.replace(pure, waits=cumulative_positions(likeliest))
