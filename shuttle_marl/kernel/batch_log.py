"""A batch that keeps what it plays: every rally with all its strokes, also those of opponents."""

from typing import NamedTuple

import numpy as np

from shuttle_marl.arrays import F32, I8, I32, I64, U8, Bools, Floats, Ints, UInts
from shuttle_marl.game.rules import FAULT, WINNER
from shuttle_marl.kernel.compiling import compiled
from shuttle_marl.kernel.core import Tables, base_of, tables_of
from shuttle_marl.kernel.rally import RallyBatch
from shuttle_marl.kernel.rows import Rows
from shuttle_marl.kernel.uncompiled import KernelError, SingleRallies, stroke_type
from shuttle_marl.kernel.versus import VersusBatch

_ROOM = 64
"""First guess of the strokes that a row keeps; there is more room where it needs more."""


class _Strokes(NamedTuple):
    """Strokes of B rows, in the order in which they were played, up to those of the running rally.

    Attributes:
        length: ``[B]`` int32 strokes that are kept.
        running: ``[B]`` int32 those of them that belong to the running rally.
        stroke: ``[B, N]`` their catalogue indices.
        extra: ``[E, B, N]`` float32 what was given with them, NaN for strokes of opponents.
    """

    length: I32
    running: I32
    stroke: UInts
    extra: F32


class _Ended(NamedTuple):
    """Room for rallies that ended: their row, and what :class:`SingleRallies` says of them."""

    row: I32
    rally: I64
    opponent: I32
    server: U8
    winner: U8
    reason: U8
    length: I32


@compiled
def _keep(
    tables: Tables,
    rows: Rows,
    seat: I8,
    opponent: I32,
    reward: F32,
    over: Bools,
    given: F32,
    kept: _Strokes,
    ended: _Ended,
    count: int,
) -> int:
    """Keep the one or two strokes that were played in each row since the last call; returns how many rallies ended by now, or
    -1 - i where more were played in row i.

    The last stroke and the one before it are the edge of the present state. ``given`` ``[E, B]`` belongs to the first of them.
    """
    for i in range(rows.state.size):
        new = rows.stroke[i] - kept.running[i]
        if new == 0:
            continue
        if new < 0 or new > 2:
            return -1 - i
        edge, at = base_of(tables, rows.state[i]) >> np.uint64(1), kept.length[i]
        kept.stroke[i, at] = tables.own[edge] if new == 2 else tables.incoming[edge]
        kept.stroke[i, at + new - 1] = tables.incoming[edge]
        for e in range(kept.extra.shape[0]):
            kept.extra[e, i, at + new - 1] = np.nan
            kept.extra[e, i, at] = given[e, i]
        kept.length[i] += new
        kept.running[i] = rows.stroke[i]
        if over[i]:
            last = 1 - rows.striker[i]
            paid = last if seat[i] < 0 else seat[i]
            winner = paid if reward[i] > 0 else 1 - paid
            ended.row[count], ended.rally[count], ended.opponent[count] = i, rows.rally[i], opponent[i]
            ended.server[count] = (last + rows.stroke[i] - 1) & 1
            ended.winner[count], ended.reason[count] = winner, WINNER if winner == last else FAULT
            ended.length[count] = rows.stroke[i]
            kept.running[i] = 0
            count += 1
    return count


@compiled
def _take(kept: _Strokes, stroke: UInts, extra: F32) -> None:
    """Move the strokes of rallies that ended out, row after row, and those of running rallies to the front."""
    n = 0
    for i in range(kept.length.size):
        over = kept.length[i] - kept.running[i]
        for j in range(over):
            stroke[n + j] = kept.stroke[i, j]
        for j in range(kept.running[i]):
            kept.stroke[i, j] = kept.stroke[i, over + j]
        for e in range(extra.shape[0]):
            for j in range(over):
                extra[e, n + j] = kept.extra[e, i, j]
            for j in range(kept.running[i]):
                kept.extra[e, i, j] = kept.extra[e, i, over + j]
        kept.length[i] = kept.running[i]
        n += over


