"""Many matches against tabulated opponents: one step is the learner's stroke and what the opponent plays until the next one."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.arrays import F32, I8, I32, I64, U64, Bools, Ints
from shuttle_marl.game import draws
from shuttle_marl.game.scoring import BWF, Numbers, Rules, count_rally
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.checks import checked_array
from shuttle_marl.kernel.compiling import compiled, inlined
from shuttle_marl.kernel.core import (
    Tables,
    arrival_of,
    block_of,
    draw,
    extend,
    first_pair,
    first_server,
    next_state,
    outcome_of,
    reply_of,
    row_of,
    table_choice,
)
from shuttle_marl.kernel.rows import Rows, Server, in_slices
from shuttle_marl.kernel.versus import AgainstBatch, Opponents

ILLEGAL: Final = 2
"""Reason of the end of a match that was lost by an illegal stroke; 0 and 1 are the fault and the winner of the last stroke."""

_count_rally = inlined(count_rally)


class MatchRows(NamedTuple):
    """The matches of B rows, beside their rallies.

    Attributes:
        match: ``[B]`` int64 number of the match, which with the seed names its draws.
        key: ``[B]`` uint64 key of the match's draws.
        rally: ``[B]`` int64 number of the rally in its match.
        points: ``[B, 2]`` int32 points of the seats in the current game; of a match that is over, in its last one.
        games: ``[B, 2]`` int32 games of the seats.
        server: ``[B]`` int8 seat that serves the rally; of a match that is over, its winner.
        owed: ``[B]`` float32 reward for rallies that ended before the learner's first stroke.
        reason: ``[B]`` int8 how the last rally ended.
    """

    match: I64
    key: U64
    rally: I64
    points: I32
    games: I32
    server: I8
    owed: F32
    reason: I8


@inlined
def _begin_rally(rows: Any, matches: Any, i: Any, server: Any) -> None:
    rows.key[i] = extend(matches.key[i], matches.rally[i])
    rows.state[i] = 0
    rows.stroke[i] = 0
    rows.striker[i] = server
    matches.server[i] = server


@inlined
def _stroke(tables: Any, rows: Any, i: Any, k: Any, bits: Any) -> Any:
    """Play the k-th legal stroke of a row's state; returns its outcome."""
    s = rows.state[i]
    block = block_of(tables, s)
    head = tables.head[np.uint64(s - tables.first[block, 0])]
    outcome = outcome_of(tables.limits[np.uint64(head[0] + k + tables.first[block, 2])], bits)
    rows.state[i] = next_state(arrival_of(tables, block, reply_of(tables, s, k)), outcome)
    rows.stroke[i] += 1
    rows.striker[i] ^= 1
    return outcome


@inlined
def _reply(tables: Any, rows: Any, opponents: Any, i: Any) -> Any:
    """Play the opponent's stroke; returns its outcome."""
    s = rows.state[i]
    bits = draw(rows.key[i], rows.stroke[i])
    k = table_choice(opponents.players, opponents.opponent[i], s, first_pair(tables, s), bits)
    return _stroke(tables, rows, i, k, bits)


@inlined
def _end_rally(rows: Any, matches: Any, i: Any, winner: Any, outcome: Any, rules: Any) -> Any:
    """Count a rally and begin the next one, unless the match is over, which it returns."""
    matches.reason[i] = outcome
    counted = _count_rally(matches.points[i, winner], matches.points[i, 1 - winner], matches.games[i, winner], rules)
    matches.points[i, winner], matches.games[i, winner] = counted.points, counted.games
    if counted.match_won:
        matches.server[i] = winner
        rows.live[i] = False
        return True
    if counted.game_won:
        matches.points[i, 0] = matches.points[i, 1] = 0
    matches.rally[i] += 1
    _begin_rally(rows, matches, i, winner)
    return False


@inlined
def _until_learner(tables: Any, rows: Any, matches: Any, opponents: Any, i: Any, rules: Any, each: Any) -> Any:
    """Let the opponent play until the learner is to strike or the match is over; returns the learner's reward.

    ``each``: 1 if every rally pays, 0 if the match does.
    """
    seat, reward = np.int64(opponents.seat[i]), np.float32(0)
    while rows.live[i] and rows.striker[i] != seat:
        outcome = _reply(tables, rows, opponents, i)
        if outcome < 2:
            # A fault of the opponent is won by the learner, a winner by the opponent.
            winner = seat if outcome == 0 else 1 - seat
            over = _end_rally(rows, matches, i, winner, outcome, rules)
            reward += np.float32(1 - 2 * outcome) * np.float32(max(each, over))
    return reward


@inlined
def _begin_match(
    tables: Any, rows: Any, matches: Any, opponents: Any, i: Any, seed_key: Any, server: Any, rules: Any, each: Any
) -> None:
    """Begin matches until one comes to the learner."""
    while True:
        matches.match[i] += matches.match.size
        matches.key[i] = extend(seed_key, matches.match[i])
        matches.rally[i] = 0
        matches.points[i, 0] = matches.points[i, 1] = 0
        matches.games[i, 0] = matches.games[i, 1] = 0
        opponents.opponent[i] = opponents.following[i]
        rows.live[i] = True
        first = server if server >= 0 else first_server(draw(extend(matches.key[i], 0), 0))
        _begin_rally(rows, matches, i, first)
        matches.owed[i] = _until_learner(tables, rows, matches, opponents, i, rules, each)
        if rows.live[i]:
            return
        opponents.unseen[i, 0 if matches.server[i] == opponents.seat[i] else 1] += 1


