"""Play of a tournament: the schedule of pairings, their matches a group at a time, and the results.

A pairing's matches come in cells of two: the entrants swap seats, while the seat that serves first and the luck of each seat
stay. In every second cell the other seat serves first. A rally's draws are named by its number and the seat that serves; by
its number alone, the two matches would become the same one as soon as one entrant serves in both. What happens in a match
depends on the seed, the two names and its number, so other entrants, their order, and the size of a batch never change it.
"""

import collections
import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from shuttle_marl.arrays import Bools
from shuttle_marl.cluster import Cluster, Shared, Task
from shuttle_marl.game import draws
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel.lockstep import Matches, play
from shuttle_marl.league.entrants import Entrant, ForfeitError, Strikers
from shuttle_marl.league.sequential import decided
from shuttle_marl.recording import Rallies

if TYPE_CHECKING:
    from shuttle_marl.kernel import Players

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
        number: position in the schedule, from 0.
        entrants: their positions in the pool, the lower one first.
        names: their names, in that order.
    """

    number: int
    entrants: tuple[int, int]
    names: tuple[str, str]

    @property
    def key(self) -> int:
        """Key of the draws of the pairing, whatever the order of its names."""
        return draws.pairing_key(*self.names)

    @property
    def swapped(self) -> bool:
        """Whether the second entrant sits at seat 0 in match 0: the one whose name sorts first does."""
        return self.names[0] > self.names[1]


def round_robin(pool: Sequence[str]) -> list[Pairing]:
    """Every pair of a pool once."""
    pairs = itertools.combinations(range(len(pool)), 2)
    return [Pairing(number=n, entrants=(a, b), names=(pool[a], pool[b])) for n, (a, b) in enumerate(pairs)]


def matches_of(pairing: Pairing, seed: int, first: int, last: int) -> Matches:
    """Matches ``first`` up to ``last`` of a pairing."""
    number = np.arange(first, last)
    cell = number >> 1
    seat_0 = (number & 1) ^ pairing.swapped
    entrant = np.array(pairing.entrants, dtype=np.int32)[np.stack([seat_0, 1 - seat_0], axis=1)]
    return Matches(entrant=entrant, first_server=(cell & 1).astype(np.int8), key=draws.stream(seed, pairing.key, cell))


def join(parts: Sequence[Matches]) -> Matches:
    """Several matches, one after the other."""
    return Matches(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Matches)})


def groups(pairings: Sequence[Pairing], matches: int, batch: int, alone: set[int]) -> Iterator[list[Pairing]]:
    """Pairings that are played together: as many as fit into a batch, those numbered in ``alone`` by themselves."""
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


@dataclasses.dataclass(frozen=True, kw_only=True)
class PairResult:
    """The matches of one pairing, seen by its first entrant.

    Attributes:
        pairing: number of the pairing.
        names: the entrants.
        seats: at seat 0 and at seat 1, each :data:`COUNTS` as numbers: matches, wins, games and points of the first entrant
            and of the second, rallies that the first one served and won of those, rallies and strokes in all.
        cells: in how many cells the first entrant won neither match, one, and both.
        forfeit: entrants that failed, so that the pairing was not played or was thrown away; empty if none did.
        reason: why they failed.
    """

    pairing: int
    names: tuple[str, str]
    seats: tuple[dict[str, int], dict[str, int]]
    cells: tuple[int, int, int] = (0, 0, 0)
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

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> "PairResult":
        """Read the fields that ``dataclasses.asdict`` gave."""
        lists = {name: tuple(fields[name]) for name in ("names", "seats", "cells", "forfeit")}
        return cls(**{**fields, **lists})


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
    """Count the rallies of some matches of a pairing; the winner of a match won its last rally.

    Args:
        pairing: the pairing.
        rallies: whole cells of it in order; as they were played, or as they were read back from the rally log.
        first_policy: number of the first entrant in ``rallies.policy``.
    """
    seat = rallies.policy[:, 1] == first_policy
    won = rallies.winner == seat
    last_of_match = np.r_[rallies.match[1:] != rallies.match[:-1], True]
    # A game ends where the next rally is at love all, and with the match.
    last_of_game = last_of_match | np.r_[(rallies.score[1:, 0] | rallies.score[1:, 1]) == 0, True]

    def count(where: Bools) -> list[int]:
        at_one = int(np.count_nonzero(where & seat))
        return [int(np.count_nonzero(where)) - at_one, at_one]

    # Without strokes kept, their number is still known.
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


_TESTED: Final = 32
"""So many matches are played between two looks at a sequential test, whatever the batch: it decides which are played at all."""

Block = tuple[PairResult, list[Rallies]]
"""A finished pairing and the rallies of it that are to be recorded, in order."""


class Tournament:
    """A tournament that is being played.

    Args:
        game: the tables.
        entrants: all of them.
        matches: matches of every pairing.
        seed: names all draws.
        batch: matches that are played together.
        keep_strokes: whether the rallies come too, with their strokes; else only the results do.
        sample: picks the rallies that come; None: all.
        decide: stop pairings with an entrant that has no table when it is decided who is better, see
            :mod:`shuttle_marl.league.sequential`; None: play all matches.
        workers: threads that play pairings of tables side by side; compiled, they hold no lock of the interpreter.
        cluster: plays them instead of threads; policies without a table play here.
    """

    def __init__(
        self,
        game: Game,
        entrants: Sequence[Entrant],
        *,
        matches: int,
        seed: int,
        batch: int,
        keep_strokes: bool,
        sample: Callable[[Rallies], Rallies] | None = None,
        decide: float | None = None,
        workers: int = 1,
        cluster: Cluster | None = None,
    ) -> None:
        self._workers, self._cluster, self._sample = workers if cluster is None else cluster.slots, cluster, sample
        tabulated = np.array([entrant.table is not None for entrant in entrants])
        self._place = np.where(tabulated, np.cumsum(tabulated) - 1, -1).astype(np.int32)
        """``[N]`` place of each entrant among those that have a table; -1 without one."""
        self._threads: int | None = None
        self._game, self._entrants, self._decide = game, entrants, decide
        self._matches, self._seed, self._batch, self._keep_strokes = matches, seed, max(2, batch - batch % 2), keep_strokes

    def play(self, pairings: Sequence[Pairing], progress: Callable[[int], None] | None = None) -> Iterator[list[Block]]:
        """Play pairings in order; those that come together were played in the same batch.

        Args:
            pairings: those that remain.
            progress: called now and then with the number of strokes since the last call.
        """
        # A policy that fails while it plays takes down its batch, so no other matches are in it.
        alone = {p.number for p in pairings if self._is_asked(p)}
        waiting: collections.deque[Callable[[], list[Block]]] = collections.deque()
        with ThreadPoolExecutor(self._workers) as threads:
            shared = -(-len(pairings) * self._matches // self._workers)  # something to do for every worker
            for group in groups(pairings, self._matches, min(self._batch, shared), alone):
                asked = group[0].number in alone
                # Results come in the order of the schedule, and few are kept waiting.
                while waiting and (asked or len(waiting) >= 2 * self._workers):
                    yield waiting.popleft()()
                if asked:
                    yield self._play_alone(group, progress)
                elif self._cluster is not None:
                    waiting.append(functools.partial(_counted, self._cluster.submit(_played, self._shared, group), progress))
                elif self._workers == 1:
                    yield self._play_group(group, progress)
                else:
                    _ = self._players  # packed once, before threads need it
                    waiting.append(threads.submit(self._play_group, group, progress).result)
            while waiting:
                yield waiting.popleft()()

    def __getstate__(self) -> dict[str, Any]:
        """The state that travels to another process: tables, and no policy, which may be code."""
        _ = self._players
        alone = ("_cluster", "_shared", "_strikers")
        state = {name: value for name, value in self.__dict__.items() if name not in alone}
        return {**state, "_entrants": (), "_threads": 1}

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Arrays that travelled are read-only, and their types equal numpy's own without being them: the kernel takes neither.
        players = state["_players"]
        self.__dict__.update(state, _players=type(players)(*(part.astype(part.dtype.type) for part in players)))

    def _is_asked(self, pairing: Pairing) -> bool:
        """Whether an entrant of a pairing has no table."""
        return bool((self._place[list(pairing.entrants)] < 0).any())

    def _play_alone(self, group: Sequence[Pairing], progress: Callable[[int], None] | None) -> list[Block]:
        """Play a pairing with an entrant that may fail."""
        failed = [self._entrants[i] for i in group[0].entrants if self._entrants[i].failure]
        if failed:
            return [(forfeited(group[0], [e.name for e in failed], "; ".join(e.failure for e in failed)), [])]
        try:
            return self._play_group(group, progress)
        except ForfeitError as error:
            return [(forfeited(group[0], [error.name], error.reason), [])]

    def _play_group(self, group: Sequence[Pairing], progress: Callable[[int], None] | None) -> list[Block]:
        found: dict[Pairing, Block] = {}
        # Several pairings fit into one batch together; a single one may take several batches.
        tested = self._decide is not None and self._is_asked(group[0])
        step = _TESTED if tested else self._batch
        for first in range(0, self._matches, step):
            last = min(first + step, self._matches)
            rallies = self._rallies(group, first, last, progress)
            bounds = np.searchsorted(rallies.pairing, [p.number for p in group] + [group[-1].number + 1])
            for pairing, begin, end in zip(group, bounds[:-1], bounds[1:], strict=True):
                part = rallies.slice(int(begin), int(end))
                result = tally(pairing, part, pairing.entrants[0])
                kept = [] if not self._keep_strokes else [part if self._sample is None else self._sample(part)]
                before = found.get(pairing)
                found[pairing] = (before[0] + result, [*before[1], *kept]) if before else (result, kept)
            if tested and self._decide is not None and decided(found[group[0]][0].cells, self._decide):
                break
        return list(found.values())

    def _rallies(self, group: Sequence[Pairing], first: int, last: int, progress: Callable[[int], None] | None) -> Rallies:
        """Matches ``first`` up to ``last`` of every pairing of a group."""
        matches = join([matches_of(pairing, self._seed, first, last) for pairing in group])
        asked = any(self._is_asked(pairing) for pairing in group)
        played = (self._ask if asked else self._play_tables)(matches, progress)
        number = np.array([pairing.number for pairing in group], dtype=np.uint32)
        in_group, match = np.divmod(played.match, last - first)
        policy = matches.entrant[played.match].astype(np.uint16)
        return dataclasses.replace(played, pairing=number[in_group], match=(first + match).astype(np.uint32), policy=policy)

    def _play_tables(self, matches: Matches, progress: Callable[[int], None] | None) -> Rallies:
        """Play matches between entrants that all have a table."""
        from shuttle_marl.kernel import play_matches  # noqa: PLC0415  numba is slow to import

        seated = Matches(entrant=self._place[matches.entrant], first_server=matches.first_server, key=matches.key)
        keep, threads = self._keep_strokes, self._threads
        return play_matches(self._game, seated, self._players, keep_strokes=keep, threads=threads, progress=progress).rallies

    def _ask(self, matches: Matches, progress: Callable[[int], None] | None) -> Rallies:
        """Play matches in which an entrant has to be asked for every stroke."""
        return play(self._game, matches, self._strikers.choose, keep_strokes=self._keep_strokes, progress=progress).rallies

    @functools.cached_property
    def _shared(self) -> "Shared[Tournament]":
        assert self._cluster is not None
        return self._cluster.share(self)

    @functools.cached_property
    def _players(self) -> "Players":
        """The tables of all entrants that have one, in their order."""
        from shuttle_marl.kernel import pack  # noqa: PLC0415  numba is slow to import

        return pack([entrant.table for entrant in self._entrants if entrant.table is not None], self._game)

    @functools.cached_property
    def _strikers(self) -> Strikers:
        return Strikers(self._game, self._entrants)


def _played(tournament: Tournament, group: Sequence[Pairing]) -> list[Block]:
    """Play pairings of tables in a process of a cluster."""
    return tournament._play_group(group, None)


def _counted(task: Task[list[Block]], progress: Callable[[int], None] | None) -> list[Block]:
    """Results that came from a cluster; their strokes are counted now."""
    blocks = task.result()
    if progress is not None:
        progress(sum(counts["strokes"] for result, _ in blocks for counts in result.seats))
    return blocks
