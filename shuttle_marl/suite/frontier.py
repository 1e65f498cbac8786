"""The restricted Nash objective, and the frontier between beating an opponent and being beaten (Johanson et al., NeurIPS 2007).

What is played is worth the rallies that it wins against an opponent who is restricted to a policy with probability ``p`` at each
stroke, and else plays the stroke that is worst for it. The restricted response to the policy is the best play of any kind, see
:func:`shuttle_marl.exact.optimal.restricted_value`.
"""

from collections.abc import Sequence
from typing import Final, TypedDict

import numpy as np

from shuttle_marl.exact import restricted_response
from shuttle_marl.exact.known import best_odds, pair_odds, restricted_odds
from shuttle_marl.exact.match import normalised_score
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.task import Arena

WEIGHT: Final = 0.75
"""Restriction of the opponent in the objective."""
STEPS: Final = (0.0, 0.25, 0.5, WEIGHT, 0.9, 1.0)
"""Restrictions of the points of a frontier."""
_DIGITS: Final = 7
"""Decimal places of a frontier, which are exact; + 0.0 makes 0.0 of -0.0."""


class Point(TypedDict):
    """A point of a frontier: the restricted response for ``p``; its figures are those of ``exploit``."""

    p: float
    score: float
    exploitability: float
    objective: float


def normalised(worth: float, zero: float, one: float) -> float:
    """A figure on the scale from ``zero`` to ``one``.

    Raises:
        SuiteError: these are equal.
    """
    score = normalised_score(worth, zero, one)
    if score is None:
        raise SuiteError("the opponent has no weakness, so there is nothing to score")
    return score


def objective(
    arena: Arena,
    played: Sequence[tuple[TabulatedPolicy, TabulatedPolicy]],
    *,
    rallies: Sequence[int] | None = None,
    tolerance: float,
) -> float:
    """The objective: 0 for perfect play, which makes use of no weakness, and 1 for the restricted response.

    Args:
        arena: has perfect play.
        played: a policy and its opponent, one pair after the other.
        rallies: for how many rallies each pair played; None: equally many.
        tolerance: largest acceptable error bound of a value.

    Raises:
        SuiteError: perfect play is the restricted response.
    """
    opponents = [opponent for _, opponent in played]
    perfect = [arena.policy("minimax")] * len(played)
    worth, zero, one = (
        float(np.average([odds.rally for odds in restricted_odds(pairs, WEIGHT, tolerance=tolerance)], weights=rallies))
        for pairs in (played, [*zip(perfect, opponents, strict=True)], [(None, each) for each in opponents])
    )
    return normalised(worth, zero, one)


def score(arena: Arena, won: float, opponent: TabulatedPolicy, *, tolerance: float) -> float:
    """Rallies won against an opponent: 0 for bc, and 1 for the best response.

    Raises:
        SuiteError: bc is a best response.
    """
    (zero,) = pair_odds([(arena.policy("bc"), opponent)], tolerance=tolerance)
    return normalised(won, zero.rally, best_odds([opponent], tolerance=tolerance)[0].rally)


def frontier(arena: Arena, opponent: TabulatedPolicy, *, tolerance: float) -> list[Point]:
    """The points of an opponent for :data:`STEPS`."""
    players = [restricted_response(opponent, p, tolerance=tolerance).policy for p in STEPS]
    won = pair_odds([(player, opponent) for player in players], tolerance=tolerance)
    enemies = best_odds(players, tolerance=tolerance)
    return [
        {
            "p": p,
            "score": round(score(arena, odds.rally, opponent, tolerance=tolerance), _DIGITS),
            "exploitability": round(enemy.value, _DIGITS) + 0.0,
            "objective": round(objective(arena, [(player, opponent)], tolerance=tolerance), _DIGITS) + 0.0,
        }
        for p, player, odds, enemy in zip(STEPS, players, won, enemies, strict=True)
    ]
