"""Play of a tournament: the pairings, a group at a time, and their results."""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from shuttle_marl.game.rally import Game
from shuttle_marl.kernel import lockstep
from shuttle_marl.kernel.records import Matches, PlayedMatches
from shuttle_marl.league.entrants import Entrant, ForfeitError, Strikers
from shuttle_marl.league.results import PairResult, forfeited, tally
from shuttle_marl.league.schedule import Pairing, groups, join, matches_of
from shuttle_marl.recording import Rallies
from shuttle_marl.recording.kernel_rallies import rallies_of

if TYPE_CHECKING:
    from shuttle_marl.kernel import Players

Block = tuple[PairResult, list[Rallies]]
"""A finished pairing and all its rallies, in order."""


class Tournament:
    """A tournament that is being played.

    Args:
        game: the tables.
        entrants: all of them.
        matches: matches of every pairing.
        seed: names all draws.
        batch: matches that are played together.
        keep_strokes: whether the rallies come with their strokes.
    """

    def __init__(
        self, game: Game, entrants: Sequence[Entrant], *, matches: int, seed: int, batch: int, keep_strokes: bool
    ) -> None:
        self._game, self._entrants = game, entrants
        self._matches, self._seed, self._batch, self._keep_strokes = matches, seed, max(2, batch - batch % 2), keep_strokes

    def play(self, pairings: Sequence[Pairing], progress: Callable[[int], None] | None = None) -> Iterator[list[Block]]:
        """Play pairings in order; those that come together were played in the same batch.

        Args:
            pairings: those that remain.
            progress: called now and then with the number of strokes since the last call.
        """
        # A policy that fails while it plays takes down its batch, so no other matches are in it.
        alone = {p.number for p in pairings if any(self._entrants[i].table is None for i in p.entrants)}
        for group in groups(pairings, self._matches, self._batch, alone):
            failed = [self._entrants[i] for i in group[0].entrants if self._entrants[i].failure]
            if failed:
                yield [(forfeited(group[0], [e.name for e in failed], "; ".join(e.failure for e in failed)), [])]
                continue
            try:
                yield self._play_group(group, progress)
            except ForfeitError as error:
                yield [(forfeited(group[0], [error.name], error.reason), [])]

    def _play_group(self, group: Sequence[Pairing], progress: Callable[[int], None] | None) -> list[Block]:
        found: dict[Pairing, Block] = {}
        # Several pairings fit into one batch together; a single one may take several batches.
        for first in range(0, self._matches, self._batch):
            last = min(first + self._batch, self._matches)
            rallies = self._rallies(group, first, last, progress)
            bounds = np.searchsorted(rallies.pairing, [p.number for p in group] + [group[-1].number + 1])
            for pairing, begin, end in zip(group, bounds[:-1], bounds[1:], strict=True):
                part = rallies.part(int(begin), int(end))
                result = tally(pairing, part, pairing.entrants[0])
                before = found.get(pairing)
                found[pairing] = (before[0] + result, [*before[1], part]) if before else (result, [part])
        return list(found.values())

    def _rallies(self, group: Sequence[Pairing], first: int, last: int, progress: Callable[[int], None] | None) -> Rallies:
        """Matches ``first`` up to ``last`` of every pairing of a group."""
        matches = join([matches_of(pairing, self._seed, first, last) for pairing in group])
        tabulated = all(self._entrants[i].table is not None for pairing in group for i in pairing.entrants)
        played = (self._play_tables if tabulated else self._ask)(matches, progress)
        number = np.array([pairing.number for pairing in group], dtype=np.uint32)
        in_group, match = np.divmod(played.match, last - first)
        return rallies_of(played, pairing=number[in_group], match=first + match, policy=matches.entrant)

    def _play_tables(self, matches: Matches, progress: Callable[[int], None] | None) -> PlayedMatches:
        """Play matches between entrants that all have a table."""
        from shuttle_marl.kernel import play_matches  # noqa: PLC0415  numba is slow to import

        place = np.cumsum([entrant.table is not None for entrant in self._entrants], dtype=np.int32) - 1
        seated = Matches(entrant=place[matches.entrant], first_server=matches.first_server, key=matches.key)
        return play_matches(self._game, seated, self._players, keep_strokes=self._keep_strokes, progress=progress)

    def _ask(self, matches: Matches, progress: Callable[[int], None] | None) -> PlayedMatches:
        """Play matches in which an entrant has to be asked for every stroke."""
        return lockstep.play(self._game, matches, self._strikers.choose, keep_strokes=self._keep_strokes, progress=progress)

    @functools.cached_property
    def _players(self) -> "Players":
        """The tables of all entrants that have one, in their order."""
        from shuttle_marl.kernel import pack  # noqa: PLC0415  numba is slow to import

        return pack([entrant.table for entrant in self._entrants if entrant.table is not None], self._game)

    @functools.cached_property
    def _strikers(self) -> Strikers:
        return Strikers(self._game, self._entrants)
