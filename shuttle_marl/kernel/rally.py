"""Thousands of rallies or matches at once, in which a seat's strokes are given or come from tables.

Without opponents the strokes of both seats are given, and a step is one stroke. With opponents a step is the learner's stroke and
the opponent's, until the learner is to strike.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F32, I8, I16, I32, I64, U64, Bools, Intp, Ints
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.base.errors import whole_number
from shuttle_marl.game import draws
from shuttle_marl.game.draws import POSITION_SHIFT
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.rules import ABANDONED, ILLEGAL, IllegalStrokeError
from shuttle_marl.game.scoring import BWF, Rules, RulesTuple
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import core
from shuttle_marl.kernel.core import BLOCK, OPEN, Block, KernelError, Tables, checked_array, count_rally, int64
from shuttle_marl.kernel.players import Players, empty_players, pack, place_choice, put_player, table_choice
from shuttle_marl.kernel.rows import (
    CUT,
    DRAWN,
    NO_OBSERVATIONS,
    TOKENS,
    Observations,
    Output,
    Rows,
    Server,
    Serving,
    Tape,
    begin,
    choose_uniform,
    draw_strokes,
    find_places,
    find_ranks,
    in_slices,
    new_rows,
    new_tape,
    observe,
    observe_rows,
    part_of,
    play,
)


class Opponents(NamedTuple):
    """Opponents of a learner, row by row."""

    players: Players  # the K opponents
    seat: I8  # [B] seat of the learner
    opponent: I32  # [B] opponent in the current rally or match
    following: I32  # [B] opponent in those that start from now on
    unseen: I64  # [B, 2] rallies or matches that ended before the learner's first stroke: won and lost by the learner


class MatchRows(NamedTuple):
    """The matches of B rows, beside their rallies."""

    key: U64  # [B] key of the match's draws
    rally: I64  # [B] number of the rally in its match
    points: I32  # [B, 2] points of the seats in the current game; after the end of the match, in its last game
    games: I32  # [B, 2] games of the seats
    server: I8  # [B] seat that serves the rally; after the end of the match, its winner
    owed: F32  # [B] reward for rallies that ended before the learner's first stroke
    reason: I8  # [B] FAULT, WINNER or `ILLEGAL`: how the last rally ended
    rules: RulesTuple  # when a game and a match are won
    each: int  # 1 if every rally is rewarded, 0 if only the match is


class _Work(NamedTuple):
    """Room for a block of rows: those worked on as ``row`` numbers within it, their rewards, and strokes of some of them."""

    block: Block
    row: I64
    reward: F32
    state: I64


@inlined
def _new_work(size: int) -> _Work:
    number, reward = np.empty(size, np.int64), np.zeros(size, np.float32)
    return _Work(core.new_block(size), number, reward, np.empty(size, np.int64))


# Arrays of these tuples are read where they are used: a local name for one, across branches, costs a count of its references.


@inlined
def _begin_rally(rows: Rows, matches: MatchRows, i: int, server: int) -> None:
    """Start the next rally of a match."""
    rows.key[i] = core.extend(matches.key[i], matches.rally[i])
    rows.state[i] = 0
    rows.stroke[i] = 0
    rows.striker[i] = server
    matches.server[i] = server


@inlined
def _end_stroke(rows: Rows, matches: MatchRows | None, seat: int, i: int, outcome: int) -> np.float32:
    """Count a stroke: at the end of a rally the reward of the learner, and the next rally of a match that continues."""
    winner = int64(rows.striker[i]) ^ outcome  # the striker is already the receiver of the last stroke
    won, over = np.float32(2 * (winner == seat) - 1), outcome < OPEN
    if matches is None:  # without branches, see above
        rows.live[i] = not over
        return won * np.float32(over)
    if not over:
        return np.float32(0)
    matches.reason[i] = outcome
    counted = count_rally(matches.points[i, winner], matches.points[i, 1 - winner], matches.games[i, winner], matches.rules)
    matches.points[i, winner], matches.games[i, winner] = counted.points, counted.games
    rows.live[i] = not counted.match_won
    if counted.match_won:
        matches.server[i] = winner
    else:
        if counted.game_won:
            matches.points[i, 0] = matches.points[i, 1] = 0
        matches.rally[i] += 1
        _begin_rally(rows, matches, i, winner)
    return won * np.float32(max(matches.each, counted.match_won))


@inlined
def _reply(
    tables: Tables,
    rows: Rows,
    matches: MatchRows | None,
    opponents: Opponents,
    tape: Tape | None,
    work: _Work,
    first: int,
    count: int,
) -> None:
    """Let opponents play in ``count`` rows of ``work`` until the learner is to decide or the episode is over."""
    block, state, replies = work.block, work.state, 0
    for r in range(count):
        block.listed[replies] = first + work.row[r]
        replies += _replies(tables, rows, opponents, first + work.row[r])
    while replies > 0:
        for r in range(replies):
            at = np.uint64(block.listed[r])
            block.bits[r] = core.draw(rows.key[at], rows.stroke[at])
        for r in range(replies):
            at = np.uint64(block.listed[r])
            s = rows.state[at]
            state[r], block.place[r] = s, 0
            legal = core.legal_strokes(tables, s)
            k = table_choice(opponents.players, opponents.opponent[at], s, legal.pair, block.bits[r])
            core.put_stroke(tables, block, r, legal, k, rows.striker[at])
        core.strike(tables, state, block, replies)
        again = 0
        for r in range(replies):
            at = np.uint64(block.listed[r])
            rows.state[at] = state[r]
            rows.stroke[at] += 1
            rows.striker[at] ^= 1
            if tape is not None:
                code = _code_of(block, r, rows.striker[at] ^ 1, opponents.opponent[at])
                _note(matches, tape, int64(at), code, block.outcome[r])
            reward = _end_stroke(rows, matches, int64(opponents.seat[at]), int64(at), block.outcome[r])
            work.reward[at - np.uint64(first)] += reward
            block.listed[again] = at
            again += _replies(tables, rows, opponents, int64(at))
        replies = again


@inlined
def _code_of(block: Block, j: int, seat: int, opponent: int) -> np.uint64:
    """Code of the j-th stroke of a block on a :class:`Tape`, without a cut."""
    what = block.outcome[j] | int64(block.place[j]) << 3 | int64(seat) << 7 | int64(opponent) << 8
    return np.uint64(np.uint64(block.arrival[j]) | np.uint64(what) << np.uint64(32))


@inlined
def _note(matches: MatchRows | None, tape: Tape, i: int, code: np.uint64, outcome: int) -> None:
    """Note a stroke of row i, and in a match the score before the rally that it ends."""
    if tape.used[i] < tape.code.shape[1]:
        tape.code[i, tape.used[i]] = code
    if matches is not None and outcome < OPEN and tape.used[i] < tape.code.shape[1]:
        points = matches.points[i, 0] | matches.points[i, 1] << 8
        tape.score[i, tape.used[i]] = points | matches.games[i, 0] << 16 | matches.games[i, 1] << 24
    tape.used[i] += 1


@inlined
def _replies(tables: Tables, rows: Rows, opponents: Opponents, i: int) -> bool:
    """Whether the opponent is to strike in row i, and the learner has no choice of a position."""
    replies: bool = rows.live[i] & (rows.striker[i] != opponents.seat[i]) & (core.choices_in(tables, rows.state[i]) == 1)
    return replies


@inlined
def _begin(
    tables: Tables,
    rows: Rows,
    matches: MatchRows | None,
    opponents: Opponents | None,
    tape: Tape | None,
    work: _Work,
    first: int,
    count: int,
    serving: Serving,
) -> None:
    """Start rallies, or matches, in ``count`` rows of ``work`` until the learner decides in one."""
    while count > 0:
        for r in range(count):
            i = first + work.row[r]
            work.reward[work.row[r]] = 0
            begin(rows, i, serving)
            if matches is not None:
                matches.key[i] = rows.key[i]
                matches.rally[i] = matches.reason[i] = 0
                matches.points[i, 0] = matches.points[i, 1] = 0
                matches.games[i, 0] = matches.games[i, 1] = 0
                server = serving.server if serving.server >= 0 else core.first_server(core.draw(core.extend(rows.key[i], 0), 0))
                _begin_rally(rows, matches, i, server)
            if opponents is not None:
                opponents.opponent[i] = opponents.following[i]
        if opponents is None:
            return
        _reply(tables, rows, matches, opponents, tape, work, first, count)
        again = 0
        for r in range(count):
            j = work.row[r]
            i = first + j
            if matches is not None:
                matches.owed[i] = work.reward[j]
            if not rows.live[i]:
                won = matches.server[i] == opponents.seat[i] if matches is not None else work.reward[j] > 0
                opponents.unseen[i, 1 - won] += 1
                work.row[again] = j
                again += 1
        count = again


@compiled
def _reset(
    tables: Tables,
    rows: Rows,
    matches: MatchRows | None,
    opponents: Opponents | None,
    tape: Tape | None,
    which: Bools,
    serving: Serving,
) -> None:
    work = _new_work(min(BLOCK, which.size))
    for first in range(0, which.size, BLOCK):
        count = 0
        for j in range(min(BLOCK, which.size - first)):
            if which[first + j]:
                work.row[count] = j
                count += 1
        _begin(tables, rows, matches, opponents, tape, work, first, count, serving)


@inlined
def _decide(tables: Tables, opponents: Opponents, part: Rows, first: int, rank: I16, place: I16, block: Block) -> None:
    """Split the learner's actions of a block into strokes and positions, and let the opponents choose the others."""
    for j in range(part.state.size):
        s, opponent, bits = part.state[j], opponents.opponent[first + j], block.bits[j]
        if part.striker[j] == opponents.seat[first + j]:
            place[j] = place_choice(opponents.players, opponent, s, bits)
        else:
            place[j] = rank[j]
            rank[j] = table_choice(opponents.players, opponent, s, core.legal_strokes(tables, s).pair, bits)


