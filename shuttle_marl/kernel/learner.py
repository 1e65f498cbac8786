"""Batches of rallies and of matches against tabulated opponents.

A step is the learner's stroke and the opponent's, until the learner is to strike.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F32, I8, I16, I32, I64, U64, Bools, Ints
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.game import draws
from shuttle_marl.game.rules import FAULT, WINNER
from shuttle_marl.game.scoring import BWF, Rules, RulesTuple, count_rally
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.checks import KernelError, checked_array
from shuttle_marl.kernel.core import (
    BLOCK,
    OPEN,
    Tables,
    choose_stroke,
    draw,
    extend,
    first_server,
    int64,
    legal_strokes,
    list_where,
    new_block,
    next_state,
    outcome_of,
    read_limits,
    row_of,
    strike_one,
)
from shuttle_marl.kernel.players import Players, pack, put_player, table_choice
from shuttle_marl.kernel.rows import (
    Batch,
    Observations,
    Output,
    Rows,
    Server,
    Serving,
    begin,
    in_slices,
    observe,
    part_of,
    reward_strikers,
    strike,
)


class Opponents(NamedTuple):
    """Opponents of a learner, row by row.

    Attributes:
        players: the K opponents.
        seat: ``[B]`` int8 seat of the learner.
        opponent: ``[B]`` int32 opponent in the current rally or match.
        following: ``[B]`` int32 opponent in those that start from now on.
        unseen: ``[B, 2]`` int64 rallies or matches that ended before the learner's first stroke: won and lost by the learner.
    """

    players: Players
    seat: I8
    opponent: I32
    following: I32
    unseen: I64


@inlined
def _begin(tables: Tables, rows: Rows, opponents: Opponents, i: int, serving: Serving) -> int:
    """Start the next rally of a row, up to the learner's first stroke; returns the outcome of the opponent's serve, or OPEN."""
    bits = begin(rows, i, serving)
    opponents.opponent[i] = opponents.following[i]
    if rows.striker[i] == opponents.seat[i]:
        return int64(OPEN)
    k = table_choice(opponents.players, opponents.opponent[i], 0, legal_strokes(tables, 0).pair, bits)
    outcome, rows.state[i] = strike_one(tables, 0, k, 1 - opponents.seat[i], bits)
    rows.stroke[i] = 1
    rows.striker[i] = opponents.seat[i]
    rows.live[i] = outcome >= OPEN
    if outcome < OPEN:
        opponents.unseen[i, outcome] += 1
    return outcome


@inlined
def _begin_learner(tables: Tables, rows: Rows, opponents: Opponents, i: int, serving: Serving) -> None:
    """Start rallies until the learner strikes in one."""
    while _begin(tables, rows, opponents, i, serving) < OPEN:
        pass


@compiled
def _reset_rallies(tables: Tables, rows: Rows, opponents: Opponents, which: Bools, serving: Serving) -> None:
    for i in range(rows.state.size):
        if which[i]:
            _begin_learner(tables, rows, opponents, i, serving)


@compiled
def _step_rallies(
    tables: Tables, rows: Rows, opponents: Opponents, rank: I16, output: Output, serving: Serving, first: int, last: int
) -> None:
    block = new_block()
    for begin_block in range(first, last, BLOCK):
        end_block = min(begin_block + BLOCK, last)
        part = part_of(rows, begin_block, end_block)
        count = end_block - begin_block
        opponent = opponents.opponent[begin_block:end_block]
        reward, over = output.reward[begin_block:end_block], output.done[begin_block:end_block]
        strike(tables, part, rank[begin_block:end_block], block)
        reward_strikers(block, reward, over)
        # From here on the first entries of the block belong to the listed rows, those with a reply.
        replies = list_where(block, count, over=False)
        for r in range(replies):
            at = np.uint64(block.listed[r])
            block.bits[r] = draw(part.key[at], part.stroke[at])
        for r in range(replies):
            at = np.uint64(block.listed[r])
            s = part.state[at]
            legal = legal_strokes(tables, s)
            k = table_choice(opponents.players, opponent[at], s, legal.pair, block.bits[r])
            choose_stroke(tables, block, r, legal, k, part.striker[at])
        read_limits(tables, block, replies)
        for r in range(replies):
            at = np.uint64(block.listed[r])
            outcome = outcome_of(block.limits[r], block.bits[r])
            ends = outcome < OPEN
            part.state[at] = next_state(block.arrival[r], outcome)
            part.stroke[at] += 1
            part.striker[at] ^= 1
            over[at] = ends
            reward[at] = (1 - 2 * outcome) * ends
        for j in range(count):
            part.live[j] = not over[j]
            if serving.reset and over[j]:
                _begin_learner(tables, rows, opponents, begin_block + j, serving)
        if output.observed.mask.shape[0] > 0:
            observe(tables, rows, output.observed, begin_block, end_block)


class OpponentBatch(Batch):
    """Base of the batches of a learner against tabulated opponents.

    Args:
        game: the game.
        batch: number of rows B.
        opponents: K opponents, tabulated for this game; row b plays against opponent b modulo K.
        seat: seat of the learner, 0 or 1, for all rows or each ``[B]``.
        server: seat that serves, 0 or 1; None: random.
        threads: number of threads; does not change results.

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
        """Rallies or matches that ended before the learner's first stroke, since the last seed: won and lost by the learner."""
        won, lost = self.opponents.unseen.sum(axis=0).tolist()
        return won, lost

    def assign(self, opponent: Ints) -> None:
        """Set the opponent of each row in the rallies that start from now on.

        Args:
            opponent: ``[B]`` numbers from 0 to K - 1.

        Raises:
            KernelError: an invalid number.
        """
        self.opponents.following[:] = checked_array("opponents", opponent, np.int32, (len(self),), 0, self.n_opponents - 1)

    def replace_opponent(self, number: int, policy: TabulatedPolicy) -> None:
        """Replace an opponent, also in rallies that have started.

        Raises:
            KernelError: a policy of another game, or an invalid number.
        """
        put_player(self.opponents.players, number, policy, self.game)


