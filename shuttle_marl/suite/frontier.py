"""The restricted Nash objective, and the frontier between beating an opponent and being beaten (Johanson et al., NeurIPS 2007).

What is played is worth ``p`` times the rallies that it wins against an opponent, and ``1 - p`` times those that it wins against
its own worst enemy. The responses of the frontier are those to an opponent who is restricted at each stroke. The restricted
response for ``p`` is the best of them, so neither rallies won against the opponent nor exploitability ever fall with ``p``.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple, TypedDict

from shuttle_marl.exact.known import best_odds, pair_odds, restricted_odds
from shuttle_marl.exact.match import normalised_score
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.suite.options import SuiteError

WEIGHT: Final = 0.75
"""Weight of the opponent in the objective; the rest is that of the worst enemy."""
STEPS: Final = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Restrictions of the opponent at each stroke, and weights of the points of a frontier."""


class Result(NamedTuple):
    """Rallies won against an opponent, and against the worst enemy of what is played."""

    won: float
    worst: float

    def worth(self, p: float = WEIGHT) -> float:
        """The objective, as a fraction of rallies."""
        return p * self.won + (1 - p) * self.worst


class Point(TypedDict):
    """A point of a frontier; ``score`` and ``objective`` are 0 for bc and 1 for the best."""

    p: float
    score: float
    exploitability: float
    objective: float


def results(pairs: Sequence[tuple[TabulatedPolicy, TabulatedPolicy]], *, tolerance: float) -> list[Result]:
    """The result of the first policy of each pair against the second."""
    won = pair_odds(pairs, tolerance=tolerance)
    enemies = best_odds([player for player, _ in pairs], tolerance=tolerance)
    return [Result(odds.rally, 1 - enemy.rally) for odds, enemy in zip(won, enemies, strict=True)]


def responses(opponents: Sequence[TabulatedPolicy], *, tolerance: float) -> list[list[Result]]:
    """For each opponent the results of the responses, by restriction."""
    by_step = [restricted_odds(opponents, step, tolerance=tolerance) for step in STEPS]
    return [[Result(won.rally, worst.rally) for won, worst in of_opponent] for of_opponent in zip(*by_step, strict=True)]


def best(found: Sequence[Result], p: float = WEIGHT) -> Result:
    """The result of the restricted response for a weight."""
    return max(found, key=lambda result: result.worth(p))


def normalised(worth: float, reference: float, greatest: float) -> float:
    """0 for the reference, 1 for the restricted response.

    Raises:
        SuiteError: the reference is as good.
    """
    score = normalised_score(worth, reference, greatest)
    if score is None:
        raise SuiteError("bc is a best response to this opponent, so there is nothing to score")
    return score


def frontier(opponent: TabulatedPolicy, reference: TabulatedPolicy, *, tolerance: float) -> list[Point]:
    """The points of an opponent for all weights of :data:`STEPS` and :data:`WEIGHT`.

    Args:
        opponent: who is to be beaten.
        reference: who scores 0.
        tolerance: largest acceptable error bound of a value.
    """
    (zero,), (found,) = results([(reference, opponent)], tolerance=tolerance), responses([opponent], tolerance=tolerance)
    most, greatest = best(found, 1.0).won, best(found).worth()
    return [
        {
            "p": p,
            "score": normalised(chosen.won, zero.won, most),
            "exploitability": 1 - 2 * chosen.worst,
            "objective": normalised(chosen.worth(), zero.worth(), greatest),
        }
        for p in sorted({*STEPS, WEIGHT})
        if (chosen := best(found, p))
    ]