@inlined
def _count(
    tables: Tables,
    rows: Rows,
    matches: MatchRows | None,
    opponents: Opponents,
    tape: Tape | None,
    work: _Work,
    first: int,
    output: Output,
) -> None:
    """Count the strokes of a block for the learners, and let their opponents play up to the next decision."""
    size = output.done.size
    for j in range(size):
        i, outcome = first + j, work.block.outcome[j]
        work.row[j], work.reward[j] = j, 0
        if matches is not None:
            work.reward[j], matches.owed[i] = matches.owed[i], 0
            if matches.reason[i] == ILLEGAL:
                rows.live[i] = False
                work.reward[j] -= 1
                continue
        work.reward[j] += _end_stroke(rows, matches, int64(opponents.seat[i]), i, outcome)
    _reply(tables, rows, matches, opponents, tape, work, first, size)
    for j in range(size):
        output.reward[j], output.done[j] = work.reward[j], not rows.live[first + j]


@compiled
def _step(
    tables: Tables,
    rows: Rows,
    matches: MatchRows | None,
    opponents: Opponents | None,
    tape: Tape | None,
    other: I8,
    rank: I16,
    place: I16,
    output: Output,
    serving: Serving,
    span: tuple[int, int],
) -> None:
    start, end = span
    work = _new_work(min(BLOCK, end - start))
    block = work.block
    for first in range(start, end, BLOCK):
        last = min(first + BLOCK, end)
        part, size = part_of(rows, first, last), last - first
        results = Output(output.reward[first:last], output.done[first:last], output.observed)
        draw_strokes(part, block.bits)
        ranks, places = rank[first:last], place[first:last]
        if opponents is not None and core.with_recovery(tables):
            _decide(tables, opponents, part, first, ranks, places, block)
        for j in range(size):
            core.put_stroke(tables, block, j, core.legal_strokes(tables, part.state[j]), ranks[j], part.striker[j])
            block.place[j] = places[j]
        play(tables, part, block)
        if tape is not None:
            for j in range(size):
                opponent = 0 if opponents is None else opponents.opponent[first + j]
                _note(matches, tape, first + j, _code_of(block, j, part.striker[j] ^ 1, opponent), block.outcome[j])
        if opponents is not None:
            _count(tables, rows, matches, opponents, tape, work, first, results)
        else:
            for j in range(size):
                over = block.outcome[j] < OPEN
                results.reward[j], results.done[j], part.live[j] = (2 * block.outcome[j] - 1) * over, over, not over
        if serving.reset:
            count = 0
            for j in range(size):
                work.row[count] = j
                count += results.done[j]
            _begin(tables, rows, matches, opponents, tape, work, first, count, serving)
        if output.observed.mask.shape[0] > 0:
            observe(tables, rows, other, output.observed, first, last)


