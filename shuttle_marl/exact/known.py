"""Exact odds from the cache, or solved.

A tournament of 17 solves 153 pairs, most of which the last tournament solved too. The key of a result is a hash of the game, both
policies, the tolerance, and the source code of what computes it.
"""

import dataclasses
import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Final, TypeVar

from shuttle_marl.base.cache import Cache, key_of
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.exact.match import Odds
from shuttle_marl.exact.optimal import best_response, restricted_response, restricted_value
from shuttle_marl.exact.profile import Crossplay, crossplay_by, odds_of_pairs
from shuttle_marl.exact.version import sources_hash
from shuttle_marl.game.policy import TabulatedPolicy

Pair = tuple[TabulatedPolicy, TabulatedPolicy]
T = TypeVar("T")

_CACHE: Final = Cache("odds", 200_000)
"""About 30 MB."""
_NUMBERS: Final = struct.Struct("<3d")


def pair_odds(pairs: Sequence[Pair], *, tolerance: float = TOLERANCE) -> list[Odds]:
    """Odds of the first policy of each pair against the second; unknown pairs are solved on all cores.

    Args:
        pairs: each of one game, or of both tables of the game of a pair.

    Raises:
        ExactError: play may never end.
    """
    # A pair and its reverse are one problem.
    ordered = [(a, b) if (a.hash, a.game.hash) <= (b.hash, b.game.hash) else (b, a) for a, b in pairs]
    keys = [_key("pair", a.game.hash, b.game.hash, a.hash, b.hash, repr(tolerance)) for a, b in ordered]

    def solve(missing: list[Pair]) -> list[Odds]:
        used = {id(policy): policy for pair in missing for policy in pair}
        index = {key: i for i, key in enumerate(used)}
        numbers = [(index[id(a)], index[id(b)]) for a, b in missing]
        return [odds for odds, _ in odds_of_pairs(list(used.values()), numbers, tolerance=tolerance)]

    found = zip(pairs, ordered, _cached(keys, ordered, solve), strict=True)
    return [odds if pair[0] is first else _swapped(odds) for pair, (first, _), odds in found]


def _swapped(odds: Odds) -> Odds:
    """The odds of the other player."""
    return Odds(serving=1 - odds.receiving, receiving=1 - odds.serving, error_bound=odds.error_bound)


def crossplay(
    policies: Sequence[TabulatedPolicy], opponents: Sequence[TabulatedPolicy] | None = None, *, tolerance: float = TOLERANCE
) -> Crossplay:
    """:func:`shuttle_marl.exact.crossplay` of tabulated policies, with the cache."""

    def solve(everyone: list[TabulatedPolicy], pairs: list[tuple[int, int]]) -> list[tuple[Odds, Odds]]:
        found = pair_odds([(everyone[i], everyone[j]) for i, j in pairs], tolerance=tolerance)
        return [(odds, odds if i == j else _swapped(odds)) for (i, j), odds in zip(pairs, found, strict=True)]

    return crossplay_by(solve, policies, opponents)


def best_odds(policies: Sequence[TabulatedPolicy], *, tolerance: float = TOLERANCE) -> list[Odds]:
    """Odds of the best response to each policy against that policy.

    Args:
        policies: each of one game.

    Raises:
        ExactError: play may never end.
    """

    def solve(policy: TabulatedPolicy) -> Odds:
        return best_response(policy, tolerance=tolerance).value.odds()

    keys = [_key("best response", p.game.opposite.hash, p.game.hash, p.hash, repr(tolerance)) for p in policies]
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
        _key(f"restricted {p!r}", each.game.hash, "best" if player is None else player.hash, each.hash, repr(tolerance))
        for player, each in pairs
    ]
    return _cached(keys, pairs, lambda missing: in_threads(solve, missing))


def _odds(serving: float, receiving: float, error_bound: float) -> Odds:
    return Odds(serving=serving, receiving=receiving, error_bound=error_bound)


def _key(*parts: str) -> bytes:
    return key_of(*parts, sources_hash())


def _cached(keys: Sequence[bytes], problems: Sequence[T], solve: Callable[[list[T]], Iterable[Odds]]) -> list[Odds]:
    """Odds of problems by their keys: from the cache, or solved and stored there."""
    by_key = dict(zip(keys, problems, strict=True))
    found = {key: _odds(*_NUMBERS.unpack(content)) for key, content in _CACHE.read(by_key).items()}
    missing = {key: problem for key, problem in by_key.items() if key not in found}
    if missing:
        solved = dict(zip(missing, solve(list(missing.values())), strict=True))
        _CACHE.store({key: _NUMBERS.pack(*dataclasses.astuple(odds)) for key, odds in solved.items()})
        found |= solved
    return [found[key] for key in keys]
