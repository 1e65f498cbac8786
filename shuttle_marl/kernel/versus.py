"""Thousands of rallies against tabulated opponents: one step is the learner's stroke and the opponent's reply."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from shuttle_marl.arrays import F32, I8, I16, I32, I64, Bools, Ints
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.checks import KernelError, checked_array
from shuttle_marl.kernel.compiling import compiled, inlined
from shuttle_marl.kernel.core import (
    BLOCK,
    Players,
    Tables,
    arrival_of,
    draw,
    find_pair,
    first_pair,
    list_where,
    new_block,
    next_state,
    outcome_of,
    pack,
    put,
    read_limits,
    reply_of,
    strike,
    table_choice,
)
from shuttle_marl.kernel.rows import NO_OBSERVATIONS, Batch, Observations, Rows, Server, begin, in_slices, part_of, show


class Opponents(NamedTuple):
    """Opponents of a learner, row by row.

    Attributes:
        players: the K opponents.
        seat: ``[B]`` int8 seat of the learner.
        opponent: ``[B]`` int32 opponent of the rally that is being played.
        following: ``[B]`` int32 opponent of the rallies that begin from now on.
        unseen: ``[B, 2]`` int64 rallies that ended on the opponent's serve: won, lost by the learner.
    """

    players: Players
    seat: I8
    opponent: I32
    following: I32
    unseen: I64


@inlined
def _begin_rally(tables: Any, rows: Any, opponents: Any, i: Any, seed_key: Any, server: Any) -> Any:
    """Begin the next rally of a row, up to the learner's first stroke; returns the outcome of the stroke before it, which is
    that of an opponent's serve, or 2 where there is none."""
    bits = begin(rows, i, seed_key, server)
    opponents.opponent[i] = opponents.following[i]
    if rows.striker[i] == opponents.seat[i]:
        return np.int64(2)
    start = first_pair(tables, 0)
    k = table_choice(opponents.players, opponents.opponent[i], 0, start, bits)
    outcome = outcome_of(tables.limits[start + k], bits)
    rows.state[i] = next_state(arrival_of(tables, np.uint64(0), reply_of(tables, 0, k)), outcome)
    rows.stroke[i] = 1
    rows.striker[i] = opponents.seat[i]
    rows.live[i] = outcome >= 2
    if outcome < 2:
        opponents.unseen[i, outcome] += 1
    return outcome


@inlined
def _begin_learner(tables: Any, rows: Any, opponents: Any, i: Any, seed_key: Any, server: Any) -> None:
    """Begin rallies until one comes to the learner."""
    while _begin_rally(tables, rows, opponents, i, seed_key, server) < 2:
        pass


@compiled
def _reset(tables: Tables, rows: Rows, opponents: Opponents, which: Bools, seed_key: np.uint64, server: int) -> None:
    for i in range(rows.state.size):
        if which[i]:
            _begin_learner(tables, rows, opponents, i, seed_key, server)


