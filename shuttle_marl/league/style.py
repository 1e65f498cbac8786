"""Styles of policies: similarity to human play and shot mix, computed exactly from their tables."""

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from shuttle_marl.base.cluster import in_threads
from shuttle_marl.game.policy import PolicyError, TabulatedPolicy, tabulate
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve

PEOPLE: Final = "bc"
"""Behaviour clone of the average player."""
AXES: Final[dict[str, tuple[str, ...]]] = {
    "smash": ("smash", "half-smash"),
    "drop": ("drop",),
    "clear": ("clear",),
    "lift": ("lift",),
    "block": ("block",),
    "net shot": ("net-shot", "cross-court-net-shot"),
    "net kill": ("net-kill",),
    "drive, push": ("drive", "push"),
}
"""Shot types of each axis; serves belong to none."""
_TOLERANCE: Final = 1e-7
_DECIMALS: Final = 6


@dataclasses.dataclass(frozen=True, kw_only=True)
class Style:
    """Style of a policy.

    Attributes:
        likeness: overlap with ``bc``: sum of the smaller of the two probabilities of every stroke, averaged over the states of
            ``bc`` in self-play; 1 for ``bc``.
        rally_length: expected number of strokes of a rally against ``bc``.
        shots: fraction of each of :data:`AXES` among the strokes after the serve, against ``bc``.
    """

    likeness: float
    rally_length: float
    shots: dict[str, float]


def styles(game: Game, tables: Mapping[str, TabulatedPolicy]) -> dict[str, Style]:
    """Styles of policies by name; empty if the game has no ``bc``."""
    from shuttle_marl.exact import moved, visits  # noqa: PLC0415  numba
    from shuttle_marl.exact.profile import induced  # noqa: PLC0415  numba

    try:
        people = tabulate(resolve(PEOPLE, game), game)
    except PolicyError:
        return {}
    usual = people.pair_probabilities()
    theirs = people if game.opposite is game else moved(people, game.opposite)
    chain = induced(theirs)
    met = visits(people, theirs, tolerance=_TOLERANCE).states
    weight = game.of_pairs((met[0] + met[1]) / (met[0] + met[1]).sum())

    def style(policy: TabulatedPolicy) -> Style:
        seen = visits(policy, theirs, tolerance=_TOLERANCE, chains=(induced(policy), chain))
        mix = dict(zip(SHOTS, seen.shot_mix(0).tolist(), strict=True))
        rallying = sum(mix[shot] for shots in AXES.values() for shot in shots)
        return Style(
            likeness=round(float((weight * np.minimum(usual, policy.pair_probabilities())).sum()), _DECIMALS),
            rally_length=round(seen.rally_length, _DECIMALS),
            shots={
                axis: round(sum(mix[shot] for shot in shots) / rallying, _DECIMALS) if rallying else 0.0
                for axis, shots in AXES.items()
            },
        )

    return dict(zip(tables, in_threads(style, tables.values()), strict=True))
