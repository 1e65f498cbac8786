"""Tournament: its pairings in stages, each with a rally log of its own, their results, and how they are played."""

import collections
import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import Bools
from shuttle_marl.base.cluster import Cluster
from shuttle_marl.base.files import StoredCount
from shuttle_marl.game import draws
from shuttle_marl.game.rally import Rallies
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel.matches import Matches, play, play_matches
from shuttle_marl.kernel.players import Players, pack
from shuttle_marl.league.entrants import Entrant, ForfeitError, Format, Strikers, seat_tables

COUNTS = ("matches", "wins", "games_won", "games_lost", "points_won", "points_lost", "served", "served_won", "rallies", "strokes")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pairing:
    """Two entrants who play each other."""

    number: int
    entrants: tuple[int, int]  # their indices in the pool, the lower one first
    names: tuple[str, str]

    @property
    def key(self) -> int:
        """Key of the draws of the pairing; does not depend on the order of its names."""
        return draws.pairing_key(*self.names)

    @property
    def swapped(self) -> bool:
        """Whether the second entrant has seat 0 in match 0, which the entrant does whose name sorts first."""
        return self.names[0] > self.names[1]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PairResult:
    """Results of one pairing, from the side of its first entrant.

    Attributes:
        seats: :data:`COUNTS` at seat 0 and at seat 1: matches, wins, games and points of the first entrant and of the second,
            rallies that the first one served and how many of them it won, rallies and strokes.
        cells: numbers of cells in which the first entrant won neither match, one, and both.
    """

    pairing: int
    names: tuple[str, str]
    seats: tuple[dict[str, StoredCount], dict[str, StoredCount]]
    cells: tuple[StoredCount, StoredCount, StoredCount] = (0, 0, 0)
    forfeit: tuple[str, ...] = ()  # entrants that failed, so that the results of the pairing do not count; empty if none did
    reason: str = ""

    @property
    def sound(self) -> bool:
        """Whether all counts are there and do not contradict each other, and only the two entrants forfeited."""
        if any({*counts} != {*COUNTS} for counts in self.seats) or not {*self.forfeit} <= {*self.names}:
            return False
        total, (lost, split, won) = self.seen_by(self.names[0]), self.cells
        matches = (total["matches"], total["wins"]) == (2 * (lost + split + won), split + 2 * won)
        return matches and total["points_won"] + total["points_lost"] == total["rallies"]

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
        pairing=pairing.number, names=pairing.names, seats=(nothing, dict(nothing)), forfeit=tuple(by), reason=reason
    )