class LearnerBatch(OpponentBatch):
    """B rallies of a learner against tabulated opponents.

    Row b plays rallies b, b + B, b + 2 B, … of the seed, with the draws of ``rally_v0``: the lower half of a draw decides the
    outcome of a stroke, the upper half the opponent's choice. A rally that ends on the opponent's serve is counted in
    :attr:`unseen`, and the row continues with its next rally.

    Args:
        game: the game.
        batch: number of rows B.
        opponents: K opponents, tabulated for this game; row b plays against opponent b modulo K.
        seed: random seed.
        seat: seat of the learner, 0 or 1, for all rows or each ``[B]``.
        server: seat that serves, 0 or 1; None: random.
        threads: number of threads; does not change results.

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
        """Restart the numbers of the rallies with another seed; rows continue their current rally."""
        super().reseed(seed)
        self.opponents.unseen[:] = 0

    def reset(self, seed: int | None = None, rows: Bools | None = None) -> None:
        """Start the next rally in some rows, up to the learner's first stroke.

        Args:
            seed: restart with rally 0 of this seed; None: continue.
            rows: ``[B]`` mask of rows; None: all.
        """
        if seed is not None:
            self.reseed(seed)
        _reset_rallies(self._tables, self.rows, self.opponents, self._chosen_rows(rows), self._serving())

    def step(self, stroke: Ints, *, reset: bool = True, observed: Observations | None = None) -> tuple[F32, Bools]:
        """Play the learner's stroke and the opponent's reply in every row.

        Args:
            stroke: ``[B]`` catalogue index of the learner's stroke.
            reset: whether rows whose rally is over start the next one in the same step.
            observed: output arrays for the learner's observations after the step; None: not wanted.

        Returns:
            ``[B]`` float32 reward of the learner (+1 won, -1 lost, 0 the rally continues) and ``[B]`` whether it is over.

        Raises:
            IllegalStrokeError: an illegal stroke, or a row that is over; the batch is unchanged.
            KernelError: arrays of wrong shape or dtype; the batch is unchanged.
        """
        output, rank, serving = self._output(observed), self._ranks(stroke), self._serving(reset=reset)
        args = (self._tables, self.rows, self.opponents, rank, output, serving)
        in_slices(lambda a, b: _step_rallies(*args, a, b), len(self), self.threads)
        return output.reward, output.done


ILLEGAL: Final = 2
"""Reason of the end of a match that was lost by an illegal stroke; otherwise FAULT or WINNER, the outcome of the last stroke."""

_count_rally = inlined(count_rally)


class MatchRows(NamedTuple):
    """The matches of B rows, beside their rallies.

    Attributes:
        match: ``[B]`` int64 number of the match; its draws follow from the seed and this number.
        key: ``[B]`` uint64 key of the match's draws.
        rally: ``[B]`` int64 number of the rally in its match.
        points: ``[B, 2]`` int32 points of the seats in the current game; after the end of the match, in its last game.
        games: ``[B, 2]`` int32 games of the seats.
        server: ``[B]`` int8 seat that serves the rally; after the end of the match, its winner.
        owed: ``[B]`` float32 reward for rallies that ended before the learner's first stroke.
        reason: ``[B]`` int8 FAULT, WINNER or :data:`ILLEGAL`: how the last rally ended.
    """

    match: I64
    key: U64
    rally: I64
    points: I32
    games: I32
    server: I8
    owed: F32
    reason: I8


class _Play(NamedTuple):
    """State of a batch of matches, and its rules.

    Attributes:
        rows: the rallies.
        matches: the matches.
        opponents: the opponents.
        rules: when a game and a match are won.
        each: 1 if every rally is rewarded, 0 if only the match is.
    """

    rows: Rows
    matches: MatchRows
    opponents: Opponents
    rules: RulesTuple
    each: int


@inlined
def _begin_rally(rows: Rows, matches: MatchRows, i: int, server: int) -> None:
    rows.key[i] = extend(matches.key[i], matches.rally[i])
    rows.state[i] = 0
    rows.stroke[i] = 0
    rows.striker[i] = server
    matches.server[i] = server


@inlined
def _stroke(tables: Tables, rows: Rows, i: int, k: int, bits: np.uint64) -> int:
    """Play the k-th legal stroke of a row's state; returns its outcome."""
    outcome, rows.state[i] = strike_one(tables, rows.state[i], k, rows.striker[i], bits)
    rows.stroke[i] += 1
    rows.striker[i] ^= 1
    return outcome


