"""Exact odds of policies against each other, kept in the cache, their figures in the refits of the game, and odds of matches.

Refits are samples of the fits that the same data could have given, so results there show how much of an advantage is supported
by the data. They share most of their matches with the game itself; unseen matches can differ more.
"""

import dataclasses
import itertools
import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final, TypeVar

import numpy as np
import scipy  # its parts are imported when first used

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.cache import Cache, key_of
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.exact.fixed_point import TOLERANCE, ExactError, Odds
from shuttle_marl.exact.optimal import Solution, best_response, restricted_response, restricted_value
from shuttle_marl.exact.profile import check_opponents, evaluate, moved
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.scoring import BWF, Rules, count_rally, match_win_probability, open_scores
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.tables import Game

Pair = tuple[TabulatedPolicy, TabulatedPolicy]
T = TypeVar("T")
Situation = tuple[int, int, int, int, int]  # games of players 0 and 1, their points, and the server
GameT = TypeVar("GameT", bound=Game)

_CACHE: Final = Cache("odds", 200_000)  # about 30 MB
_NUMBERS: Final = struct.Struct("<3d")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Crossplay:
    """Odds of N policies against each other.

    Attributes:
        serving: ``[N, M]`` probability that the policy of the row wins a rally that it serves against the policy of the column.
        receiving: ``[N, M]`` probability that the policy of the row wins a rally that the policy of the column serves.
        error_bound: absolute error bound of all probabilities.
    """

    serving: F64
    receiving: F64
    error_bound: float

    @property
    def rally(self) -> F64:
        """``[N, M]`` probability that the policy of the row wins a rally, both serving equally often."""
        return (self.serving + self.receiving) / 2

    def match(self, rules: Rules = BWF) -> F64:
        """``[N, M]`` probability that the policy of the row wins a match, the first serve drawn at random."""
        return match_win_probability(self.serving, self.receiving, rules=rules)


def pair_odds(pairs: Sequence[Pair], *, tolerance: float = TOLERANCE) -> list[Odds]:
    """Odds of the first policy of each pair against the second; unknown pairs are solved on all cores.

    Args:
        pairs: each of one game, or of both tables of the game of a pair.

    Raises:
        ExactError: play may never end.
    """
    # A pair and its reverse are one problem.
    ordered = [(a, b) if (a.hash, a.game.hash) <= (b.hash, b.game.hash) else (b, a) for a, b in pairs]
    keys = [key_of("pair", a.game.hash, b.game.hash, a.hash, b.hash, repr(tolerance)) for a, b in ordered]

    def solve(pair: Pair) -> Odds:
        return evaluate(*pair, tolerance=tolerance).odds()

    found = zip(pairs, ordered, _cached(keys, ordered, lambda missing: in_threads(solve, missing)), strict=True)
    return [odds if pair[0] is first else _swapped(odds) for pair, (first, _), odds in found]


def _swapped(odds: Odds) -> Odds:
    """The odds of the other player."""
    return Odds(serving=1 - odds.receiving, receiving=1 - odds.serving, error_bound=odds.error_bound)


def crossplay(
    policies: Sequence[TabulatedPolicy], opponents: Sequence[TabulatedPolicy] | None = None, *, tolerance: float = TOLERANCE
) -> Crossplay:
    """Exact odds of every pair of policies, including each against itself; see :func:`pair_odds`.

    Args:
        policies: N policies of games with the same layout.
        opponents: M policies of the opponent, such as those of the other player of a pair; None: the same N.

    Raises:
        ExactError: there is no policy, two games have different layouts, policies of a pair do not meet those of the other
            player, or play may never end.
    """
    if not policies or (opponents is not None and not opponents):
        raise ExactError("crossplay of no policies: give one or more")
    everyone, n = [*policies, *(opponents or ())], len(policies)
    if opponents is None:
        pairs = list(itertools.combinations_with_replacement(range(n), 2))
    else:
        pairs = list(itertools.product(range(n), range(n, len(everyone))))
    for i, j in pairs:
        check_opponents(everyone[i].game, everyone[j].game)
    found = pair_odds([(everyone[i], everyone[j]) for i, j in pairs], tolerance=tolerance)
    serving, receiving = np.full((2, len(everyone), len(everyone)), np.nan)
    for (i, j), odds in zip(pairs, found, strict=True):
        serving[j, i] = 1 - odds.receiving
        serving[i, j], receiving[i, j] = odds.serving, odds.receiving
    if opponents is None:
        receiving = 1 - serving.T
    columns = slice(0 if opponents is None else n, None)
    bound = max(odds.error_bound for odds in found)
    return Crossplay(serving=serving[:n, columns], receiving=receiving[:n, columns], error_bound=bound)


def best_odds(policies: Sequence[TabulatedPolicy], *, tolerance: float = TOLERANCE) -> list[Odds]:
    """Odds of the best response to each policy against that policy.

    Args:
        policies: each of one game.

    Raises:
        ExactError: play may never end.
    """

    def solve(policy: TabulatedPolicy) -> Odds:
        return best_response(policy, tolerance=tolerance).value.odds()

    keys = [key_of("best response", p.game.opposite.hash, p.game.hash, p.hash, repr(tolerance)) for p in policies]
    return _cached(keys, policies, lambda missing: in_threads(solve, missing))