@compiled
def _run(tables: Tables, rows: Rows, serving: Serving, strokes: int, start: int, end: int) -> None:
    """Let rows play random legal strokes; a block of rows plays all of its while it is in the first-level cache."""
    block = core.new_block()
    for first in range(start, end, BLOCK):
        part = part_of(rows, first, min(first + BLOCK, end))
        count = part.state.size
        for _ in range(strokes):
            draw_strokes(part, block.bits)
            for j in range(count):
                legal = core.legal_strokes(tables, part.state[j])
                core.put_stroke(tables, block, j, legal, core.uniform_choice(legal.n, block.bits[j]), part.striker[j])
                block.place[j] = core.uniform_choice(legal.choices, block.bits[j] << POSITION_SHIFT)
            play(tables, part, block)
            for i in range(core.list_where(block, count, over=True)):
                begin(rows, first + block.listed[i], serving)


class RallyBatch:
    """B rallies in which the strokes of both seats are given, or those of a learner, against tabulated opponents.

    Row b plays rallies b, b + B, b + 2 B, … of the seed. Rally r has the draws of episode r of ``rally_v0`` with the same seed,
    so it depends on its number and its strokes alone: the lower half of a draw decides the outcome of a stroke, the upper half
    the opponent's choice. A rally that ends on the opponent's serve is counted in :attr:`unseen`, and the row continues with its
    next rally.

    Args:
        batch: number of rows B.
        opponents: K opponents, tabulated for this game; row b plays against opponent b modulo K. None: all strokes are given.
        seat: seat of the learner, 0 or 1, for all rows or each ``[B]``.
        server: seat that serves, 0 or 1; None: random.
        threads: number of threads; does not change results.
        record: note every stroke on :attr:`tape`.

    Attributes:
        joint: whether positions are chosen beside strokes.
        tape: strokes since they were read, see :class:`shuttle_marl.kernel.taped.TapeReader`.

    Raises:
        KernelError: no opponent, one of another game, or a seat that is neither 0 nor 1.
    """

    matches: MatchRows | None = None

    def __init__(
        self,
        game: Game,
        batch: int,
        *,
        opponents: Sequence[TabulatedPolicy] | None = None,
        seed: int = 0,
        seat: int | Ints = 0,
        server: Server = None,
        threads: int = 1,
        record: bool = False,
    ) -> None:
        if server not in (None, 0, 1):
            raise KernelError(f"server {server!r}: expected 0, 1, or None for a random server")
        self.game, self.rows, self.threads = game, new_rows(batch), whole_number("threads", threads, 1)
        self._tables, self._server = core.tables_of(game), DRAWN if server is None else int(server)
        seats = np.asarray(seat)
        if seats.shape not in ((), (batch,)) or not np.isin(seats, (0, 1)).all():
            raise KernelError(f"seat {seat!r}: expected 0 or 1, or an array of them of shape ({batch},)")
        players = empty_players(game, 0) if opponents is None else pack(opponents, game)
        assigned = (np.arange(batch) % max(1, len(players.cumulative))).astype(np.int32)
        self.opponents = Opponents(
            players=players,
            seat=np.broadcast_to(seats, batch).astype(np.int8),
            opponent=assigned.copy(),
            following=assigned,
            unseen=np.zeros((batch, 2), np.int64),
        )
        self.joint = game.hides and opponents is None
        self._other = (1 - self.opponents.seat) if self.n_opponents else np.full(batch, -1, np.int8)
        self._learns = None if opponents is None else self.opponents
        self.tape = new_tape(batch, scored=self.matches is not None) if record else None
        self.reset(seed)

    def __len__(self) -> int:
        return len(self.rows.state)

    @property
    def _state(self) -> tuple[Tables, Rows, MatchRows | None, Opponents | None, Tape | None]:
        return self._tables, self.rows, self.matches, self._learns, self.tape

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
        """Set the opponents of the rows, ``[B]`` 0 to K - 1, in rallies to come. Raises KernelError: an invalid number."""
        self.opponents.following[:] = checked_array("opponents", opponent, np.int32, (len(self),), 0, self.n_opponents - 1)

    def replace_opponent(self, number: int, policy: TabulatedPolicy) -> None:
        """Replace an opponent, also in rallies that have started. Raises KernelError: of another game, or an invalid number."""
        put_player(self.opponents.players, number, policy, self.game)

    def reset(self, seed: int | None = None, rows: Bools | None = None) -> None:
        """Start the next rally or match in some rows, up to the learner's first stroke.

        Args:
            seed: restart with rally 0 of this seed; None: continue.
            rows: ``[B]`` mask of rows; None: all.
        """
        if seed is not None:
            self._seed_key = draws.stream(seed)[0]
            self.rows.rally[:] = np.arange(len(self)) - len(self)
            self.opponents.unseen[:] = 0
        which = np.ones(len(self), np.bool_) if rows is None else checked_array("rows", rows, np.bool_, (len(self),))
        self.cut(np.flatnonzero(which & self.rows.live), ABANDONED)
        _reset(*self._state, which, self._serving())

    def cut(self, rows: Intp, reason: int) -> None:
        """Note that the rallies of some rows end here, for a reason of :data:`shuttle_marl.game.rules.REASONS`.

        An illegal action of learners is theirs, so that a rally without strokes was to be served by them.
        """
        if self.tape is None or not len(rows):
            return
        at = rows, self.tape.used[rows]
        what = reason | self.opponents.seat[rows].astype(np.uint64) << 7 | self.opponents.opponent[rows].astype(np.uint64) << 8
        self.tape.code[at] = CUT | what << 32
        if self.matches is not None:
            score = np.hstack([self.matches.points[rows], self.matches.games[rows]]).astype(np.uint32)
            self.tape.score[at] = (score << np.arange(0, 32, 8, dtype=np.uint32)).sum(axis=1, dtype=np.uint32)
        self.tape.used[rows] += 1
        self.rows.live[rows] = False

    def step(
        self, stroke: Ints, position: Ints | None = None, *, reset: bool = True, observed: Observations | None = None
    ) -> tuple[F32, Bools]:
        """Play one stroke in every row, and the opponent's until the learner is to strike again.

        In the game with recovery a learner chooses strokes and positions in turn, so that each step is one stroke, and further
        ones where they have no choice.

        Args:
            stroke: ``[B]`` catalogue index of each striker's stroke; n + p for position p of a learner who is to choose one.
            position: ``[B]`` position of each receiver, in the game with recovery without opponents; else None.
            reset: whether rows whose rally or match is over start the next one in the same step.
            observed: output arrays for the observations after the step; None: not wanted.

        Returns:
            ``[B]`` float32 reward of the striker or learner (+1 won, -1 lost, 0 the rally continues), ``[B]`` whether it is over.

        Raises:
            IllegalStrokeError: an illegal stroke, or a row that is over; the batch is unchanged.
            KernelError: arrays of wrong shape or dtype; the batch is unchanged.
        """
        if observed is not None:
            self._check(observed)
        output = Output(np.empty(len(self), np.float32), np.empty(len(self), np.bool_), observed or NO_OBSERVATIONS)
        rank, place, serving = self._ranks(stroke), self._places(position), self._serving(reset=reset)
        in_slices(lambda a, b: _step(*self._state, self._other, rank, place, output, serving, (a, b)), len(self), self.threads)
        return output.reward, output.done

    def run(self, strokes: int) -> None:
        """Let every row play a number of random legal strokes by itself; rallies that end are followed by the next."""
        strokes, serving = whole_number("strokes", strokes, 0), self._serving()
        in_slices(lambda a, b: _run(self._tables, self.rows, serving, strokes, a, b), len(self), self.threads)

    def new_observations(self) -> Observations:
        """Allocate observations."""
        return Observations(*(np.empty(shape, kind) for shape, kind in self._shapes))

    def observe(self, observed: Observations) -> None:
        """Write the observation of each striker. Raises KernelError: arrays of wrong shape or dtype."""
        self._check(observed)
        in_slices(lambda a, b: observe_rows(self._tables, self.rows, self._other, observed, a, b), len(self), self.threads)

    def random_actions(self) -> tuple[I64, I64]:
        """``[B]`` random legal strokes or positions, by the next draws, and without opponents ``[B]`` random positions."""
        stroke, position = np.empty(len(self), np.int64), np.zeros(len(self), np.int64)
        args = (self._tables, self.rows, self._other, stroke, position)
        in_slices(lambda a, b: choose_uniform(*args, a, b), len(self), self.threads)
        return stroke, position

    @property
    def _shapes(self) -> tuple[tuple[tuple[int, int], type], tuple[tuple[int, int], type]]:
        """Shapes and types of :class:`Observations`."""
        tokens = TOKENS + self.game.hides
        return ((len(self), tokens), np.int32), ((len(self), self.game.n_actions), np.bool_)

    def _serving(self, *, reset: bool = True) -> Serving:
        return Serving(self._seed_key, self._server, reset)

    def _check(self, observed: Observations) -> None:
        for name, array, (shape, kind) in zip(("tokens", "mask"), observed, self._shapes, strict=True):
            core.check_room(name, array, kind, shape)

    def _ranks(self, stroke: Ints) -> I16:
        """``[B]`` position of each stroke among the legal strokes."""
        rank = self.ranks(stroke)
        if rank.min() < 0:
            row = int((rank < 0).argmax())
            self._refuse(row, int(stroke[row]))
        return rank

    def ranks(self, action: Ints) -> I16:
        """``[B]`` number of each action among the legal strokes, or among the feasible positions; -1 where it is illegal.

        Raises:
            KernelError: wrong shape, or not integers.
        """
        wanted, rank = checked_array("strokes", action, np.int64, (len(self),)), np.empty(len(self), np.int16)
        in_slices(lambda a, b: find_ranks(self._tables, self.rows, self._other, wanted, rank, a, b), len(self), self.threads)
        return rank

    @property
    def waits(self) -> Bools:
        """``[B]`` whether each learner is to choose a position."""
        return np.asarray(self.rows.striker == self._other)

    def _places(self, position: Ints | None) -> I16:
        """``[B]`` number of each position among the feasible ones; 0 where none is given."""
        if (position is not None) != self.joint:
            raise KernelError("positions are for rows without opponents in the game with recovery, and needed there")
        if position is None:
            return np.zeros(len(self), np.int16)
        wanted = checked_array("positions", position, np.int64, (len(self),))
        place = np.empty(len(self), np.int16)
        in_slices(lambda a, b: find_places(self._tables, self.rows, wanted, place, a, b), len(self), self.threads)
        if place.min() < 0:
            row = int((place < 0).argmax())
            where = self.game.describe(int(self.rows.state[row]))
            raise KernelError(f"row {row}: position {wanted[row]} is not feasible in state: {where}")
        return place

    def _refuse(self, row: int, stroke: int) -> None:
        if not self.rows.live[row]:
            raise IllegalStrokeError(f"row {row}: its rally is over; reset it first", stroke, row)
        names = self.game.action_names
        if not 0 <= stroke < len(names):
            raise IllegalStrokeError(f"row {row}: {stroke} is no stroke; expected 0 to {len(names) - 1}", stroke, row)
        where = self.game.describe(int(self.rows.state[row]))
        raise IllegalStrokeError(f"row {row}: stroke {stroke} ({names[stroke]}) is not legal in state: {where}", stroke, row)