@inlined
def _reply(tables: Tables, play: _Play, i: int) -> int:
    """Play the opponent's stroke; returns its outcome."""
    rows, opponents = play.rows, play.opponents
    s = rows.state[i]
    bits = draw(rows.key[i], rows.stroke[i])
    k = table_choice(opponents.players, opponents.opponent[i], s, legal_strokes(tables, s).pair, bits)
    return _stroke(tables, rows, i, k, bits)


@inlined
def _end_rally(play: _Play, i: int, winner: int, outcome: int) -> bool:
    """Count a rally and start the next one, unless the match is over; returns whether it is."""
    rows, matches = play.rows, play.matches
    matches.reason[i] = outcome
    counted = _count_rally(matches.points[i, winner], matches.points[i, 1 - winner], matches.games[i, winner], play.rules)
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
def _until_learner(tables: Tables, play: _Play, i: int) -> np.float32:
    """Let the opponent play until the learner is to strike or the match is over; returns the learner's reward."""
    seat, reward = int64(play.opponents.seat[i]), np.float32(0)
    while play.rows.live[i] and play.rows.striker[i] != seat:
        outcome = _reply(tables, play, i)
        if outcome < OPEN:
            winner = seat if outcome == FAULT else 1 - seat
            over = _end_rally(play, i, winner, outcome)
            reward += np.float32(1 - 2 * outcome) * np.float32(max(play.each, over))
    return reward


@inlined
def _begin_match(tables: Tables, play: _Play, i: int, serving: Serving) -> None:
    """Start matches until the learner strikes in one."""
    rows, matches, opponents = play.rows, play.matches, play.opponents
    while True:
        matches.match[i] += matches.match.size
        matches.key[i] = extend(serving.seed_key, matches.match[i])
        matches.rally[i] = 0
        matches.points[i, 0] = matches.points[i, 1] = 0
        matches.games[i, 0] = matches.games[i, 1] = 0
        opponents.opponent[i] = opponents.following[i]
        rows.live[i] = True
        first = serving.server if serving.server >= 0 else first_server(draw(extend(matches.key[i], 0), 0))
        _begin_rally(rows, matches, i, first)
        matches.owed[i] = _until_learner(tables, play, i)
        if rows.live[i]:
            return
        opponents.unseen[i, 0 if matches.server[i] == opponents.seat[i] else 1] += 1


