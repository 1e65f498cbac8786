"""Results at home and away: policies that were computed in one game, played in its refits on resampled matches.

A policy that was computed in a fitted game also exploits the errors of that fit. Refits are samples of the fits that the same
data could have given, so results there show how much of an advantage is supported by the data. Refits share most of their matches
with the game itself; unseen matches can differ more.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from scipy.special import stdtrit

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.exact.fixed_point import ExactError
from shuttle_marl.exact.known import pair_odds
from shuttle_marl.exact.optimal import Solution, best_response
from shuttle_marl.exact.profile import Crossplay, evaluate, moved
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.tables import Game

Values = float | F64
GameT = TypeVar("GameT", bound=Game)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Spread:
    """Distribution of a figure over refits.

    Attributes:
        value: mean.
        low, high: 95 % prediction interval of the figure in one more refit (Student's t).
    """

    value: Values
    low: Values
    high: Values

    def at(self, entry: int) -> "Spread":
        """The spread of one entry, where the figure is an array."""
        return Spread(**{name: float(np.asarray(getattr(self, name))[entry]) for name in ("value", "low", "high")})

    def as_json(self) -> dict[str, float | list[float]]:
        """The three numbers, or lists of numbers."""
        return {name: np.asarray(getattr(self, name)).tolist() for name in ("value", "low", "high")}


def spread(values: Sequence[Values]) -> Spread:
    """The spread of a figure over two or more refits; of arrays, entry by entry."""
    n = len(values)
    samples = np.array(values, dtype=np.float64)
    mean = samples.mean(axis=0)
    width = float(stdtrit(n - 1, 0.975)) * samples.std(axis=0, ddof=1) * math.sqrt(1 + 1 / n)
    return Spread(value=mean, low=mean - width, high=mean + width)


def over(
    games: Sequence[GameT], figures: Callable[[GameT], Mapping[str, Values]], *, at_once: int | None = None
) -> dict[str, Spread]:
    """The spread of each figure over games.

    Args:
        games: two refits or more.
        figures: the figures of one game by name.

    Raises:
        ExactError: there are fewer than two games.
    """
    if len(games) < 2:
        raise ExactError(f"an interval needs at least 2 refits of the game, found {len(games)}; skip it with --no-away")
    found = list(in_threads(figures, games, at_once))
    return {name: spread([each[name] for each in found]) for name in found[0]}


def of_pair(policy: TabulatedPolicy, opponent: TabulatedPolicy, refit: Game) -> dict[str, Values]:
    """``rally_win`` and ``match_win`` of a policy against another in a refit."""
    (odds,) = pair_odds([(moved(policy, refit), moved(opponent, refit))])
    return {"rally_win": odds.rally, "match_win": odds.match()}


def of_all_pairs(odds: Crossplay, rules: Rules = BWF) -> dict[str, Values]:
    """Odds of N policies: ``[N, N]`` ``rally_win`` and ``match_win``, and ``[N]`` ``match_share``, against all others."""
    match = odds.match(rules)
    others = max(1, len(match) - 1)
    return {"rally_win": odds.rally, "match_win": match, "match_share": (match.sum(axis=1) - match.diagonal()) / others}


def of_solution(solution: Solution, refit: Game) -> dict[str, Values]:
    """Perfect play of the game at home, in a refit.

    ``server_win``: fraction of rallies that the server wins when both play it; ``exploitability``: gain of the best response in
    the refit.
    """
    policy = moved(solution.policy[0], refit)
    played = evaluate(policy, policy).odds()
    return {"server_win": played.serving, "exploitability": best_response(policy).value.odds().value}