class BatchLog:
    """Plays the rallies of a batch and keeps them.

    Given the strokes that a learner played in a batch of the same seed, it plays the same rallies: so it also tells what the
    learner never saw, the strokes that ended its rallies and the rallies that ended on an opponent's serve.

    Args:
        batch: plays; it belongs to the log from now on.
        seed: names all draws; the batch begins with rally 0.
        extra: number E of figures that are given, and kept, with every stroke.
    """

    def __init__(self, batch: RallyBatch | VersusBatch, *, seed: int = 0, extra: int = 0) -> None:
        self.batch, size = batch, len(batch)
        self._seat, self._opponent = np.full(size, -1, np.int8), np.zeros(size, np.int32)
        if isinstance(batch, VersusBatch):
            self._seat, self._opponent = batch.opponents.seat, batch.opponents.opponent
        self._kept = _Strokes(
            length=np.zeros(size, np.int32),
            running=np.zeros(size, np.int32),
            stroke=np.empty((size, _ROOM), stroke_type(batch.game)),
            extra=np.empty((extra, size, _ROOM), np.float32),
        )
        self._none = np.full((extra, size), np.nan, np.float32)
        self._ended = _Ended(*(np.empty(2 * size, type_) for type_ in ("i4", "i8", "i4", "u1", "u1", "u1", "i4")))
        self._rallies = self._longest = 0
        """Rallies that ended and were not taken; no row keeps more strokes than so many."""
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Begin again, with rally 0 of a seed; what was not taken is dropped."""
        self._rallies = 0
        self._kept.length[:] = self._kept.running[:] = 0
        self.batch.reseed(seed)
        self._serve(np.ones(len(self.batch), np.bool_))

    def play(self, stroke: Ints, extra: Floats | None = None) -> F32:
        """Play T strokes in every row, as :meth:`~shuttle_marl.kernel.VersusBatch.step` does, and keep them.

        Args:
            stroke: ``[B, T]`` catalogue index of the strokes.
            extra: ``[E, B, T]`` figures that belong to them.

        Returns:
            ``[B, T]`` the rewards.

        Raises:
            IllegalStrokeError: a stroke is not legal; the strokes before it were played.
            KernelError: shapes that do not fit.
        """
        n_figures, size = len(self._kept.extra), len(self.batch)
        steps = stroke.shape[1] if stroke.ndim == 2 else 0
        given = np.empty((n_figures, size, steps), np.float32) if extra is None and not n_figures else np.asarray(extra)
        if stroke.shape != (size, steps) or given.shape != (n_figures, size, steps):
            raise KernelError(
                f"strokes of shape {stroke.shape} with figures of shape {given.shape}: "
                f"expected ({size}, T) and ({n_figures}, {size}, T)"
            )
        # Step after step in memory.
        strokes, figures = np.ascontiguousarray(stroke.T), np.ascontiguousarray(given.transpose(2, 0, 1), np.float32)
        rewards = np.empty((steps, size), np.float32)
        for t in range(steps):
            rewards[t], over = self.batch.step(strokes[t], reset=False)
            self._keep(rewards[t], over, figures[t])
            self._serve(over)
        return rewards.T

    def take(self) -> SingleRallies:
        """The rallies that ended since the last call, row after row."""
        count, kept = self._rallies, self._kept
        strokes = int(kept.length.sum() - kept.running.sum())
        stroke = np.empty(strokes, kept.stroke.dtype)
        extra = np.empty((len(kept.extra), strokes), np.float32)
        _take(kept, stroke, extra)
        order = np.argsort(self._ended.row[:count], kind="stable")
        ended = {name: column[order] for name, column in self._ended._asdict().items() if name != "row"}
        self._rallies = 0
        return SingleRallies(**ended, stroke=stroke, extra=extra)

    def _serve(self, over: Bools) -> None:
        """Begin rallies where they are over, until all rows wait for a stroke."""
        while np.count_nonzero(over):
            reward, over = self.batch.serve(over)
            self._keep(reward, over, self._none)

    def _keep(self, reward: F32, over: Bools, given: Floats) -> None:
        kept, size = self._kept, len(self.batch)
        self._longest += 2
        if self._longest > kept.stroke.shape[1]:
            self._longest = int(kept.length.max()) + 2
        if self._longest > kept.stroke.shape[1]:
            more = [(0, 0), (0, kept.stroke.shape[1])]
            self._kept = kept = kept._replace(stroke=np.pad(kept.stroke, more), extra=np.pad(kept.extra, [(0, 0), *more]))
        if self._rallies + size > len(self._ended.row):
            self._ended = _Ended(**{name: np.pad(column, (0, len(column))) for name, column in self._ended._asdict().items()})
        rows, tables = self.batch.rows, tables_of(self.batch.game)
        count = _keep(tables, rows, self._seat, self._opponent, reward, over, given, kept, self._ended, self._rallies)
        if count < 0:
            raise KernelError(f"row {-1 - count}: was played past its log; step the batch by play() of the log alone")
        self._rallies = count
