"""Points of rallies, the restricted Nash objective, and the frontier between beating an opponent and being beaten.

A point is one rally in a hundred. What is played is worth the rallies that it wins against an opponent who is restricted to a
policy with probability :data:`WEIGHT` at each choice, and else makes the choice that is worst for it (Johanson et al., NeurIPS
2007). The **gain** is that worth above the one of perfect play. The restricted response has the largest gain of any kind of play,
see :func:`shuttle_marl.exact.optimal.restricted_value`.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from shuttle_marl.exact import restricted_response
from shuttle_marl.exact.odds import best_odds, pair_odds, restricted_odds
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.suite.task import Arena

POINTS: Final = 100.0
"""Points of certainty."""
WEIGHT: Final = 0.75
"""Restriction of the opponent in the objective."""
STEPS: Final = (0.0, 0.25, 0.5, WEIGHT, 0.9, 1.0)
"""Restrictions of the points of a frontier."""
_DIGITS: Final = 5
"""Decimal places of a frontier, which are exact; + 0.0 makes 0.0 of -0.0."""


def exploitabilities(policies: Sequence[TabulatedPolicy], *, tolerance: float) -> list[float]:
    """Points above half of the rallies that the best response to each policy wins, at least 0."""
    return [POINTS * max(0.0, odds.rally - 0.5) for odds in best_odds(policies, tolerance=tolerance)]


def gains(
    arena: Arena,
    played: Sequence[tuple[TabulatedPolicy, TabulatedPolicy]],
    *,
    rallies: Sequence[int] | None = None,
    tolerance: float,
) -> tuple[float, float]:
    """The gain of what was played, and the largest possible one, in points; 0 is perfect play.

    Args:
        arena: has perfect play.
        played: a policy and its opponent, one pair after the other.
        rallies: for how many rallies each pair played; None: equally many.
        tolerance: largest acceptable error bound of a value.
    """
    opponents = [opponent for _, opponent in played]
    perfect = [arena.policy("minimax")] * len(played)
    worth, zero, most = (
        POINTS * float(np.average([odds.rally for odds in restricted_odds(pairs, WEIGHT, tolerance=tolerance)], weights=rallies))
        for pairs in (played, [*zip(perfect, opponents, strict=True)], [(None, each) for each in opponents])
    )
    return worth - zero, most - zero


def frontier(arena: Arena, opponent: TabulatedPolicy, *, tolerance: float) -> list[dict[str, float]]:
    """The restricted response to an opponent for each of :data:`STEPS`, in points of rallies.

    Returns:
        ``p``; ``score``: rallies won against the opponent, above those that perfect play wins; ``exploitability``, see
        :func:`exploitabilities`; and ``gain``, see :func:`gains`.
    """
    players = [restricted_response(opponent, p, tolerance=tolerance).policy for p in STEPS]
    perfect, *won = (odds.rally for odds in pair_odds([(each, opponent) for each in (arena.policy("minimax"), *players)]))
    risks = exploitabilities(players, tolerance=tolerance)
    return [
        {
            "p": p,
            "score": round(POINTS * (rally - perfect), _DIGITS) + 0.0,
            "exploitability": round(risk, _DIGITS) + 0.0,
            "gain": round(gains(arena, [(player, opponent)], tolerance=tolerance)[0], _DIGITS) + 0.0,
        }
        for p, player, rally, risk in zip(STEPS, players, won, risks, strict=True)
    ]