class MatchBatch(RallyBatch):
    """B matches of a learner against tabulated opponents; row b plays matches b, b + B, b + 2 B, … of the seed.

    The draws are those of ``match_v0``. An illegal stroke loses the match. A match that ends before the learner's first stroke is
    counted in :attr:`unseen`, and the row continues with its next match.

    Args:
        opponents: K opponents, tabulated for this game; row b plays against opponent b modulo K.
        each_rally: whether every rally is rewarded, or only the match.
        **options: ``seed``, ``seat``, ``server`` of the first rally, ``threads`` and ``record``, as of :class:`RallyBatch`.

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
        rules: Rules = BWF,
        each_rally: bool = False,
        **options: Any,
    ) -> None:
        size = whole_number("batch", batch, 1)
        self.matches: MatchRows = MatchRows(
            key=np.empty(size, np.uint64),
            rally=np.zeros(size, np.int64),
            points=np.zeros((size, 2), np.int32),
            games=np.zeros((size, 2), np.int32),
            server=np.zeros(size, np.int8),
            owed=np.zeros(size, np.float32),
            reason=np.zeros(size, np.int8),
            rules=rules.as_tuple,
            each=int(each_rally),
        )
        super().__init__(game, batch, opponents=opponents, **options)

    def _ranks(self, stroke: Ints) -> I16:
        """``[B]`` position of each stroke among the legal strokes; 0 for an illegal one, which is noted as the reason."""
        wanted = checked_array("strokes", stroke, np.int64, (len(self),), 0, self.game.n_actions - 1)
        if not self.rows.live.all():
            self._refuse(int(np.argmin(self.rows.live)), 0)
        rank = self.ranks(wanted)
        self.matches.reason[rank < 0] = ILLEGAL
        return np.maximum(rank, 0)
