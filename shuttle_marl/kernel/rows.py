"""A batch of rallies: its rows, how a row begins its next rally, and what the strikers observe."""

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from shuttle_marl.arrays import I8, I16, I32, I64, U64, Bools, Ints
from shuttle_marl.game import draws
from shuttle_marl.game.rules import IllegalStrokeError
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel.checks import KernelError, check_room, checked_array, checked_number
from shuttle_marl.kernel.compiling import compiled, inlined
from shuttle_marl.kernel.core import (
    BLOCK,
    Tables,
    base_of,
    block_of,
    draw,
    draw_strokes,
    extend,
    first_server,
    legal_count,
    new_block,
    reply_of,
    row_of,
    tables_of,
    uniform_choice,
)

DRAWN: Final = -1
"""The seat that serves is drawn at random."""
_LEAST_ROWS: Final = 1024
"""A slice of fewer rows costs less than handing it to a thread."""

Server = Literal[0, 1] | None


class Rows(NamedTuple):
    """B rallies, each at a stroke of its own.

    Attributes:
        state: ``[B]`` int32 state of the striker; where a rally is over, the state after its last stroke, contact below.
        striker: ``[B]`` int8 seat of the striker.
        stroke: ``[B]`` int32 strokes played in this rally.
        rally: ``[B]`` int64 number of the rally, which with the seed names its draws.
        key: ``[B]`` uint64 key of the rally's draws.
        live: ``[B]`` bool whether the rally continues.
    """

    state: I32
    striker: I8
    stroke: I32
    rally: I64
    key: U64
    live: Bools


def new_rows(batch: int) -> Rows:
    """Rows before their first rally: row b plays the rallies b, b + B, b + 2 B, …

    Raises:
        KernelError: fewer than one row.
    """
    batch = checked_number("batch", batch, 1)
    return Rows(
        state=np.zeros(batch, np.int32),
        striker=np.zeros(batch, np.int8),
        stroke=np.zeros(batch, np.int32),
        rally=np.arange(batch, dtype=np.int64) - batch,
        key=np.zeros(batch, np.uint64),
        live=np.zeros(batch, np.bool_),
    )


@inlined
def part_of(rows: Any, first: Any, last: Any) -> Any:
    """The rows ``first`` up to ``last``, in place."""
    return Rows(
        rows.state[first:last],
        rows.striker[first:last],
        rows.stroke[first:last],
        rows.rally[first:last],
        rows.key[first:last],
        rows.live[first:last],
    )


@inlined
def begin(rows: Any, i: Any, seed_key: Any, server: Any) -> Any:
    """Start the next rally of row i; returns its first draw."""
    rows.rally[i] += rows.rally.size
    key = extend(seed_key, rows.rally[i])
    bits = draw(key, 0)
    rows.key[i] = key
    rows.state[i] = 0
    rows.stroke[i] = 0
    rows.live[i] = True
    rows.striker[i] = server if server >= 0 else first_server(bits)
    return bits


@compiled
def find_ranks(tables: Tables, rows: Rows, stroke: I64, rank: I16, first: int, last: int) -> int:
    """Position of each stroke among the legal ones; returns the first row where it has none or is over, else -1."""
    n = tables.rank.shape[1]
    for i in range(first, last):
        if not rows.live[i] or stroke[i] < 0 or stroke[i] >= n:
            return i
        rank[i] = tables.rank[row_of(tables, rows.state[i]), np.uint64(stroke[i])]
        if rank[i] < 0:
            return i
    return -1


TOKENS: Final = 6
"""Numbers in an observation."""


class Observations(NamedTuple):
    """Observations of the strikers of B rows; without rows where no one asks.

    Attributes:
        tokens: ``[B, 6]`` int32: own last stroke, incoming stroke (n: none yet), contact offered (1: above the net), net shots
            in a row, own effort, the opponent's effort.
        mask: ``[B, n]`` bool legal strokes.
    """

    tokens: I32
    mask: Bools


NO_OBSERVATIONS: Final = Observations(np.empty((0, TOKENS), np.int32), np.empty((0, 0), np.bool_))
"""For steps whose observations no one asks for."""