@compiled
def _reset(tables: Tables, play: _Play, which: Bools, serving: Serving) -> None:
    for i in range(play.rows.state.size):
        if which[i]:
            _begin_match(tables, play, i, serving)


@compiled
def _step(tables: Tables, play: _Play, stroke: I64, output: Output, first: int, last: int) -> None:
    rows, matches = play.rows, play.matches
    for i in range(first, last):
        seat = int64(play.opponents.seat[i])
        reward = matches.owed[i]
        matches.owed[i] = 0
        k = tables.rank[row_of(tables, rows.state[i]), np.uint64(stroke[i])]
        if k < 0:
            matches.reason[i], rows.live[i] = ILLEGAL, False
            reward -= 1
        else:
            outcome = _stroke(tables, rows, i, k, draw(rows.key[i], rows.stroke[i]))
            if outcome < OPEN:
                winner = seat if outcome == WINNER else 1 - seat
                over = _end_rally(play, i, winner, outcome)
                reward += np.float32(2 * outcome - 1) * np.float32(max(play.each, over))
            reward += _until_learner(tables, play, i)
        output.reward[i], output.done[i] = reward, not rows.live[i]


class LearnerMatchBatch(OpponentBatch):
    """B matches of a learner against tabulated opponents; row b plays matches b, b + B, b + 2 B, … of the seed.

    The draws are those of ``match_v0``. A match that ends before the learner's first stroke is counted in :attr:`unseen`, and the
    row continues with its next match.

    Args:
        game: the game.
        batch: number of rows B.
        opponents: K opponents, tabulated for this game; row b plays against opponent b modulo K.
        seed: random seed.
        seat: seat of the learner, 0 or 1, for all rows or each ``[B]``.
        server: seat that serves first, 0 or 1; None: random.
        rules: when a game and a match are won.
        each_rally: whether every rally is rewarded, or only the match.
        threads: number of threads; does not change results.

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
        self._play = _Play(self.rows, self.matches, self.opponents, rules.as_tuple, int(each_rally))
        self.reset(seed)

    def reseed(self, seed: int) -> None:
        """Restart the numbers of the matches with another seed; rows continue their current match."""
        self._seed_key = draws.stream(seed)[0]
        self.matches.match[:] = np.arange(len(self)) - len(self)
        self.opponents.unseen[:] = 0

    def reset(self, seed: int | None = None, rows: Bools | None = None) -> None:
        """Start the next match in some rows, up to the learner's first stroke.

        Args:
            seed: restart with match 0 of this seed; None: continue.
            rows: ``[B]`` mask of rows; None: all.
        """
        if seed is not None:
            self.reseed(seed)
        _reset(self._tables, self._play, self._chosen_rows(rows), self._serving())

    def play(self, stroke: Ints) -> tuple[F32, Bools]:
        """Play the learner's stroke and the opponent's until the learner is to strike again, in every row.

        An illegal stroke loses the match. Rows whose match is over need a :meth:`reset`.

        Args:
            stroke: ``[B]`` catalogue indices.

        Returns:
            ``[B]`` float32 reward of the learner and ``[B]`` whether the match is over.

        Raises:
            KernelError: wrong shape or dtype, or a stroke that is not in the catalogue; the batch is unchanged.
            IllegalStrokeError: a row that is over; the batch is unchanged.
        """
        wanted = checked_array("strokes", stroke, np.int64, (len(self),), 0, self.game.n_strokes - 1)
        if not self.rows.live.all():
            self._refuse(int(np.argmin(self.rows.live)), 0)
        output = self._output()
        in_slices(lambda a, b: _step(self._tables, self._play, wanted, output, a, b), len(self), self.threads)
        return output.reward, output.done
