"""Thousands of rallies at once, both players' strokes given from outside: the striker's view."""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.arrays import F32, I16, I64, Bools, Ints
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.checks import checked_number
from shuttle_marl.kernel.compiling import compiled
from shuttle_marl.kernel.core import (
    BLOCK,
    Players,
    Tables,
    check_players,
    draw,
    draw_strokes,
    find_pair,
    first_pair,
    legal_count,
    list_where,
    new_block,
    pack,
    play,
    read_limits,
    reply_of,
    strike,
    table_choice,
    uniform_choice,
)
from shuttle_marl.kernel.rows import NO_OBSERVATIONS, Batch, Observations, Rows, Server, begin, in_slices, part_of, show

_NO_PLAYERS: Final = Players(np.empty((0, 0), np.uint16), np.empty((0, 0, 0), np.uint8))


@compiled
def _reset(rows: Rows, which: Bools, seed_key: np.uint64, server: int) -> None:
    for i in range(rows.state.size):
        if which[i]:
            begin(rows, i, seed_key, server)


@compiled
def _choose(tables: Tables, rows: Rows, players: Players, stroke: I64, first: int, last: int) -> None:
    for i in range(first, last):
        s = rows.state[i]
        k = table_choice(players, rows.striker[i], s, first_pair(tables, s), draw(rows.key[i], rows.stroke[i]))
        stroke[i] = tables.stroke[reply_of(tables, s, k)]


@compiled
def _step(
    tables: Tables,
    rows: Rows,
    rank: I16,
    reward: F32,
    done: Bools,
    observed: Observations,
    seed_key: np.uint64,
    server: int,
    reset: bool,
    first: int,
    last: int,
) -> None:
    block = new_block()
    for begin_block in range(first, last, BLOCK):
        end_block = min(begin_block + BLOCK, last)
        part = part_of(rows, begin_block, end_block)
        count = end_block - begin_block
        rewards, over = reward[begin_block:end_block], done[begin_block:end_block]
        strike(tables, part, rank[begin_block:end_block], block)
        for j in range(count):
            ends = block.outcome[j] < 2
            part.live[j] = not ends
            over[j] = ends
            rewards[j] = (2 * block.outcome[j] - 1) * ends
        if reset:
            for j in range(list_where(block, count, over=True)):
                begin(rows, begin_block + block.listed[j], seed_key, server)
        if observed.mask.shape[0] > 0:
            show(tables, rows, observed, begin_block, end_block)


@compiled
def _run(
    tables: Tables,
    rows: Rows,
    players: Players,
    tally: I64,
    seed_key: np.uint64,
    server: int,
    strokes: int,
    first: int,
    last: int,
) -> None:
    """Let rows play by themselves; ``tally`` counts rallies won by the striker, lost by the striker, won by seat 0.

    A block of rows stays in the first cache while it plays all its strokes.
    """
    tabulated = players.cumulative.shape[1] > 0
    block = new_block()
    for begin_block in range(first, last, BLOCK):
        part = part_of(rows, begin_block, min(begin_block + BLOCK, last))
        count = part.state.size
        for _ in range(strokes):
            draw_strokes(part, block.bits)
            if tabulated:
                for j in range(count):
                    s = part.state[j]
                    k = table_choice(players, part.striker[j], s, first_pair(tables, s), block.bits[j])
                    find_pair(tables, block, j, s, k)
            else:
                for j in range(count):
                    s = part.state[j]
                    find_pair(tables, block, j, s, uniform_choice(legal_count(tables, s), block.bits[j]))
            read_limits(tables, block, count)
            play(part, block)
            for i in range(list_where(block, count, over=True)):
                j = block.listed[i]
                won = block.outcome[j]
                tally[0] += won
                tally[1] += 1 - won
                tally[2] += part.striker[j] == won
                begin(rows, begin_block + j, seed_key, server)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tally:
    """Results of a batch that played by itself.

    Attributes:
        winners: rallies that ended on a winner.
        faults: rallies that ended on a fault.
        won_by_seat_0: rallies that seat 0 won.
    """

    winners: int
    faults: int
    won_by_seat_0: int