def restricted_odds(
    pairs: Sequence[tuple[TabulatedPolicy | None, TabulatedPolicy]], p: float, *, tolerance: float = TOLERANCE
) -> list[Odds]:
    """Odds of the first policy of each pair against the second, restricted as for :func:`shuttle_marl.exact.restricted_response`.

    Args:
        pairs: each of one game; None: the restricted response.
        p: probability with which the second policy is played at each stroke.

    Raises:
        ExactError: play may never end.
    """

    def solve(pair: tuple[TabulatedPolicy | None, TabulatedPolicy]) -> Odds:
        player, opponent = pair
        if player is None:
            return restricted_response(opponent, p, tolerance=tolerance).value.odds()
        return restricted_value(player, opponent, p, tolerance=tolerance).odds()

    keys = [
        key_of(f"restricted {p!r}", each.game.hash, "best" if player is None else player.hash, each.hash, repr(tolerance))
        for player, each in pairs
    ]
    return _cached(keys, pairs, lambda missing: in_threads(solve, missing))


def _cached(keys: Sequence[bytes], problems: Sequence[T], solve: Callable[[list[T]], Iterable[Odds]]) -> list[Odds]:
    """Odds of problems by their keys: from the cache, or solved and stored there."""

    def unpacked(content: bytes) -> Odds:
        serving, receiving, bound = _NUMBERS.unpack(content)
        return Odds(serving=serving, receiving=receiving, error_bound=bound)

    by_key = dict(zip(keys, problems, strict=True))
    found = _CACHE.solved(by_key, solve, lambda odds: _NUMBERS.pack(*dataclasses.astuple(odds)), unpacked)
    return [found[key] for key in keys]


def spread(values: Sequence[float]) -> Estimate:
    """Mean of a figure over two or more refits, and its 95 % prediction interval in one more refit (Student's t)."""
    n = len(values)
    mean = float(np.mean(values))
    width = float(scipy.special.stdtrit(n - 1, 0.975) * np.std(values, ddof=1)) * math.sqrt(1 + 1 / n)
    return Estimate(mean, mean - width, mean + width)


def over(games: Sequence[GameT], figures: Callable[[GameT], Mapping[str, float]]) -> dict[str, Estimate]:
    """The spread of each figure over games.

    Args:
        games: two refits or more.
        figures: the figures of one game by name.

    Raises:
        ExactError: there are fewer than two games.
    """
    if len(games) < 2:
        raise ExactError(f"an interval needs at least 2 refits of the game, found {len(games)}; skip it with --no-away")
    found = list(in_threads(figures, games))
    return {name: spread([each[name] for each in found]) for name in found[0]}


def of_pair(policy: TabulatedPolicy, opponent: TabulatedPolicy, refit: Game) -> dict[str, float]:
    """``rally_win`` and ``match_win`` of a policy against another in a refit."""
    (odds,) = pair_odds([(moved(policy, refit), moved(opponent, refit))])
    return {"rally_win": odds.rally, "match_win": odds.match()}


def of_solution(solution: Solution, refit: Game) -> dict[str, float]:
    """Perfect play of the game at home, in a refit.

    ``server_win``: fraction of rallies that the server wins when both play it; ``exploitability``: gain of the best response in
    the refit.
    """
    policy = moved(solution.policy[0], refit)
    played = evaluate(policy, policy).odds()
    return {"server_win": played.serving, "exploitability": best_response(policy).value.odds().value}


def match_table(serving: float, receiving: float, rules: Rules = BWF) -> dict[Situation, tuple[float, float]]:
    """Probabilities that player 0 wins the match after winning and after losing the next rally, in every situation.

    Args:
        serving, receiving: probability that player 0 wins a rally that player 0 or player 1 serves.
    """
    table: dict[Situation, tuple[float, float]] = {}

    def win_probability(games: tuple[int, int], points: tuple[int, int], winner: int) -> float:
        """Of player 0 after a rally."""
        score, won = [*points], [*games]
        counted = count_rally(points[winner], points[1 - winner], games[winner], rules)
        if counted.match_won:
            return float(winner == 0)
        score[winner], won[winner] = counted.points, counted.games
        if counted.game_won:
            score = [0, 0]
        if_won, if_lost = table[(won[0], won[1], score[0], score[1], winner)]
        p = receiving if winner else serving
        return if_lost + p * (if_won - if_lost)

    for games, points in open_scores(rules):
        after = (win_probability(games, points, 0), win_probability(games, points, 1))
        for server in (0, 1):
            table[(*games, *points, server)] = after
    return table


def least_gain(serving: float, receiving: float, rules: Rules = BWF) -> float:
    """Least gain in player 0's probability of winning the match from winning a rally, over all scores.

    If it is not negative, minimax play in every rally is minimax play in the match (Walker, Wooders & Amir, Games and Economic
    Behavior 71, 2011). That is not trivial, because the winner of a rally serves next, and serving can be a disadvantage. The
    match is zero-sum, so this covers both players.
    """
    return min(won - lost for won, lost in match_table(serving, receiving, rules).values())


def normalised_score(rally_win: float, reference: float, best: float, *, error_bound: float = 0.0) -> float | None:
    """Score by the probability to win a rally against an opponent: 0 for a reference policy, 1 for the best response.

    Args:
        error_bound: absolute error bound of ``best - reference``.

    Returns:
        ``(rally_win - reference) / (best - reference)``; None if the best response may not be better than the reference.
    """
    return (rally_win - reference) / (best - reference) if best - error_bound > reference else None
