"""What a policy plays: shot mix, length of rallies, strokes that people hardly play there, and strokes that nobody can play."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import Bools
from shuttle_marl.exact.occupancy import visits
from shuttle_marl.exact.profile import StatePolicy
from shuttle_marl.game.court import BACK, FOREHAND, N_SIDES, third_of
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.stroke import AROUND_THE_HEAD, FRONT_COURT, N_SHOTS, SHOTS

RARE: Final = 0.01
"""A shot type that the average player plays less often in a state is rare there."""
OFTEN: Final = 0.02
"""Share of a player's strokes above which a shot type counts."""


def impossible(game: Layout) -> Bools:
    """``[base pairs]`` strokes of the front court met in the back third, and around the head on the striker's forehand side."""
    catalogue, incoming = game.catalogue, game.incoming(game.base_pair_state)
    back, forehand = (
        np.append(part, False)[incoming] for part in (third_of(catalogue.area) == BACK, catalogue.area % N_SIDES == FOREHAND)
    )
    front, around = np.isin(np.array(SHOTS)[catalogue.shot], FRONT_COURT), catalogue.technique == AROUND_THE_HEAD
    return np.asarray(back & front[game.base_pair_stroke] | forehand & around[game.base_pair_stroke])


def unusual(bc: StatePolicy) -> list[Bools]:
    """For each block ``[base pairs]`` whether the average player plays the shot type in the state in less than 1 % of cases."""
    game = bc.game
    key = game.base_pair_state * np.int64(N_SHOTS) + game.catalogue.shot[game.base_pair_stroke]
    size = game.n_base_states * N_SHOTS
    return [np.bincount(key, bc.block_probabilities(block), size)[key] < RARE for block in range(game.n_blocks)]


def play(policy: StatePolicy, opponent: StatePolicy, rare: Sequence[Bools]) -> dict[str, Any]:
    """The play of a policy against another.

    Args:
        rare: rare strokes, see :func:`unusual`.

    Returns:
        ``shots``: fraction of its strokes by shot type; ``types``: number of shot types above 2 %; ``bits``: entropy of the shot
        mix; ``length``: strokes of a rally; ``rare``: fraction of its strokes that are rare among people.
    """
    game, seen = policy.game, visits(policy, opponent)
    mix = seen.shot_mix(0)
    some = mix[mix > 0]
    uncommon = total = 0.0
    for block, which in enumerate(rare):
        played = policy.block_probabilities(block) * seen.states[0][game.block_states(block)][game.base_pair_state]
        uncommon += float(played[which].sum())
        total += float(played.sum())
    return {
        "shots": dict(zip(SHOTS, mix.tolist(), strict=True)),
        "types": int((mix > OFTEN).sum()),
        "bits": float(-(some * np.log2(some)).sum()),
        "length": seen.rally_length,
        "rare": uncommon / total,
    }
