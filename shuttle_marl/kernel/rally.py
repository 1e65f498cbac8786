"""Thousands of rallies at once in which every stroke of both players is given."""

import dataclasses

import numpy as np

from shuttle_marl.base.arrays import F32, I16, I64, Bools, Ints
from shuttle_marl.base.compiling import compiled
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.checks import checked_number
from shuttle_marl.kernel.core import (
    BLOCK,
    Tables,
    choose_stroke,
    draw,
    legal_strokes,
    list_where,
    new_block,
    read_limits,
    stroke_of,
    uniform_choice,
)
from shuttle_marl.kernel.players import Players, check_players, empty_players, pack, table_choice
from shuttle_marl.kernel.rows import (
    Batch,
    Observations,
    Output,
    Rows,
    Server,
    Serving,
    begin,
    draw_strokes,
    in_slices,
    observe,
    part_of,
    play,
    reward_strikers,
    strike,
)


@compiled
def _reset(rows: Rows, which: Bools, serving: Serving) -> None:
    for i in range(rows.state.size):
        if which[i]:
            begin(rows, i, serving)


@compiled
def _choose(tables: Tables, rows: Rows, players: Players, stroke: I64, first: int, last: int) -> None:
    for i in range(first, last):
        s = rows.state[i]
        legal = legal_strokes(tables, s)
        k = table_choice(players, rows.striker[i], s, legal.pair, draw(rows.key[i], rows.stroke[i]))
        stroke[i] = stroke_of(tables, legal, k)


@compiled
def _step(tables: Tables, rows: Rows, rank: I16, output: Output, serving: Serving, first: int, last: int) -> None:
    block = new_block()
    for begin_block in range(first, last, BLOCK):
        end_block = min(begin_block + BLOCK, last)
        part = part_of(rows, begin_block, end_block)
        over = output.done[begin_block:end_block]
        strike(tables, part, rank[begin_block:end_block], block)
        reward_strikers(block, output.reward[begin_block:end_block], over)
        for j in range(over.size):
            part.live[j] = not over[j]
        if serving.reset:
            for j in range(list_where(block, over.size, over=True)):
                begin(rows, begin_block + block.listed[j], serving)
        if output.observed.mask.shape[0] > 0:
            observe(tables, rows, output.observed, begin_block, end_block)


@compiled
def _run(tables: Tables, rows: Rows, players: Players, tally: I64, serving: Serving, strokes: int, first: int, last: int) -> None:
    """Let rows play by themselves; ``tally`` counts rallies won by the striker, lost by the striker, won by seat 0.

    A block of rows plays all its strokes while it is in the first-level cache.
    """
    tabulated = players.cumulative.shape[0] > 0
    block = new_block()
    for begin_block in range(first, last, BLOCK):
        part = part_of(rows, begin_block, min(begin_block + BLOCK, last))
        count = part.state.size
        for _ in range(strokes):
            draw_strokes(part, block.bits)
            if tabulated:
                for j in range(count):
                    s = part.state[j]
                    legal = legal_strokes(tables, s)
                    k = table_choice(players, part.striker[j], s, legal.pair, block.bits[j])
                    choose_stroke(tables, block, j, legal, k, part.striker[j])
            else:
                for j in range(count):
                    legal = legal_strokes(tables, part.state[j])
                    choose_stroke(tables, block, j, legal, uniform_choice(legal.n, block.bits[j]), part.striker[j])
            read_limits(tables, block, count)
            play(part, block)
            for i in range(list_where(block, count, over=True)):
                j = block.listed[i]
                won = block.outcome[j]
                tally[0] += won
                tally[1] += 1 - won
                tally[2] += part.striker[j] == won
                begin(rows, begin_block + j, serving)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tally:
    """Results of :meth:`RallyBatch.run`.

    Attributes:
        winners: rallies that ended on a winner.
        faults: rallies that ended on a fault.
        won_by_seat_0: rallies that seat 0 won.
    """

    winners: int
    faults: int
    won_by_seat_0: int


class RallyBatch(Batch):
    """B rallies in which every stroke is given.

    Row b plays rallies b, b + B, b + 2 B, … of the seed. Rally r has the draws of episode r of ``rally_v0`` with the same seed,
    so it depends on its number and its strokes alone.

    Args:
        game: the game.
        batch: number of rows B.
        seed: random seed.
        server: seat that serves, 0 or 1; None: random.
        threads: number of threads; does not change results.
    """

    def __init__(self, game: Game, batch: int, *, seed: int = 0, server: Server = None, threads: int = 1) -> None:
        super().__init__(game, batch, server=server, threads=threads)
        self.reset(seed)

    def reset(self, seed: int | None = None, rows: Bools | None = None) -> None:
        """Start the next rally in some rows.

        Args:
            seed: restart with rally 0 of this seed; None: continue.
            rows: ``[B]`` mask of rows; None: all.
        """
        if seed is not None:
            self.reseed(seed)
        _reset(self.rows, self._chosen_rows(rows), self._serving())

    def policy_strokes(self, players: Players) -> I64:
        """``[B]`` stroke of each row by tabulated policies and the draw of its next stroke.

        Args:
            players: policies at seats 0 and 1, packed by :func:`~shuttle_marl.kernel.pack`.

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
            reset: whether rows whose rally is over start the next one in the same step.
            observed: output arrays for the observations after the step; None: not wanted.

        Returns:
            ``[B]`` float32 reward of the striker (+1 winner, -1 fault, 0 returned) and ``[B]`` whether the rally is over.

        Raises:
            IllegalStrokeError: an illegal stroke, or a row that is over; the batch is unchanged.
            KernelError: arrays of wrong shape or dtype; the batch is unchanged.
        """
        output, rank, serving = self._output(observed), self._ranks(stroke), self._serving(reset=reset)
        in_slices(lambda a, b: _step(self._tables, self.rows, rank, output, serving, a, b), len(self), self.threads)
        return output.reward, output.done

    def run(self, strokes: int, policies: tuple[TabulatedPolicy, TabulatedPolicy] | None = None) -> Tally:
        """Let every row play a number of strokes by itself; rallies that end are followed by the next.

        Args:
            strokes: number of strokes per row.
            policies: policies at seats 0 and 1; None: both play random legal strokes.
        """
        strokes = checked_number("strokes", strokes, 0)
        players = pack(policies, self.game) if policies else empty_players(self.game, 0)
        tallies, serving = list[I64](), self._serving()

        def work(first: int, last: int) -> None:
            tally = np.zeros(3, np.int64)
            tallies.append(tally)
            _run(self._tables, self.rows, players, tally, serving, strokes, first, last)

        in_slices(work, len(self), self.threads)
        winners, faults, seat_0 = np.sum(tallies, axis=0).tolist()
        return Tally(winners=winners, faults=faults, won_by_seat_0=seat_0)
