"""The game against a receiver whose positions are known.

If one player's positions are fixed, the other one strikes in a game without recovery, whose tables are the means over these
positions (:func:`met`): everything else that is exact is computed there.
"""

import dataclasses
import functools
from typing import NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, I8, I32, I64, U8, U16
from shuttle_marl.base.compiling import compiled
from shuttle_marl.game.draws import HURRY_ONE
from shuttle_marl.game.layout import ALL, Indices
from shuttle_marl.game.tables import Game


class Rows(NamedTuple):
    """Outcomes of a block by position, see :class:`shuttle_marl.game.recovery.Waiting`."""

    choices: I32
    position: I8
    start: I64
    limits: U16
    """``[G, R, 3]`` thresholds in G games."""
    hurry: U8
    """``[G, R, 2]`` chances of a hurried receiver."""


def rows_of(games: tuple[Game, ...], block: int) -> Rows:
    """The rows of one block of states of games with the same layout and feasible positions."""
    return _rows_of(games, block // games[0].levels)


@functools.lru_cache(maxsize=8)
def _rows_of(games: tuple[Game, ...], level: int) -> Rows:
    first = games[0].waiting
    if len(games) == 1:
        return Rows(first.choices, first.position, first.start, first.limits[level : level + 1], first.hurry[None])
    limits, hurry = (np.stack(part) for part in zip(*((g.waiting.limits[level], g.waiting.hurry) for g in games), strict=True))
    return Rows(first.choices, first.position, first.start, limits, hurry)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MetGame(Game):
    """The game against a receiver whose positions are known: the means of the tables over them.

    Attributes:
        of: the game with recovery.
        table: for each block the row of the following two; blocks that are alike share one.
        mean_limits: ``[T, base pairs, 3]`` thresholds, not rounded.
        mean_hurry: ``[T, base pairs, 2]`` chances of a hurried receiver, not rounded.
    """

    of: Game
    table: tuple[int, ...]
    mean_limits: F64
    mean_hurry: F64

    def __post_init__(self) -> None:
        """Its layout is that of a game that was checked."""

    @property
    def tables(self) -> Game:
        """The game that has its layout."""
        return self.of

    @functools.cached_property
    def limits(self) -> F64:  # type: ignore[override]
        """``[T, base pairs, 3]`` thresholds."""
        return self.mean_limits

    def table_of(self, block: int) -> int:
        """Row of ``limits`` that holds in a block."""
        return self.table[block]

    def hurry_at(self, table: int) -> F64:  # type: ignore[override]
        """``[base pairs, 2]`` chances of a hurried receiver."""
        return self.mean_hurry[table]

    def limit_row(self, pairs: slice | Indices = ALL) -> I64:
        """``[...]`` row of legal pairs in ``limits`` as ``[T * base pairs, 3]``."""
        block, base = np.divmod(self._numbers(pairs), self.n_base_pairs)
        return np.asarray(np.array(self.table, dtype=np.int64)[block] * self.n_base_pairs + base)

    def hurry_of(self, pairs: slice | Indices = ALL) -> F64:
        """``[..., 2]`` probability that the receiver of a return is hurried."""
        return self.mean_hurry.reshape(-1, 2)[self.limit_row(pairs)] / HURRY_ONE


def met(game: Game, positions: F64 | None) -> MetGame:
    """The game against a receiver who chooses positions.

    Args:
        game: with recovery, the tables with which the striker strikes.
        positions: ``[S, 9]`` their probabilities in each state of the striker; None: those of people.
    """
    size, base = game.n_base_states, game.n_base_pairs
    table: list[int] = []
    known: list[tuple[int, F64]] = []
    limits, hurry = [], []
    usual = np.empty(0) if positions is not None else game.people_positions(np.arange(size))
    for block in range(game.n_blocks):
        here = usual if positions is None else positions[game.block_states(block)]
        level = block // game.levels
        found = next((k for k, (other, before) in enumerate(known) if other == level and np.array_equal(before, here)), None)
        if found is None:
            found = len(known)
            known.append((level, here))
            limits.append(np.empty((base, 3)))
            hurry.append(np.empty((base, 2)))
            _means(
                np.ascontiguousarray(here, dtype=np.float64), game.base_pair_start, rows_of((game,), block), limits[-1], hurry[-1]
            )
        table.append(found)
    fields = {field.name: getattr(game, field.name) for field in dataclasses.fields(Game)}
    fields["recovery"] = None
    return MetGame(**fields, of=game, table=tuple(table), mean_limits=np.stack(limits), mean_hurry=np.stack(hurry))


@compiled
def _means(positions: F64, pair_start: I32, rows: Rows, limits: F64, hurry: F64) -> None:
    """Mean tables over ``[base states, 9]`` probabilities of positions."""
    for s in range(positions.shape[0]):
        m, row = rows.choices[s], rows.start[s]
        for pair in range(pair_start[s], pair_start[s + 1]):
            fault = winner = below = late_low = late_high = 0.0
            for i in range(m):
                share, r = positions[s, rows.position[s, i]], row + i
                won, under = float(rows.limits[0, r, 1]), float(rows.limits[0, r, 2])
                fault += share * float(rows.limits[0, r, 0])
                winner += share * won
                below += share * under
                late_low += share * (under - won) * rows.hurry[0, r, 0]
                late_high += share * (65536.0 - under) * rows.hurry[0, r, 1]
            limits[pair, 0], limits[pair, 1], limits[pair, 2] = fault, winner, below
            hurry[pair, 0] = late_low / (below - winner) if below > winner else 0.0
            hurry[pair, 1] = late_high / (65536.0 - below) if below < 65536.0 else 0.0
            row += m