@compiled
def _step(
    tables: Tables,
    rows: Rows,
    opponents: Opponents,
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
        opponent = opponents.opponent[begin_block:end_block]
        rewards, over = reward[begin_block:end_block], done[begin_block:end_block]
        strike(tables, part, rank[begin_block:end_block], block)
        for j in range(count):
            ends = block.outcome[j] < 2
            over[j] = ends
            rewards[j] = (2 * block.outcome[j] - 1) * ends
        # From here on the first entries of a block belong to the rows that are listed: those with a reply.
        replies = list_where(block, count, over=False)
        for r in range(replies):
            at = np.uint64(block.listed[r])
            block.bits[r] = draw(part.key[at], part.stroke[at])
        for r in range(replies):
            at = np.uint64(block.listed[r])
            s = part.state[at]
            k = table_choice(opponents.players, opponent[at], s, first_pair(tables, s), block.bits[r])
            find_pair(tables, block, r, s, k)
        read_limits(tables, block, replies)
        for r in range(replies):
            at = np.uint64(block.listed[r])
            outcome = outcome_of(block.limits[r], block.bits[r])
            ends = outcome < 2
            part.state[at] = next_state(block.arrival[r], outcome)
            part.stroke[at] += 1
            part.striker[at] ^= 1
            over[at] = ends
            rewards[at] = (1 - 2 * outcome) * ends
        for j in range(count):
            part.live[j] = not over[j]
            if reset and over[j]:
                _begin_learner(tables, rows, opponents, begin_block + j, seed_key, server)
        if observed.mask.shape[0] > 0:
            show(tables, rows, observed, begin_block, end_block)


class AgainstBatch(Batch):
    """Base of batches of a learner against opponents that play from tables.

    Args:
        game: the tables.
        batch: number of rows B.
        opponents: K opponents, tabulated for this game; row b meets opponent b modulo K.
        seat: seat of the learner, 0 or 1, for all rows or each ``[B]``.
        server: seat that serves, 0 or 1; None: at random.
        threads: threads that share the rows; never changes a result.

    Raises:
        KernelError: no opponent, one of another game, or a seat that is neither 0 nor 1.
    """

    def __init__(
        self,
        game: Game,
        batch: int,
        *,
        opponents: Sequence[TabulatedPolicy],
        seat: int | Ints,
        server: Server,
        threads: int,
    ) -> None:
        super().__init__(game, batch, server=server, threads=threads)
        seats = np.asarray(seat)
        if seats.shape not in ((), (batch,)) or not np.isin(seats, (0, 1)).all():
            raise KernelError(f"seat {seat!r}: expected 0 or 1, or an array of them of shape ({batch},)")
        players = pack(opponents, game)
        assigned = (np.arange(batch) % len(opponents)).astype(np.int32)
        self.opponents = Opponents(
            players=players,
            seat=np.broadcast_to(seats, batch).astype(np.int8),
            opponent=assigned.copy(),
            following=assigned,
            unseen=np.zeros((batch, 2), np.int64),
        )

    @property
    def n_opponents(self) -> int:
        """Number of opponents K."""
        return len(self.opponents.players.cumulative)

    @property
    def unseen(self) -> tuple[int, int]:
        """Rallies that ended on the opponent's serve since the last seed was given: won and lost by the learner."""
        won, lost = self.opponents.unseen.sum(axis=0).tolist()
        return won, lost

    def assign(self, opponent: Ints) -> None:
        """Say which opponent each row meets in the rallies that it begins from now on.

        Args:
            opponent: ``[B]`` numbers from 0 to K - 1.

        Raises:
            KernelError: a number that is none of an opponent.
        """
        self.opponents.following[:] = checked_array("opponents", opponent, np.int32, (len(self),), 0, self.n_opponents - 1)

    def replace_opponent(self, number: int, policy: TabulatedPolicy) -> None:
        """Put another policy in the place of an opponent; rallies that are being played continue against it.

        Raises:
            KernelError: a policy of another game, or no such opponent.
        """
        put(self.opponents.players, number, policy, self.game)


class VersusBatch(AgainstBatch):
    """B rallies of a learner against opponents that play from tables.

    Row b plays the rallies b, b + B, b + 2 B, … of its seed, with the draws of ``rally_v0``: the lower half of a draw
    decides a stroke's outcome, the upper half which stroke an opponent plays. A rally that ends on the opponent's serve
    never comes to the learner: it is counted in :attr:`unseen`, and the row continues with its next rally.

    Args:
        game: the tables.
        batch: number of rows B.
        opponents: K opponents, tabulated for this game; row b meets opponent b modulo K.
        seed: names all draws.
        seat: seat of the learner, 0 or 1, for all rows or each ``[B]``. It only says which half of the draws for the first
            serve is the learner's.
        server: seat that serves, 0 or 1; None: at random.
        threads: threads that share the rows; never changes a result.

    Raises:
        KernelError: no opponent, one of another game, or a seat that is neither 0 nor 1.
    """

    def __init__(
        self,
        game: Game,
        batch: int,
        *,
        opponents: Sequence[TabulatedPolicy],
        seed: int = 0,
        seat: int | Ints = 0,
        server: Server = None,
        threads: int = 1,
    ) -> None:
        super().__init__(game, batch, opponents=opponents, seat=seat, server=server, threads=threads)
        self.reset(seed)

    def reseed(self, seed: int) -> None:
        """Let every row begin with the first of its rallies of another seed when it begins its next one."""
        super().reseed(seed)
        self.opponents.unseen[:] = 0

    def reset(self, seed: int | None = None, rows: Bools | None = None) -> None:
        """Start the next rally in some rows, up to the learner's first stroke.

        Args:
            seed: begin again, with rally 0 of this seed; None: continue.
            rows: ``[B]`` which ones; None: all.
        """
        if seed is not None:
            self.reseed(seed)
        which = self._chosen_rows(rows)
        _reset(self._tables, self.rows, self.opponents, which, self._seed_key, self._server)

    def step(self, stroke: Ints, *, reset: bool = True, observed: Observations | None = None) -> tuple[F32, Bools]:
        """Play the learner's stroke and the opponent's reply in every row.

        Args:
            stroke: ``[B]`` catalogue index of the learner's stroke.
            reset: whether rows whose rally is over begin their next one at once.
            observed: room for what the learner then sees; see :meth:`~shuttle_marl.kernel.rows.Batch.observe`.

        Returns:
            ``[B]`` float32 reward of the learner (+1 won, -1 lost, 0 the rally continues) and ``[B]`` whether it is over.

        Raises:
            IllegalStrokeError: a stroke is not legal, or a row is over; nothing has changed.
            KernelError: a wrong number of strokes, or room of another shape; nothing has changed.
        """
        if observed is not None:
            self._check(observed)
        rank = self._ranks(stroke)
        reward, done = np.empty(len(self), np.float32), np.empty(len(self), np.bool_)
        args = (
            self._tables,
            self.rows,
            self.opponents,
            rank,
            reward,
            done,
            observed or NO_OBSERVATIONS,
            self._seed_key,
            self._server,
            reset,
        )
        in_slices(lambda a, b: _step(*args, a, b), len(self), self.threads)
        return reward, done