@inlined
def show(tables: Any, rows: Any, observed: Any, first: Any, last: Any) -> None:
    """Write what the strikers of rows ``first`` up to ``last`` see."""
    n = observed.mask.shape[1]
    flat = observed.mask.reshape(observed.mask.size)
    for i in range(first, last):
        block = block_of(tables, rows.state[i])
        edge = base_of(tables, rows.state[i]) >> np.uint64(1)
        observed.tokens[i, 0] = tables.own[edge]
        observed.tokens[i, 1] = tables.incoming[edge]
        observed.tokens[i, 2] = rows.state[i] & 1
        observed.tokens[i, 3] = tables.duel[edge]
        observed.tokens[i, 4] = tables.efforts[block, 0]
        observed.tokens[i, 5] = tables.efforts[block, 1]
    # Whole vectors, of which the next row overwrites what is too much; what lies behind the last row is not ours to write.
    width = tables.mask.shape[1]
    exact = max(first, last - (width + n - 1) // n + 1)
    for i in range(first, exact):
        legal = tables.mask[row_of(tables, rows.state[i])]
        place = flat[i * n : i * n + width]
        for j in range(width):
            place[j] = legal[j]
    for i in range(exact, last):
        flat[i * n : (i + 1) * n] = tables.mask[row_of(tables, rows.state[i]), :n]


@compiled
def _show(tables: Tables, rows: Rows, observed: Observations, first: int, last: int) -> None:
    show(tables, rows, observed, first, last)


@compiled
def choose_uniform(tables: Tables, rows: Rows, stroke: I64, first: int, last: int) -> None:
    """A legal stroke for each of the rows ``first`` up to ``last``, equally likely."""
    block = new_block()
    for begin_block in range(first, last, BLOCK):
        part = part_of(rows, begin_block, min(begin_block + BLOCK, last))
        chosen = stroke[begin_block : begin_block + part.state.size]
        draw_strokes(part, block.bits)
        for j in range(part.state.size):
            s = part.state[j]
            k = uniform_choice(legal_count(tables, s), block.bits[j])
            chosen[j] = tables.stroke[reply_of(tables, s, k)]


@lru_cache(maxsize=4)
def _pool(threads: int, process: int) -> ThreadPoolExecutor:  # noqa: ARG001  threads do not survive a fork
    return ThreadPoolExecutor(threads, thread_name_prefix="shuttle_marl")


def in_slices(work: Callable[[int, int], Any], size: int, threads: int) -> None:
    """Call ``work(first, last)`` on slices of ``size`` rows, side by side on as many threads."""
    threads = min(threads, size // _LEAST_ROWS)
    if threads <= 1:
        work(0, size)
        return
    bounds = np.linspace(0, size, threads + 1).astype(int).tolist()
    pool = _pool(threads - 1, os.getpid())
    others = [pool.submit(work, first, last) for first, last in itertools.pairwise(bounds[1:])]
    work(bounds[0], bounds[1])
    for other in others:
        other.result()


class Batch:
    """Base of :class:`~shuttle_marl.kernel.RallyBatch` and :class:`~shuttle_marl.kernel.VersusBatch`."""

    def __init__(self, game: Game, batch: int, *, server: Server, threads: int) -> None:
        if server not in (None, 0, 1):
            raise KernelError(f"server {server!r}: expected 0, 1, or None to draw it at random")
        self.game = game
        self._tables = tables_of(game)
        self.rows = new_rows(batch)
        self.threads = checked_number("threads", threads, 1)
        self._server = DRAWN if server is None else int(server)

    def __len__(self) -> int:
        return len(self.rows.state)

    def reseed(self, seed: int) -> None:
        """Let every row begin with the first of its rallies of another seed when it begins its next one."""
        self._seed_key = draws.stream(seed)[0]
        self.rows.rally[:] = np.arange(len(self)) - len(self)

    def new_observations(self) -> Observations:
        """Room for what the strikers see."""
        return Observations(np.empty((len(self), TOKENS), np.int32), np.empty((len(self), self.game.n_strokes), np.bool_))

    def observe(self, observed: Observations) -> None:
        """Write what each striker sees now.

        Raises:
            KernelError: room of another shape or type.
        """
        self._check(observed)
        in_slices(lambda a, b: _show(self._tables, self.rows, observed, a, b), len(self), self.threads)

    def _check(self, observed: Observations) -> None:
        check_room("tokens", observed.tokens, np.int32, (len(self), TOKENS))
        check_room("mask", observed.mask, np.bool_, (len(self), self.game.n_strokes))

    def _chosen_rows(self, rows: Bools | None) -> Bools:
        """``[B]`` which rows were asked for, all for None.

        Raises:
            KernelError: no mask of the rows.
        """
        return np.ones(len(self), np.bool_) if rows is None else checked_array("rows", rows, np.bool_, (len(self),))

    def random_strokes(self) -> I64:
        """``[B]`` a legal stroke for each row, equally likely, by the draw of the stroke that is due."""
        stroke = np.empty(len(self), np.int64)
        in_slices(lambda a, b: choose_uniform(self._tables, self.rows, stroke, a, b), len(self), self.threads)
        return stroke

    def _ranks(self, stroke: Ints) -> I16:
        """``[B]`` position of each stroke among the legal ones.

        Raises:
            KernelError: a wrong number of strokes, or numbers that are not whole.
            IllegalStrokeError: a stroke that is not legal.
        """
        wanted = checked_array("strokes", stroke, np.int64, (len(self),))
        rank = np.empty(len(self), np.int16)
        found: list[int] = []

        def find(first: int, last: int) -> None:
            found.append(find_ranks(self._tables, self.rows, wanted, rank, first, last))

        in_slices(find, len(self), self.threads)
        wrong = [row for row in found if row >= 0]
        if wrong:
            self._refuse(min(wrong), int(wanted[min(wrong)]))
        return rank

    def _refuse(self, row: int, stroke: int) -> None:
        if not self.rows.live[row]:
            raise IllegalStrokeError(f"row {row}: its rally is over; reset it first", stroke, row)
        names = self.game.catalogue.names
        if not 0 <= stroke < len(names):
            raise IllegalStrokeError(f"row {row}: {stroke} is no stroke; expected 0 to {len(names) - 1}", stroke, row)
        where = self.game.describe(int(self.rows.state[row]))
        raise IllegalStrokeError(f"row {row}: stroke {stroke} ({names[stroke]}) is not legal in state: {where}", stroke, row)
