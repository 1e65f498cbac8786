"""Entrants of a tournament: policies as tables where they have one, and as calls where they read the score."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.draws import CHOICE_ONE, chosen
from shuttle_marl.game.policy import Policy, PolicyError, reads_score
from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy, tabulate
from shuttle_marl.kernel.lockstep import Ints, ask
from shuttle_marl.policy.registry import resolve


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Entrant:
    """One entrant.

    Attributes:
        name: as given in the pool.
        policy: the policy of that name.
        table: the policy on every state; None if it reads the score or failed.
        failure: why the entrant forfeits every match; empty if it does not.
    """

    name: str
    policy: Policy
    table: TabulatedPolicy | None = None
    failure: str = ""

    @property
    def hash(self) -> str:
        """SHA-256 of the table, hexadecimal; empty without one."""
        return "" if self.table is None else self.table.hash


def enter(name: str, game: Game) -> Entrant:
    """Find an entrant and evaluate it on every state.

    Raises:
        PolicyError: there is no policy of that name. One that raises or returns no distribution enters, and forfeits.
    """
    policy = resolve(name, game)
    try:
        if reads_score(policy):
            return Entrant(name=name, policy=policy)
        return Entrant(name=name, policy=policy, table=tabulate(policy, game, name))
    except PolicyError as error:
        return Entrant(name=name, policy=policy, failure=str(error))


class ForfeitError(Exception):
    """An entrant failed while it played."""

    def __init__(self, name: str, reason: str) -> None:
        super().__init__(f"{name}: {reason}")
        self.name, self.reason = name, reason


class Strikers:
    """Decides the strokes of a batch in which any of the entrants may strike.

    The tables of all entrants lie one below the other, so one row read and one comparison decide a stroke.
    """

    def __init__(self, game: Game, entrants: Sequence[Entrant]) -> None:
        self._game, self._entrants = game, entrants
        self._sampled = [i for i, entrant in enumerate(entrants) if entrant.table is None and not entrant.failure]
        tables = [np.empty((0, 0), dtype=np.uint16) if e.table is None else e.table.padded for e in entrants]
        width = max(table.shape[1] for table in tables)
        self._rows = np.full((sum(map(len, tables)), width), CHOICE_ONE, dtype=np.uint16)
        self._first_row = np.cumsum([0, *map(len, tables)])[:-1].astype(np.int32)
        for first, table in zip(self._first_row, tables, strict=True):
            self._rows[first : first + len(table), : table.shape[1]] = table

    def choose(self, entrant: Ints, state: Ints, draw: Ints, striker: Ints, score: Ints) -> npt.NDArray[np.intp]:
        """Index of the stroke that each striker plays among the legal ones; see :data:`shuttle_marl.kernel.lockstep.Choose`.

        Raises:
            ForfeitError: a policy that reads the score raised, or returned no distribution.
        """
        sampled = [i for i in self._sampled if (entrant == i).any()]
        if not sampled:
            return self._read(entrant, state, draw)
        k = np.empty(len(state), dtype=np.intp)
        rest = np.flatnonzero(~np.isin(entrant, sampled))
        k[rest] = self._read(entrant[rest], state[rest], draw[rest])
        for i in sampled:
            at = np.flatnonzero(entrant == i)
            k[at] = self._ask(i, state[at], draw[at], striker[at], score[:, at])
        return k

    def _read(self, entrant: Ints, state: Ints, draw: Ints) -> npt.NDArray[np.intp]:
        return chosen(self._rows.take(self._first_row[entrant] + state, axis=0), draw)

    def _ask(self, i: int, state: Ints, draw: Ints, striker: Ints, score: Ints) -> npt.NDArray[np.intp]:
        entrant = self._entrants[i]
        try:
            return ask(entrant.policy, entrant.name, self._game, state, draw, striker, score)
        except PolicyError as error:
            raise ForfeitError(entrant.name, str(error)) from error
