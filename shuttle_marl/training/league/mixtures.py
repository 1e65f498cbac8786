"""Policies made from others: a mixture as one policy, and a policy made sharper.

A player of a mixture draws one of its policies at the start of a rally. In a state of the rally each policy is then as likely as
it was at the start, times how often it comes to this state. So the policy that plays every stroke with the mean of their
probabilities, weighted in this way, brings about the same rallies against an opponent. Against another opponent it would be
another policy, because a state does not say all that happened before; exact figures are those of the one that is made here.
"""

from collections.abc import Sequence

import numpy as np

from shuttle_marl import exact
from shuttle_marl.arrays import Floats
from shuttle_marl.game.policy import TemperedPolicy
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities, tabulate
from shuttle_marl.training.league.population import TOLERANCE

_LEAST: float = 1e-12
"""Weight at the start that each policy keeps everywhere, so that states that none comes to have a mean too."""


def merged(policies: Sequence[TabulatedPolicy], shares: Floats, opponent: TabulatedPolicy | None = None) -> TabulatedPolicy:
    """The policy that plays like a mixture of policies against an opponent.

    Args:
        policies: K of one game.
        shares: ``[K]`` probabilities; those without any are left out.
        opponent: for whose rallies the two are alike; None: the same mixture without weights by visits.
    """
    kept = [(policy, float(share)) for policy, share in zip(policies, shares, strict=True) if share > 0]
    if len(kept) == 1:
        return kept[0][0]
    opponent = opponent or _mean(kept, [np.full(policy.game.n_states, share) for policy, share in kept])
    weights = [share * (exact.visits(policy, opponent, tolerance=TOLERANCE).states[0] + _LEAST) for policy, share in kept]
    return _mean(kept, weights)


def sharpened(policy: TabulatedPolicy, temperature: float) -> TabulatedPolicy:
    """The policy that plays every stroke with its probability to the power of 1 / temperature, scaled to add up to 1.

    A bonus for entropy lets a learner play all that is nearly as good as the best; below 1, a temperature takes that away.

    Args:
        policy: a policy.
        temperature: above 0.
    """
    return tabulate(TemperedPolicy(policy, temperature), policy.game, "a sharper policy")


def _mean(kept: Sequence[tuple[TabulatedPolicy, float]], weights: Sequence[Floats]) -> TabulatedPolicy:
    """The mean of policies, weighted in every state."""
    game = kept[0][0].game
    total = np.sum(weights, axis=0)
    out = np.zeros(game.n_pairs)
    for (policy, _), weight in zip(kept, weights, strict=True):
        share = weight / np.maximum(total, 1e-300)
        for block in range(game.n_blocks):
            part = share[game.block_states(block)][game.base_pair_state]
            out[game.block_pairs(block)] += part * policy.block_probabilities(block)
    return from_pair_probabilities(game, out)