@compiled
def _reset(
    tables: Tables,
    rows: Rows,
    matches: MatchRows,
    opponents: Opponents,
    which: Bools,
    seed_key: np.uint64,
    server: int,
    rules: Numbers,
    each: int,
) -> None:
    for i in range(rows.state.size):
        if which[i]:
            _begin_match(tables, rows, matches, opponents, i, seed_key, server, rules, each)


@compiled
def _step(
    tables: Tables,
    rows: Rows,
    matches: MatchRows,
    opponents: Opponents,
    stroke: I64,
    reward: F32,
    done: Bools,
    rules: Numbers,
    each: int,
    first: int,
    last: int,
) -> None:
    for i in range(first, last):
        seat = np.int64(opponents.seat[i])
        paid = matches.owed[i]
        matches.owed[i] = 0
        k = tables.rank[row_of(tables, rows.state[i]), np.uint64(stroke[i])]
        if k < 0:
            matches.reason[i], rows.live[i] = 2, False
            paid -= 1
        else:
            outcome = _stroke(tables, rows, i, k, draw(rows.key[i], rows.stroke[i]))
            if outcome < 2:
                winner = seat if outcome == 1 else 1 - seat
                over = _end_rally(rows, matches, i, winner, outcome, rules)
                paid += np.float32(2 * outcome - 1) * np.float32(max(each, over))
            paid += _until_learner(tables, rows, matches, opponents, i, rules, each)
        reward[i], done[i] = paid, not rows.live[i]


class MatchVersusBatch(AgainstBatch):
    """B matches of a learner against opponents that play from tables; row b plays the matches b, b + B, b + 2 B, … of its seed.

    The draws are those of ``match_v0``. A match that ends before the learner's first stroke never comes to the learner: it is
    counted in :attr:`unseen`, and the row continues with its next one.

    Args:
        game: the tables.
        batch: number of rows B.
        opponents: K opponents, tabulated for this game; row b meets opponent b modulo K.
        seed: names all draws.
        seat: seat of the learner, 0 or 1, for all rows or each ``[B]``.
        server: seat that serves first, 0 or 1; None: at random.
        rules: when a game and a match are won.
        each_rally: whether every rally pays, or only the match.
        threads: threads that share the rows; never changes a result.

    Attributes:
        matches: score, server and draws of each row.

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
        rules: Rules = BWF,
        each_rally: bool = False,
        threads: int = 1,
    ) -> None:
        self._rules, self._each = rules.numbers, int(each_rally)
        self.matches = MatchRows(
            match=np.empty(batch, np.int64),
            key=np.empty(batch, np.uint64),
            rally=np.zeros(batch, np.int64),
            points=np.zeros((batch, 2), np.int32),
            games=np.zeros((batch, 2), np.int32),
            server=np.zeros(batch, np.int8),
            owed=np.zeros(batch, np.float32),
            reason=np.zeros(batch, np.int8),
        )
        super().__init__(game, batch, opponents=opponents, seat=seat, server=server, threads=threads)
        self.reset(seed)

    def reseed(self, seed: int) -> None:
        """Let every row begin with the first of its matches of another seed when it begins its next one."""
        self._seed_key = draws.stream(seed)[0]
        self.matches.match[:] = np.arange(len(self)) - len(self)
        self.opponents.unseen[:] = 0

    def reset(self, seed: int | None = None, rows: Bools | None = None) -> None:
        """Start the next match in some rows, up to the learner's first stroke.

        Args:
            seed: begin again, with match 0 of this seed; None: continue.
            rows: ``[B]`` which ones; None: all.
        """
        if seed is not None:
            self.reseed(seed)
        which = self._chosen_rows(rows)
        _reset(
            self._tables, self.rows, self.matches, self.opponents, which, self._seed_key, self._server, self._rules, self._each
        )

    def play(self, stroke: Ints) -> tuple[F32, Bools]:
        """Play the learner's stroke and the opponent's until the learner is to strike again, in every row.

        A stroke that is not legal loses the match. Rows whose match is over wait for :meth:`reset`.

        Args:
            stroke: ``[B]`` catalogue indices.

        Returns:
            ``[B]`` float32 reward of the learner and ``[B]`` whether the match is over.

        Raises:
            KernelError: a wrong number of strokes, one that is not in the catalogue, or a row that is over; nothing has changed.
        """
        wanted = checked_array("strokes", stroke, np.int64, (len(self),), 0, self.game.n_strokes - 1)
        if not self.rows.live.all():
            self._refuse(int(np.argmin(self.rows.live)), 0)
        reward, done = np.empty(len(self), np.float32), np.empty(len(self), np.bool_)
        args = (self._tables, self.rows, self.matches, self.opponents, wanted, reward, done, self._rules, self._each)
        in_slices(lambda a, b: _step(*args, a, b), len(self), self.threads)
        return reward, done
