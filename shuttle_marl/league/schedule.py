"""Schedule: the pairings, their seats and their draws.

A pairing's matches come in cells of two: the entrants swap seats, while the seat that serves first and the luck of each seat
stay. In every second cell the other seat serves first. A rally's draws are named by its number and the seat that serves; by
its number alone, the two matches would become the same one as soon as one entrant serves in both. What happens in a match
depends on the seed, the two names and its number, so other entrants, their order, and the size of a batch never change it.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from shuttle_marl.game import draws
from shuttle_marl.kernel.records import Matches


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