class RallyBatch(Batch):
    """B rallies in which every stroke is given from outside.

    Row b plays the rallies b, b + B, b + 2 B, … of its seed; the draws of rally r are those of episode r of
    ``rally_v0`` with that seed, so what happens in a rally depends on its number and its strokes alone.

    Args:
        game: the tables.
        batch: number of rows B.
        seed: names all draws.
        server: seat that serves, 0 or 1; None: at random.
        threads: threads that share the rows; never changes a result.
    """

    def __init__(self, game: Game, batch: int, *, seed: int = 0, server: Server = None, threads: int = 1) -> None:
        super().__init__(game, batch, server=server, threads=threads)
        self.reset(seed)

    def reset(self, seed: int | None = None, rows: Bools | None = None) -> None:
        """Start the next rally in some rows.

        Args:
            seed: begin again, with rally 0 of this seed; None: continue.
            rows: ``[B]`` which ones; None: all.
        """
        if seed is not None:
            self.reseed(seed)
        _reset(self.rows, self._chosen_rows(rows), self._seed_key, self._server)

    def policy_strokes(self, players: Players) -> I64:
        """``[B]`` the stroke of each row that a tabulated policy plays, by the draw of the stroke that is due.

        Args:
            players: those at seats 0 and 1, as :func:`~shuttle_marl.kernel.pack` packs them.

        Raises:
            KernelError: not two policies of this game.
        """
        check_players(players, self.game, 2)
        stroke = np.empty(len(self), np.int64)
        in_slices(lambda a, b: _choose(self._tables, self.rows, players, stroke, a, b), len(self), self.threads)
        return stroke

    def step(self, stroke: Ints, *, reset: bool = True, observed: Observations | None = None) -> tuple[F32, Bools]:
        """Play one stroke in every row.

        Args:
            stroke: ``[B]`` catalogue index of each striker's stroke.
            reset: whether rows whose rally is over begin their next one at once.
            observed: room for what each striker then sees; see :meth:`~shuttle_marl.kernel.rows.Batch.observe`.

        Returns:
            ``[B]`` float32 reward of the striker (+1 winner, -1 fault, 0 returned) and ``[B]`` whether the rally is over.

        Raises:
            IllegalStrokeError: a stroke is not legal, or a row is over; nothing has changed.
            KernelError: a wrong number of strokes, or room of another shape; nothing has changed.
        """
        if observed is not None:
            self._check(observed)
        rank = self._ranks(stroke)
        reward, done = np.empty(len(self), np.float32), np.empty(len(self), np.bool_)
        args = (self._tables, self.rows, rank, reward, done, observed or NO_OBSERVATIONS, self._seed_key, self._server, reset)
        in_slices(lambda a, b: _step(*args, a, b), len(self), self.threads)
        return reward, done

    def run(self, strokes: int, policies: tuple[TabulatedPolicy, TabulatedPolicy] | None = None) -> Tally:
        """Let every row play a number of strokes by itself, beginning rallies as they end.

        Args:
            strokes: strokes a row.
            policies: who plays at seats 0 and 1; None: both choose equally among the legal strokes.
        """
        strokes = checked_number("strokes", strokes, 0)
        players = pack(policies, self.game) if policies else _NO_PLAYERS
        tallies: list[I64] = []

        def work(first: int, last: int) -> None:
            tally = np.zeros(3, np.int64)
            tallies.append(tally)
            _run(self._tables, self.rows, players, tally, self._seed_key, self._server, strokes, first, last)

        in_slices(work, len(self), self.threads)
        winners, faults, seat_0 = np.sum(tallies, axis=0).tolist()
        return Tally(winners=winners, faults=faults, won_by_seat_0=seat_0)
