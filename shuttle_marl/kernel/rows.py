"""A batch of rallies: its rows, their next rallies, and the observations of the strikers."""

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F32, I8, I16, I32, I64, U32, U64, Bools
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.base.errors import whole_number
from shuttle_marl.game.draws import POSITION_SHIFT
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.kernel import core
from shuttle_marl.kernel.core import BLOCK, Block, Tables

DRAWN: Final = -1  # the server is random
_LEAST_ROWS: Final = 1024  # fewest rows for which a thread is worthwhile

Server = Literal[0, 1] | None


class Rows(NamedTuple):
    """B rallies, each at its own stroke.

    Attributes:
        state: ``[B]`` int32 state of the striker; after the end of a rally the state that would follow its last stroke, contact
            below and not hurried.
    """

    state: I32
    striker: I8  # [B] seat of the striker
    stroke: I32  # [B] strokes played in this rally
    rally: I64  # [B] number of the rally; its draws follow from the seed and this number
    key: U64  # [B] key of the rally's draws
    live: Bools  # [B] whether the rally continues


class Tape(NamedTuple):
    """Strokes that were played since it was read, of each of B rows, if they are recorded.

    Attributes:
        code: ``[B, n]`` uint64 each stroke: the state that it leads to, contact below and not hurried, in the bits 0 to 31,
            outcome 32 to 34, number of the receiver's position 35 to 38, seat 39, opponent of the learner 40 to 47. Or the end
            of a rally that was cut off: :data:`CUT`, its reason 32 to 34, seat and opponent.
        score: ``[B, n]`` uint32 at the end of a rally of a match the score before it, 8 bits each: points of both seats, games of
            both seats. ``[B, 0]`` for rallies alone.
    """

    code: U64
    score: U32
    used: I32  # [B] number of strokes; beyond n they are lost


CUT: Final = np.uint64(1 << 48)  # bit of a note that is no stroke, but the end of a rally
_NOTES: Final = 61  # no power of two, so that rows do not compete for the same cache lines
_ALL_NOTES: Final = 1 << 17  # at least, in all rows: a reading costs some time for each call