def tally(pairing: Pairing, rallies: Rallies, first_policy: int) -> PairResult:
    """Count the rallies of matches of a pairing; the winner of a match won its last rally.

    Args:
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


def stages(pool: Sequence[str], form: Format, results: Sequence[PairResult], *, rounds: int = 0) -> list[list[Pairing]]:
    """The stages of a tournament that its results so far determine.

    Args:
        form: round robin: every pair once; gauntlet: the first entrant against every other; Swiss: in every round, entrants with
            similar scores who have not met yet.
        results: of the pairings that were played, in order; they determine the next round of a Swiss tournament.
        rounds: number of rounds of a Swiss tournament; 0: the binary logarithm of the pool's size.

    Returns:
        The pairings of each stage, numbered consecutively.
    """
    if form == "swiss":
        return _swiss(pool, results, min(rounds or math.ceil(math.log2(len(pool))), len(pool) - 1))
    return [round_robin(pool) if form == "round-robin" else _pairings(pool, [(0, b) for b in range(1, len(pool))])]


def round_robin(pool: Sequence[str]) -> list[Pairing]:
    """Every pair of a pool once."""
    return _pairings(pool, [*itertools.combinations(range(len(pool)), 2)])


def _pairings(pool: Sequence[str], pairs: Sequence[tuple[int, int]], first: int = 0) -> list[Pairing]:
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
        pairs = _partners([i for i in order if i != rest], played, iter(range(_MOST_TRIES)))
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


def _partners(order: list[int], played: set[tuple[int, int]], tries: Iterator[int]) -> list[tuple[int, int]] | None:
    """Pair each entrant with the nearest in the order that it has not met; None if that is impossible, or not found in time."""
    if not order:
        return []
    if next(tries, None) is None:
        return None
    one, *others = order
    for other in others:
        pair = (min(one, other), max(one, other))
        if pair not in played:
            rest = _partners([i for i in others if i != other], played, tries)
            if rest is not None:
                return [pair, *rest]
    return None


_MOST_TRIES: Final = 20_000  # for the pairs of a Swiss round; only rounds behind half of the entrants may need more
Block = tuple[PairResult, list[Rallies]]  # a finished pairing and those of its rallies that are recorded, in order


def matches_of(pairing: Pairing, seed: int, first: int, last: int) -> Matches:
    """Matches ``first`` up to ``last`` of a pairing."""
    number = np.arange(first, last)
    cell = number >> 1
    seat_0 = (number & 1) ^ pairing.swapped
    entrant = np.array(pairing.entrants, dtype=np.int32)[np.stack([seat_0, 1 - seat_0], axis=1)]
    return Matches(entrant=entrant, first_server=(cell & 1).astype(np.int8), key=draws.stream(seed, pairing.key, cell))


def join(parts: Sequence[Matches]) -> Matches:
    """Concatenation of matches."""
    return Matches(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Matches)})


def groups(pairings: Sequence[Pairing], matches: int, batch: int, alone: set[int]) -> Iterator[list[Pairing]]:
    """Groups of pairings that are played together: as many as fit into a batch; those numbered in ``alone`` by themselves."""
    group: list[Pairing] = []
    for pairing in pairings:
        single = pairing.number in alone
        if group and (single or (len(group) + 1) * matches > batch):
            yield group
            group = []
        group.append(pairing)
        if single:
            yield group
            group = []
    if group:
        yield group


@dataclasses.dataclass(eq=False)
class Tournament:
    """A tournament that is being played."""

    game: Game
    entrants: Sequence[Entrant]
    _: dataclasses.KW_ONLY
    matches: int  # number of matches of every pairing, even
    seed: int
    batch: int = 8192  # number of matches that are played in one batch
    keep_strokes: bool = False  # whether rallies are returned, with their strokes; else only the results are
    rules: Rules = BWF
    workers: int = 1  # number of threads that play pairings of tables; compiled code does not hold the interpreter's lock
    cluster: Cluster | None = None  # plays them instead of threads; policies without a table play in this process
    threads: int | None = None  # of compiled code in a pairing; None: one for each core

    def __post_init__(self) -> None:
        self.batch = max(2, self.batch - self.batch % 2)
        if self.cluster is not None:
            self.workers = self.cluster.slots
        tabulated = np.array([entrant.table is not None for entrant in self.entrants])
        # [N] index of each entrant among those that have a table; -1 without one.
        self._table_of = np.where(tabulated, np.cumsum(tabulated) - 1, -1).astype(np.int32)

    def play(self, pairings: Sequence[Pairing]) -> Iterator[list[Block]]:
        """Play pairings in order; the blocks of one list were played in the same batch."""
        # A policy that fails aborts its batch, so the batch holds no other matches.
        alone = {p.number for p in pairings if self._reads_score(p)}
        waiting: collections.deque[Callable[[], list[Block]]] = collections.deque()
        shared: Any = None
        with ThreadPoolExecutor(self.workers) as threads:
            a_worker = -(-len(pairings) * self.matches // self.workers)  # work for every worker
            for group in groups(pairings, self.matches, min(self.batch, a_worker), alone):
                untabulated = group[0].number in alone
                # Results are returned in the order of the schedule, and few wait in memory.
                while waiting and (untabulated or len(waiting) >= 2 * self.workers):
                    yield waiting.popleft()()
                if untabulated:
                    yield self._play_alone(group)
                elif self.cluster is not None:
                    shared = shared or self.cluster.share(self)
                    waiting.append(self.cluster.submit(Tournament._play_group, shared, group))
                elif self.workers == 1:
                    yield self._play_group(group)
                else:
                    _ = self._players  # packed once, before the threads start
                    waiting.append(threads.submit(self._play_group, group).result)
            while waiting:
                yield waiting.popleft()()

    def __getstate__(self) -> dict[str, Any]:
        """State for another process: tables, but no policies, which may be code."""
        _ = self._players
        state = {name: value for name, value in self.__dict__.items() if name != "_strikers"}
        return {**state, "cluster": None, "entrants": (), "threads": 1}

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Unpickled arrays are read-only and have equal but not identical dtypes: the kernel accepts neither.
        players = state["_players"]
        self.__dict__.update(state, _players=type(players)(*(part.astype(part.dtype.type) for part in players)))

    def _reads_score(self, pairing: Pairing) -> bool:
        return bool((self._table_of[list(pairing.entrants)] < 0).any())

    def _play_alone(self, group: Sequence[Pairing]) -> list[Block]:
        failed = [self.entrants[i] for i in group[0].entrants if self.entrants[i].failure]
        if failed:
            return [(forfeited(group[0], [e.name for e in failed], "; ".join(e.failure for e in failed)), [])]
        try:
            return self._play_group(group)
        except ForfeitError as error:
            return [(forfeited(group[0], [error.name], error.reason), [])]

    def _play_group(self, group: Sequence[Pairing]) -> list[Block]:
        blocks: dict[Pairing, Block] = {}
        # Several pairings fit into one batch; a single one may take several batches.
        for first in range(0, self.matches, self.batch):
            last = min(first + self.batch, self.matches)
            rallies = self._rallies(group, first, last)
            bounds = np.searchsorted(rallies.pairing, [p.number for p in group] + [group[-1].number + 1])
            for pairing, begin, end in zip(group, bounds[:-1], bounds[1:], strict=True):
                part = rallies.slice(int(begin), int(end))
                result = tally(pairing, part, pairing.entrants[0])
                recorded = [part] if self.keep_strokes else []
                before = blocks.get(pairing)
                blocks[pairing] = (before[0] + result, [*before[1], *recorded]) if before else (result, recorded)
        return list(blocks.values())

    def _rallies(self, group: Sequence[Pairing], first: int, last: int) -> Rallies:
        """Matches ``first`` up to ``last`` of every pairing of a group."""
        matches = join([matches_of(pairing, self.seed, first, last) for pairing in group])
        if any(self._reads_score(pairing) for pairing in group):  # policies are called for every stroke
            choose, wait = self._strikers.choose, self._strikers.wait
            played = play(self.game, matches, choose, wait, rules=self.rules, keep_strokes=self.keep_strokes).rallies
        else:
            played = self._play_tables(matches)
        number = np.array([pairing.number for pairing in group], dtype=np.uint32)
        in_group, match = np.divmod(played.match, last - first)
        policy = matches.entrant[played.match].astype(np.uint16)
        return dataclasses.replace(played, pairing=number[in_group], match=(first + match).astype(np.uint32), policy=policy)

    def _play_tables(self, matches: Matches) -> Rallies:
        # The tables of seat 1 in the game of a pair are behind those of seat 0.
        second = (self._table_of >= 0).sum() if self.game.people is not None else 0
        entrant = self._table_of[matches.entrant] + np.array([0, second], dtype=np.int32)
        seated = Matches(entrant=entrant, first_server=matches.first_server, key=matches.key)
        game, players, rules, keep = self.game, self._players, self.rules, self.keep_strokes
        return play_matches(game, seated, players, rules=rules, keep_strokes=keep, threads=self.threads).rallies

    @functools.cached_property
    def _players(self) -> Players:
        """The tables of all entrants that have one, in order; see :func:`shuttle_marl.league.entrants.seat_tables`."""
        return pack([table for table in seat_tables(self.game, self.entrants) if table is not None], self.game)

    @functools.cached_property
    def _strikers(self) -> Strikers:
        return Strikers(self.game, self.entrants)
