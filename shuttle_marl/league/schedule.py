"""Schedules: which pairings a tournament plays, in stages of which each has a rally log of its own."""

import itertools
import math
from collections.abc import Sequence

from shuttle_marl.league.entrants import Format
from shuttle_marl.league.tournament import Pairing, PairResult


def stages(
    pool: Sequence[str], form: Format, results: Sequence[PairResult], *, rounds: int = 0, grown: Sequence[int] = ()
) -> list[list[Pairing]]:
    """The stages of a tournament that are known by now.

    Args:
        pool: the entrants.
        form: round robin: every pair once; gauntlet: the first entrant against each other; Swiss: in every round those play who
            have won about as much, and no two twice.
        results: of the pairings that were played, in order; a round of a Swiss tournament follows from those of the ones before.
        rounds: of a Swiss tournament; 0: as many as halving the pool takes.
        grown: how many entrants a round robin or a gauntlet had each time before more were added; each addition is a stage of
            the pairings that were missing.

    Returns:
        The pairings of each stage, numbered through.
    """
    if form == "swiss":
        return _swiss(pool, results, min(rounds or math.ceil(math.log2(len(pool))), len(pool) - 1))
    found: list[list[Pairing]] = []
    before = 0
    for size in (*grown, len(pool)):
        if form == "gauntlet":
            pairs = [(0, b) for b in range(max(1, before), size)]
        else:
            pairs = [(a, b) for a, b in itertools.combinations(range(size), 2) if b >= before]
        found.append(_pairings(pool, pairs, sum(map(len, found))))
        before = size
    return found


def _pairings(pool: Sequence[str], pairs: Sequence[tuple[int, int]], first: int) -> list[Pairing]:
    return [Pairing(number=n, entrants=(a, b), names=(pool[a], pool[b])) for n, (a, b) in enumerate(pairs, first)]


def _swiss(pool: Sequence[str], results: Sequence[PairResult], rounds: int) -> list[list[Pairing]]:
    """Rounds as far as results decide them; fewer than asked for if all who could play have met."""
    found: list[list[Pairing]] = []
    points = [0.0] * len(pool)
    met: set[tuple[int, int]] = set()
    rested: set[int] = set()
    for _ in range(rounds):
        first = sum(map(len, found))
        order = sorted(range(len(pool)), key=lambda i: (-points[i], i))
        rest = next((i for i in reversed(order) if i not in rested), None) if len(pool) % 2 else None
        pairs = _partners([i for i in order if i != rest], met)
        if pairs is None:
            break
        found.append(_pairings(pool, sorted(pairs), first))
        if len(results) < first + len(pairs):
            break
        if rest is not None:
            rested.add(rest)
            points[rest] += 1
        met.update(pairs)
        for pairing, result in zip(found[-1], results[first:], strict=False):
            for i, share in zip(pairing.entrants, _shares(result), strict=True):
                points[i] += share
    return found


def _shares(result: PairResult) -> tuple[float, float]:
    """Points of the two: the share of matches won; all of them against one who forfeited."""
    if result.forfeit:
        first, second = (float(name not in result.forfeit) for name in result.names)
        return first, second
    counts = result.seen_by(result.names[0])
    share = counts["wins"] / counts["matches"]
    return share, 1 - share


def _partners(order: list[int], met: set[tuple[int, int]]) -> list[tuple[int, int]] | None:
    """Everyone with the nearest one in the order whom they have not met; None if that is not possible."""
    if not order:
        return []
    one, *others = order
    for other in others:
        pair = (min(one, other), max(one, other))
        if pair not in met:
            rest = _partners([i for i in others if i != other], met)
            if rest is not None:
                return [pair, *rest]
    return None