def new_tape(batch: int, *, scored: bool) -> Tape:
    """An empty tape; it is to be read before half of it is full, because the rows may play several strokes in a step."""
    notes = max(_NOTES, _ALL_NOTES // batch | 1)
    return Tape(np.zeros((batch, notes), np.uint64), np.zeros((batch, notes * scored), np.uint32), np.zeros(batch, np.int32))


class Serving(NamedTuple):
    """Start of the next rallies."""

    seed_key: np.uint64  # key of the seed
    server: int  # seat that serves, or `DRAWN`
    reset: bool  # whether rows whose rally is over start the next one in the same step


def new_rows(batch: int) -> Rows:
    """Rows before their first rally: row b plays rallies b, b + B, b + 2 B, … Raises OptionError: fewer than one row."""
    batch = whole_number("batch", batch, 1)
    return Rows(
        state=np.zeros(batch, np.int32),
        striker=np.zeros(batch, np.int8),
        stroke=np.zeros(batch, np.int32),
        rally=np.arange(batch, dtype=np.int64) - batch,
        key=np.zeros(batch, np.uint64),
        live=np.zeros(batch, np.bool_),
    )


@inlined
def part_of(rows: Rows, first: int, last: int) -> Rows:
    """Views of rows ``first`` up to ``last``."""
    return Rows(
        rows.state[first:last], rows.striker[first:last], rows.stroke[first:last], rows.rally[first:last], rows.key[first:last],
        rows.live[first:last],
    )  # fmt: skip


@inlined
def move(rows: Rows, i: int, to: int) -> None:
    """Move the rally of row i to another row."""
    rows.state[to], rows.striker[to], rows.stroke[to] = rows.state[i], rows.striker[i], rows.stroke[i]
    rows.rally[to], rows.key[to] = rows.rally[i], rows.key[i]


@inlined
def begin(rows: Rows, i: int, serving: Serving) -> np.uint64:
    """Start the next rally of row i; returns its first draw."""
    rows.rally[i] += rows.rally.size
    key = core.extend(serving.seed_key, rows.rally[i])
    bits = core.draw(key, 0)
    rows.key[i] = key
    rows.state[i] = 0
    rows.stroke[i] = 0
    rows.live[i] = True
    rows.striker[i] = serving.server if serving.server >= 0 else core.first_server(bits)
    return bits


@inlined
def draw_strokes(part: Rows, bits: U64) -> None:
    """Write the draw of the next stroke of each row."""
    for j in range(part.key.size):
        bits[j] = core.draw(part.key[j], part.stroke[j])


@inlined
def play(tables: Tables, part: Rows, block: Block) -> None:
    """Strike in every row of a block, and hand over to the receiver."""
    core.strike(tables, part.state, block, part.state.size)
    for j in range(part.state.size):
        part.stroke[j] += 1
        part.striker[j] ^= 1


POSITION: Final = 3  # columns of `Tables.head` from the mask of strokes to that of positions
BOTH: Final = 4  # and to that of both


@inlined
def _asked(tables: Tables, rows: Rows, other: I8, i: int) -> int:
    """What is to be chosen in row i: 0 a stroke, ``POSITION`` or ``BOTH``; ``other``: opponents' seats, -1 without learners."""
    # Without a branch: one that holds tuples of arrays costs counts of their references, more than all the rest.
    return core.with_recovery(tables) * (POSITION * (rows.striker[i] == other[i]) + BOTH * (other[i] < 0))


@compiled
def find_ranks(tables: Tables, rows: Rows, other: I8, action: I64, rank: I16, first: int, last: int) -> None:
    """Write the rank of each stroke among the legal, of n + p among the feasible positions; -1: illegal, or the row is over."""
    n = tables.rank.shape[1]
    for i in range(first, last):
        rank[i] = -1
        if not rows.live[i]:
            continue
        if _asked(tables, rows, other, i) == POSITION:
            if n <= action[i] < n + N_POSITIONS:
                rank[i] = tables.place[core.base_of(tables, rows.state[i]), np.uint64(action[i] - n)]
        elif 0 <= action[i] < n:
            rank[i] = tables.rank[core.row_of(tables, rows.state[i]), np.uint64(action[i])]


@compiled
def find_places(tables: Tables, rows: Rows, position: I64, place: I16, first: int, last: int) -> None:
    """Write the number of each position among the feasible ones, -1 if it is none of them."""
    for i in range(first, last):
        base, found = core.base_of(tables, rows.state[i]), 0 <= position[i] < N_POSITIONS
        place[i] = tables.place[base, np.uint64(position[i])] if found else -1


TOKENS: Final = 7  # number of tokens of an observation; one more in the game with recovery


class Observations(NamedTuple):
    """Observations of the strikers of B rows.

    Attributes:
        tokens: ``[B, 7]`` int32: own last stroke, incoming stroke (n: none yet), contact offered (1: above the net), net shots
            in a row, own effort, the opponent's effort, whether hurried. With recovery ``[B, 8]``: 1 if the player is to choose
            a position; then "own" is of that player, contact and hurried are the striker's.
        mask: ``[B, n]`` bool legal strokes, with recovery ``[B, n + 9]``, followed by the feasible positions; without learners
            both are set. ``[0, 0]`` if observations are not wanted.
    """

    tokens: I32
    mask: Bools


NO_OBSERVATIONS: Final = Observations(np.empty((0, TOKENS), np.int32), np.empty((0, 0), np.bool_))


class Output(NamedTuple):
    """Results of a step."""

    reward: F32  # [B] float32
    done: Bools  # [B] whether the rally or match is over
    observed: Observations  # observations after the step, or `NO_OBSERVATIONS`


@inlined
def observe(tables: Tables, rows: Rows, other: I8, observed: Observations, first: int, last: int) -> None:
    """Write the observations of rows ``first`` up to ``last``."""
    n = observed.mask.shape[1]
    flat = observed.mask.reshape(observed.mask.size)
    for i in range(first, last):
        block, position = core.block_of(tables, rows.state[i]), np.uint64(_asked(tables, rows, other, i) == POSITION)
        edge = core.base_of(tables, rows.state[i]) >> np.uint64(2)
        observed.tokens[i, observed.tokens.shape[1] - 1] = position  # without recovery `hurried` takes its place below
        # A receiver sees the state from the other side.
        observed.tokens[i, position] = tables.own[edge]
        observed.tokens[i, np.uint64(1) - position] = tables.incoming[edge]
        observed.tokens[i, 2] = rows.state[i] & 1
        observed.tokens[i, 3] = tables.duel[edge]
        observed.tokens[i, np.uint64(4) + position] = tables.efforts[block, 0]
        observed.tokens[i, np.uint64(5) - position] = tables.efforts[block, 1]
        observed.tokens[i, 6] = core.hurried_in(rows.state[i])
    # Whole vectors are copied; the next row overwrites the padding. The last rows are exact, as no row follows them.
    width = tables.mask.shape[1]
    exact = max(first, last - (width + n - 1) // n + 1)
    for i in range(first, exact):
        legal = tables.mask[_shown(tables, rows, other, i)]
        row = flat[i * n : i * n + width]
        for j in range(width):
            row[j] = legal[j]
    for i in range(exact, last):
        flat[i * n : (i + 1) * n] = tables.mask[_shown(tables, rows, other, i), :n]


@inlined
def _shown(tables: Tables, rows: Rows, other: I8, i: int) -> np.uint64:
    """Row of ``mask`` of row i: what can be chosen."""
    return np.uint64(tables.head[core.base_of(tables, rows.state[i]), np.uint64(3 + _asked(tables, rows, other, i))])


@compiled
def observe_rows(tables: Tables, rows: Rows, other: I8, observed: Observations, first: int, last: int) -> None:
    """:func:`observe`, to be called uncompiled."""
    observe(tables, rows, other, observed, first, last)


@compiled
def choose_uniform(tables: Tables, rows: Rows, other: I8, action: I64, position: I64, first: int, last: int) -> None:
    """Write a random legal action and, with recovery, a random position of each of rows ``first`` up to ``last``."""
    block = core.new_block()
    for begin_block in range(first, last, BLOCK):
        part = part_of(rows, begin_block, min(begin_block + BLOCK, last))
        chosen = action[begin_block : begin_block + part.state.size]
        draw_strokes(part, block.bits)
        for j in range(part.state.size):
            legal = core.legal_strokes(tables, part.state[j])
            chosen[j] = core.stroke_of(tables, legal, core.uniform_choice(legal.n, block.bits[j]))
            waited = core.position_at(tables, part.state[j], core.uniform_choice(legal.choices, block.bits[j] << POSITION_SHIFT))
            position[begin_block + j] = waited
            if _asked(tables, rows, other, begin_block + j) == POSITION:
                chosen[j] = tables.rank.shape[1] + waited


@lru_cache(maxsize=4)
def _pool(threads: int, process: int) -> ThreadPoolExecutor:  # noqa: ARG001  threads do not survive a fork
    return ThreadPoolExecutor(threads, thread_name_prefix="shuttle_marl")


def in_slices(work: Callable[[int, int], Any], size: int, threads: int) -> None:
    """Call ``work(first, last)`` on slices of ``size`` rows, in up to ``threads`` threads."""
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
