"""Pairings of a tournament: which ones are played, in stages of which each has a rally log of its own, and their results."""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np

from shuttle_marl.arrays import Bools
from shuttle_marl.files import Count
from shuttle_marl.game import draws
from shuttle_marl.league.entrants import Format
from shuttle_marl.rally.record import Rallies

COUNTS = (
    "matches",
    "wins",
    "games_won",
    "games_lost",
    "points_won",
    "points_lost",
    "served",
    "served_won",
    "rallies",
    "strokes",
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pairing:
    """Two entrants who play each other.

    Attributes:
        number: index in the schedule.
        entrants: their indices in the pool, the lower one first.
        names: their names, in that order.
    """

    number: int
    entrants: tuple[int, int]
    names: tuple[str, str]

    @property
    def key(self) -> int:
        """Key of the draws of the pairing; does not depend on the order of its names."""
        return draws.pairing_key(*self.names)

    @property
    def swapped(self) -> bool:
        """Whether the second entrant has seat 0 in match 0, which the entrant does whose name sorts first."""
        return self.names[0] > self.names[1]


def round_robin(pool: Sequence[str]) -> list[Pairing]:
    """Every pair of a pool once."""
    pairs = itertools.combinations(range(len(pool)), 2)
    return [Pairing(number=n, entrants=(a, b), names=(pool[a], pool[b])) for n, (a, b) in enumerate(pairs)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PairResult:
    """Results of one pairing, from the side of its first entrant.

    Attributes:
        pairing: number of the pairing.
        names: the entrants.
        seats: :data:`COUNTS` at seat 0 and at seat 1: matches, wins, games and points of the first entrant and of the second,
            rallies that the first one served and how many of them it won, rallies and strokes.
        cells: numbers of cells in which the first entrant won neither match, one, and both.
        forfeit: entrants that failed, so that the results of the pairing do not count; empty if none did.
        reason: why they failed.
    """

    pairing: int
    names: tuple[str, str]
    seats: tuple[dict[str, Count], dict[str, Count]]
    cells: tuple[Count, Count, Count] = (0, 0, 0)
    forfeit: tuple[str, ...] = ()
    reason: str = ""

    def seen_by(self, name: str) -> dict[str, int]:
        """:data:`COUNTS` over both seats, as this entrant of the two has them."""
        first = {count: self.seats[0][count] + self.seats[1][count] for count in COUNTS}
        if name == self.names[0]:
            return first
        return {
            **first,
            "wins": first["matches"] - first["wins"],
            "games_won": first["games_lost"],
            "games_lost": first["games_won"],
            "points_won": first["points_lost"],
            "points_lost": first["points_won"],
            "served": first["rallies"] - first["served"],
            "served_won": first["points_lost"] - (first["served"] - first["served_won"]),
        }

    def __add__(self, more: "PairResult") -> "PairResult":
        """This and further matches of the same pairing."""
        seat_0, seat_1 = ({n: a[n] + b[n] for n in COUNTS} for a, b in zip(self.seats, more.seats, strict=True))
        lost, split, won = (a + b for a, b in zip(self.cells, more.cells, strict=True))
        return dataclasses.replace(self, seats=(seat_0, seat_1), cells=(lost, split, won))


def forfeited(pairing: Pairing, by: Sequence[str], reason: str) -> PairResult:
    """The result of a pairing that an entrant forfeited."""
    nothing = dict.fromkeys(COUNTS, 0)
    return PairResult(
        pairing=pairing.number,
        names=pairing.names,
        seats=(nothing, dict(nothing)),
        forfeit=tuple(by),
        reason=reason,
    )


def tally(pairing: Pairing, rallies: Rallies, first_policy: int) -> PairResult:
    """Count the rallies of matches of a pairing; the winner of a match won its last rally.

    Args:
        pairing: the pairing.
        rallies: of complete cells in order, as they were played or as they were read from a rally log.
        first_policy: index of the first entrant in ``rallies.policy``.
    """
    seat = rallies.policy[:, 1] == first_policy
    won = rallies.winner == seat
    last_of_match = np.r_[rallies.match[1:] != rallies.match[:-1], True]
    # A game ends where the next rally is at love all, and with the match.
    last_of_game = last_of_match | np.r_[(rallies.score[1:, 0] | rallies.score[1:, 1]) == 0, True]

    def count(where: Bools) -> list[int]:
        at_one = int(np.count_nonzero(where & seat))
        return [int(np.count_nonzero(where)) - at_one, at_one]

    # Lengths are known even where strokes are not recorded.
    strokes, strokes_at_one = (int(rallies.length.sum(dtype=np.int64, where=where)) for where in (True, seat))
    counts = {
        "matches": count(last_of_match),
        "wins": count(last_of_match & won),
        "games_won": count(last_of_game & won),
        "games_lost": count(last_of_game & ~won),
        "points_won": count(won),
        "points_lost": count(~won),
        "served": count(rallies.server == seat),
        "served_won": count((rallies.server == seat) & won),
        "rallies": count(np.ones(len(rallies), dtype=np.bool_)),
        "strokes": [strokes - strokes_at_one, strokes_at_one],
    }
    match_won = won[last_of_match].astype(np.int64)
    per_cell = np.bincount((rallies.match[last_of_match] - rallies.match[0]) >> 1, weights=match_won)
    cells = np.bincount(per_cell.astype(np.int64), minlength=3)
    seats = tuple({name: counts[name][s] for name in COUNTS} for s in (0, 1))
    return PairResult(
        pairing=pairing.number,
        names=pairing.names,
        seats=(seats[0], seats[1]),
        cells=(int(cells[0]), int(cells[1]), int(cells[2])),
    )


def stages(
    pool: Sequence[str], form: Format, results: Sequence[PairResult], *, rounds: int = 0, grown: Sequence[int] = ()
) -> list[list[Pairing]]:
    """The stages of a tournament that its results so far determine.

    Args:
        pool: the entrants.
        form: round robin: every pair once; gauntlet: the first entrant against every other; Swiss: in every round, entrants with
            similar scores who have not met yet.
        results: of the pairings that were played, in order; they determine the next round of a Swiss tournament.
        rounds: number of rounds of a Swiss tournament; 0: the binary logarithm of the pool's size.
        grown: sizes of the pool of a round robin or a gauntlet before entrants were added; each addition is a stage with the
            missing pairings.

    Returns:
        The pairings of each stage, numbered consecutively.
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
    """Rounds as far as results determine them; fewer than ``rounds`` if no pairing without a repetition is left."""
    found: list[list[Pairing]] = []
    points = [0.0] * len(pool)
    played: set[tuple[int, int]] = set()
    rested: set[int] = set()
    for _ in range(rounds):
        first = sum(map(len, found))
        order = sorted(range(len(pool)), key=lambda i: (-points[i], i))
        rest = next((i for i in reversed(order) if i not in rested), None) if len(pool) % 2 else None
        pairs = _partners([i for i in order if i != rest], played)
        if pairs is None:
            break
        found.append(_pairings(pool, sorted(pairs), first))
        if len(results) < first + len(pairs):
            break
        if rest is not None:
            rested.add(rest)
            points[rest] += 1
        played.update(pairs)
        for pairing, result in zip(found[-1], results[first:], strict=False):
            for i, score in zip(pairing.entrants, _scores(result), strict=True):
                points[i] += score
    return found


def _scores(result: PairResult) -> tuple[float, float]:
    """Scores of the two: the fraction of matches won; 1 against an entrant that forfeited."""
    if result.forfeit:
        first, second = (float(name not in result.forfeit) for name in result.names)
        return first, second
    counts = result.seen_by(result.names[0])
    share = counts["wins"] / counts["matches"]
    return share, 1 - share


def _partners(order: list[int], played: set[tuple[int, int]]) -> list[tuple[int, int]] | None:
    """Pair each entrant with the nearest in the order that it has not met; None if that is impossible."""
    if not order:
        return []
    one, *others = order
    for other in others:
        pair = (min(one, other), max(one, other))
        if pair not in played:
            rest = _partners([i for i in others if i != other], played)
            if rest is not None:
                return [pair, *rest]
    return None
