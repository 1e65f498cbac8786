"""Lower bound on the time of a stroke in any kernel for this game: its memory reads and writes alone.

The state and the legal pair of a stroke are unpredictable, so each stroke reads two tables at random positions. The positions are
recorded from play, because some strokes are common; the loop only reads, so the processor runs as many reads in parallel as it
can. With an observation, a row of the mask and seven numbers are copied as well.
"""

import dataclasses
from typing import Any, Final

import numba
import numpy as np

from shuttle_marl.base.arrays import I32, U64, Bools
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import RallyBatch
from shuttle_marl.kernel.core import tables_of
from shuttle_marl.kernel.rows import TOKENS, in_slices

_BATCH: Final = 8192
_STEPS: Final = 16


@numba.njit(nogil=True)
def _read(
    limits: U64,
    head: I32,
    pair: U64,
    state: U64,
    first: int,
    last: int,
) -> Any:
    a, b, c, d = np.uint64(0), np.int32(0), np.int32(0), np.int32(0)
    for i in range(first, last):
        a ^= limits[pair[i]]
        b ^= head[state[i], 0]
        c ^= head[state[i], 1]
        d ^= head[state[i], 2]
    return a, b, c, d


@numba.njit(nogil=True)
def _read_and_show(
    limits: U64,
    head: I32,
    pair: U64,
    state: U64,
    legal: Bools,
    mask: Bools,
    tokens: I32,
    first: int,
    last: int,
) -> Any:
    found = _read(limits, head, pair, state, first, last)
    n, rows = tokens.shape[0], legal.shape[1]
    for i in range(first, last):
        at = i % n
        tokens[at] = i
        row = legal[np.uint64(head[state[i], 3])]
        place = mask[at * rows : (at + 1) * rows]
        for j in range(rows):
            place[j] = row[j]
    return found


@dataclasses.dataclass(frozen=True, kw_only=True)
class LowerBound:
    """Minimum memory accesses of a stroke, recorded from play.

    Attributes:
        read_bytes: bytes of the two tables that a stroke reads.
        shown_bytes: bytes that are read and written for the observation of the striker.
        play: call to read what ``strokes`` strokes need.
        show: call to read it and to write the observations.
        strokes: strokes of a call.
    """

    read_bytes: int
    shown_bytes: int
    play: Any
    show: Any
    strokes: int


def lower_bound_of(game: Game, threads: int) -> LowerBound:
    """Record the reads of random play of a game, for timing."""
    tables = tables_of(game)
    batch = RallyBatch(game, _BATCH, seed=1)
    states, pairs = [], []
    for _ in range(_STEPS):
        stroke = batch.random_strokes()
        state = batch.rows.state.copy()
        states.append(game.base(state))
        level = game.effort(state) * np.int64(game.n_base_pairs)
        pairs.append(level + game.base_pair_start[game.base(state)] + game.rank(state, stroke))
        batch.step(stroke)
    pair, base_state = np.concatenate(pairs).astype(np.uint64), np.concatenate(states).astype(np.uint64)
    mask = np.empty(_BATCH * tables.mask.shape[1], np.bool_)
    tokens = np.empty((_BATCH, TOKENS), np.int32)
    limits, head = tables.limits, tables.head
    return LowerBound(
        read_bytes=tables.limits.itemsize + tables.head[0].nbytes,
        shown_bytes=2 * game.n_strokes + tokens[0].nbytes,
        play=lambda: in_slices(lambda a, b: _read(limits, head, pair, base_state, a, b), len(pair), threads),
        show=lambda: in_slices(
            lambda a, b: _read_and_show(limits, head, pair, base_state, tables.mask, mask, tokens, a, b), len(pair), threads
        ),
        strokes=len(pair),
    )
