"""Whole rallies of a learner that acts from a table, summed up by state and stroke: millions of strokes a second.

A network need not be asked at every stroke: few states make up most of what is played, so it is asked once for each of them and
its answers are kept in a table. Rallies are then played from tables alone. Where one comes to a state whose entry is missing or
too old, it is put aside; when all rallies are played or aside, the network is asked about those states together, and the rallies
are played again: from the same draws and the same entries they come to the same states and on.

A rally is played to its end, so its advantages (Schulman et al. 2016) follow on the spot, with the values of the table. They are
summed up for each state and stroke, the positive and the negative ones apart: the clipped objective of PPO is linear in each of
the two, so its gradient over distinct pairs is that over all strokes.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.arrays import F32, I32, I64, Bools, Floats, Ints
from shuttle_marl.game import draws
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.checks import KernelError, checked_array, checked_number
from shuttle_marl.kernel.core import Players, Tables, pack, put, tables_of
from shuttle_marl.kernel.table_play import (
    NO_ROOM,
    Learned,
    Strokes,
    Sums,
    Tape,
    collect,
    longer,
    no_strokes,
    read_tape,
    replay,
    take,
    tape_for,
    write,
)
from shuttle_marl.kernel.table_rallies import START, TOO_LONG, Room, Starts, no_starts, room_for
from shuttle_marl.rally.record import Rallies, stroke_dtype

Assess = Callable[[I32], tuple[F32, F32]]
"""``[U]`` states to ``[U, n]`` logits of all strokes and ``[U]`` values to the striker."""

_WHOLE: Final = 1 << 16
_GUESS: Final = 4.0
"""Strokes of the learner in a rally, before the first is played."""
_LONG: Final = 256
"""Strokes of a rally for which there is room at first."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Distinct:
    """N strokes of a learner as U distinct states and R distinct strokes in them, one or two rows for each: that of its positive
    advantages and that of its negative ones.

    Attributes:
        state: ``[U]`` int32 states.
        visits: ``[U]`` float32 how many strokes were played in each.
        returns: ``[U]`` float32 mean of the lambda-returns there.
        start: ``[U + 1]`` int64 first row of each state.
        row: ``[R]`` int64 which of the states a row belongs to.
        stroke: ``[R]`` int64 catalogue index.
        log_probability: ``[R]`` float32 of the stroke when it was played.
        advantage: ``[R]`` float32 sum of the advantages.
        strokes: N.
        deviation: standard deviation of the N advantages.
        rallies: rallies that ended.
        won: of those the learner won, where it has an opponent.
        played: strokes of both players.
    """

    state: I32
    visits: F32
    returns: F32
    start: I64
    row: I64
    stroke: I64
    log_probability: F32
    advantage: F32
    strokes: int
    deviation: float
    rallies: int
    won: int
    played: int


class RallySampler:
    """Plays a learner's rallies against tabulated opponents, or against itself.

    Rally k of a seed has the draws of rally k in :class:`~shuttle_marl.kernel.VersusBatch` and
    :class:`~shuttle_marl.kernel.RallyBatch`; the learner sits at seat 0.

    Args:
        game: the tables.
        opponents: tabulated; none: both players are the learner.
        decay: lambda of the advantages.
        age: iterations for which an entry of the table may be used.
        shaping: ``[L * base pairs]`` what a stroke adds to the learner's reward, by own effort and base pair; None: nothing.

    Raises:
        KernelError: an opponent of another game, or a number out of its range.
    """

    def __init__(
        self,
        game: Game,
        opponents: Sequence[TabulatedPolicy] = (),
        *,
        decay: float = 1.0,
        age: int = 1,
        shaping: Floats | None = None,
    ) -> None:
        if not 0 <= decay <= 1 or age < 1:
            raise KernelError(f"decay {decay}, age {age}: expected 0 to 1, and 1 iteration or more")
        self.game, self._decay, self._age = game, float(decay), age
        self._tables = tables_of(game)
        learner = Players(np.zeros((1, game.n_pairs), np.uint16), np.zeros((1, game.n_states, 16), np.uint8))
        players = learner
        if opponents:
            packed = pack(opponents, game)
            players = Players(
                np.concatenate([learner.cumulative, packed.cumulative]), np.concatenate([learner.guide, packed.guide])
            )
        elif np.diff(game.pair_start).max() > 256:
            raise KernelError("a state has more than 256 legal strokes, more than the kernel's tables can count")
        states, pairs = game.n_states, game.n_pairs
        self._learned = Learned(players, np.zeros(pairs, np.float32), np.zeros(states, np.float32), np.zeros(states, np.int32))
        self._sums = Sums(
            np.zeros((pairs, 3), np.float32), np.zeros((states, 2), np.float32), np.zeros(states, np.int32), np.zeros(7)
        )
        none = np.zeros(0, np.float32)
        self._shaping = none if shaping is None else checked_array("shaping", shaping, np.float32, (game.limits[..., 0].size,))
        self._room = room_for(_LONG)
        self._opponents = np.arange(1, len(opponents) + 1, dtype=np.int32) if opponents else np.full(1, -1, np.int32)
        self._starts = no_starts()
        self._now = 0
        self._known = np.zeros(0, np.int32)
        self._untaken = False
        self.strokes = no_strokes()
        self._tape, self._note_next = tape_for(), False
        self.reset(0)

    @property
    def known(self) -> I32:
        """The states of the last iteration, whose entries are written again at the beginning of the next one."""
        return self._known

    def reset(self, seed: int, known: Ints | None = None) -> None:
        """Begin again with rally 0 of a seed. From here on, what is played depends on it, on ``known`` and on the network alone.

        Args:
            seed: names all draws.
            known: ``[U]`` states as :attr:`known` gave them; None: those it gives now.

        Raises:
            KernelError: a state that does not exist.
        """
        self._discard()
        self._seed_key = draws.stream(seed)[0]
        self._next, self._played, self._rallies = 0, 0.0, 0
        self._learned.written[:] = 0
        self._now = 0
        if known is not None:
            self._known = self._playable(known)

    def assign(self, opponents: Ints) -> None:
        """Say whom the learner meets.

        Args:
            opponents: ``[K]`` of rally r the opponent is number r modulo K: from 0 on those given, -1 the learner itself.

        Raises:
            KernelError: a number that is none of an opponent.
        """
        number = checked_array("opponents", opponents, np.int32, (len(opponents),), -1, len(self._learned.players.guide) - 2)
        self._opponents = np.where(number < 0, -1, number + 1).astype(np.int32)

    def restart(self, states: Ints, share: float) -> None:
        """Let some rallies of self-play begin in other states than the serve.

        Args:
            states: ``[M]`` one of them, equally likely.
            share: of the rallies, from 0 to 1.

        Raises:
            KernelError: a state that does not exist or has no legal strokes, or a share out of its range.
        """
        if not 0 <= share <= 1:
            raise KernelError(f"share {share}: expected 0 to 1")
        self._starts = Starts(self._playable(states), np.full(1, round(share * _WHOLE), np.int64))

    def _playable(self, states: Ints) -> I32:
        found = checked_array("states", states, np.int32, (len(states),), 0, self.game.n_states - 1)
        if not self.game.playable[found].all():
            raise KernelError("states: one has no legal strokes")
        return found

    def replace_opponent(self, number: int, policy: TabulatedPolicy) -> None:
        """Put another policy in the place of an opponent.

        Raises:
            KernelError: a policy of another game, or no such opponent.
        """
        if number < 0:
            raise KernelError(f"opponent number {number}: expected 0 or more")
        put(self._learned.players, number + 1, policy, self.game)

    def collect(self, count: int, assess: Assess, *, keep: bool = False) -> None:
        """Play rallies to their end until the learner has played a number of strokes; drops what was not taken before.

        Args:
            count: least number of strokes.
            assess: the network.
            keep: whether to keep the strokes one by one in :attr:`strokes`.

        Raises:
            KernelError: the network gives numbers that are not finite.
        """
        self._discard()
        self._now += 1
        self._untaken = True
        self._begin(count, keep=keep)
        self._first = self._next
        self._refresh(self._known, assess)
        while self._sums.total[0] < count:
            length = self._played / self._rallies if self._rallies else _GUESS
            wanted = max(1, math.ceil((count - self._sums.total[0]) / max(length, 0.5)))
            numbers = np.arange(self._next, self._next + wanted, dtype=np.int64)
            self._next += wanted
            before = self._sums.total[:2].copy()
            self._finish(numbers, assess)
            self._played += self._sums.total[0] - before[0]
            self._rallies += self._sums.total[1] - before[1]
        self._end()

    def _discard(self) -> None:
        """Drop what was collected and not taken, also by a network that failed."""
        if self._untaken:
            visited = self._sums.visited[: int(self._sums.total[6])]
            self._sums.state[visited] = 0
            self._sums.pair[self.game.pairs(visited)[1]] = 0
            self._untaken = False

    def _begin(self, count: int, *, keep: bool) -> None:
        """Make room for an iteration of about ``count`` strokes."""
        self._sums.total[:] = 0
        self.strokes, self._used = no_strokes(count + count // 8 + 1024 if keep else 0), 0
        if not self._note_next:
            self._tape = tape_for()
        elif not len(self._tape.rally):
            self._tape = tape_for(1024 + count // 4, 1024 + 2 * count)
        self._tape.used[:] = 0
        self._note_next = False

    @property
    def _oldest(self) -> int:
        """Iteration from which on an entry may be used."""
        return max(1, self._now - self._age + 1)

    def _finish(self, numbers: I64, assess: Assess) -> None:
        """Play these rallies, whatever entries they need, and add them up."""
        while len(numbers):
            aside, asked = np.empty_like(numbers), np.empty(len(numbers), np.int32)
            waiting, states, self._used, small = collect(
                self._tables,
                self._learned,
                self._opponents,
                self._starts,
                self._seed_key,
                numbers,
                self._oldest,
                self._decay,
                self._shaping,
                self._room,
                self._sums,
                self.strokes,
                self._used,
                self._tape,
                aside,
                asked,
            )
            if small == TOO_LONG:
                self._room = room_for(2 * self._room.rallies.state.shape[1])
            if small == NO_ROOM:
                self.strokes = Strokes._make([np.resize(column, 2 * len(column)) for column in self.strokes])
                self._tape = longer(self._tape)
            self._refresh(asked[:states], assess)
            numbers = aside[:waiting]

    def _end(self) -> None:
        """Note what was played in the iteration."""
        self.strokes = Strokes._make([column[: self._used] for column in self.strokes])
        self._known = self._sums.visited[: int(self._sums.total[6])].copy()

    def _refresh(self, states: I32, assess: Assess) -> None:
        self._learned.written[states] = 0  # what is asked for is asked for again should the network fail
        for first in range(0, len(states), 1 << 13):
            part = np.ascontiguousarray(states[first : first + (1 << 13)])
            logits, value = assess(part)
            logits = checked_array("logits", logits, np.float32, (len(part), self.game.n_strokes))
            value = checked_array("values", value, np.float32, (len(part),))
            wrong = write(self._tables, self._learned, part, logits, value, self._now)
            if wrong >= 0:
                raise KernelError(f"the network gives no finite numbers in state: {self.game.describe(int(part[wrong]))}")

    def take(self, order: Ints | None = None) -> Distinct:
        """Hand over the strokes as distinct states; the sums begin again at zero.

        Args:
            order: ``[U]`` numbers from 0 to U - 1, the order in which the states of :attr:`known` come; None: by number of state.
        """
        known, self._untaken = self._known, False
        states = np.sort(known) if order is None else known[np.asarray(order)]
        room = 2 * min(int(self.game.legal_count(states).sum()), int(self._sums.total[0]))
        row, stroke = np.empty(room, np.int64), np.empty(room, np.int64)
        log_probability, advantage = np.empty(room, np.float32), np.empty(room, np.float32)
        start = np.empty(len(states) + 1, np.int64)
        visits, returns = np.empty(len(states), np.float32), np.empty(len(states), np.float32)
        args = (states, start, row, stroke, log_probability, advantage, visits, returns)
        rows = take(self._tables, self._learned, self._sums, *args)
        return Distinct(
            state=states,
            visits=visits,
            returns=returns,
            start=start,
            row=row[:rows],
            stroke=stroke[:rows],
            log_probability=log_probability[:rows],
            advantage=advantage[:rows],
            **self._counted(),
        )

    def _counted(self) -> dict[str, Any]:
        """The numbers of :class:`Distinct` that are about all strokes."""
        count, rallies, won, total, squares, played = self._sums.total[:6].tolist()
        return {
            "strokes": int(count),
            "deviation": math.sqrt(max(squares / count - (total / count) ** 2, 0.0)),
            "rallies": int(rallies),
            "won": int(won),
            "played": int(played),
        }

    @property
    def count(self) -> int:
        """Strokes of the learner in the last iteration."""
        return int(self._sums.total[0])

    @property
    def numbers(self) -> I64:
        """``[R]`` numbers of the rallies of the last iteration."""
        return np.arange(self._first, self._next, dtype=np.int64)

    def usual(self, numbers: Ints) -> Bools:
        """``[R]`` which rallies begin with a serve, and in self-play are played by the learner alone."""
        opponent = self._opponents[numbers % len(self._opponents)]
        if not (self._opponents < 0).any():
            return np.ones(len(numbers), np.bool_)
        if not len(self._starts.states):
            return opponent < 0
        bits = draws.draw(draws.extend(np.full(1, self._seed_key), numbers), int(START))
        return (opponent < 0) & ((bits & np.uint64(_WHOLE - 1)).astype(np.int64) >= self._starts.share[0])

    def note_next(self) -> None:
        """Note the rallies of the next iteration while they are played, so that :meth:`record` need not play them again."""
        self._note_next = True

    def record(self, numbers: Ints, *, figures: bool = False) -> Rallies:
        """Rallies of the last iteration, for a log; to be called before the next iteration.

        Args:
            numbers: ``[R]`` of :attr:`numbers`, of those that begin with a serve.
            figures: whether to return ``log_probability`` and ``value`` of the learner's strokes.

        Returns:
            The rallies; ``match`` is their number, policy 0 is the learner, policy 1 + k opponent k.

        Raises:
            KernelError: a rally that was not played in the last iteration.
        """
        number = checked_array("rallies", numbers, np.int64, (len(numbers),), self._first, self._next - 1)
        tape = self._tape if self._tape.used[0] else self._replayed(number)
        return _rallies_of(self._tables, self._learned, self._opponents, tape, number, figures=figures)

    def _replayed(self, numbers: I64) -> Tape:
        """Rallies of the last iteration, played again."""
        mean = self._sums.total[5] / max(1.0, self._sums.total[1])
        tape = tape_for(len(numbers), 4096 + int(1.25 * len(numbers) * mean))
        tape, self._room = _played_again(self._tables, self._learned, self._opponents, self._seed_key, numbers, self._room, tape)
        return tape


def play_rallies(game: Game, policies: tuple[TabulatedPolicy, TabulatedPolicy], n: int, *, seed: int = 0) -> Rallies:
    """Play the first n rallies of a seed, with the draws of the first n episodes of ``rally_v0``.

    Args:
        game: the game.
        policies: policies at seats 0 and 1.
        n: number of rallies.
        seed: random seed.

    Returns:
        The rallies; ``match`` is their number, ``policy`` 0 and 1.

    Raises:
        KernelError: fewer than one rally, or a policy of another game.
    """
    numbers = np.arange(checked_number("rallies", n, 1), dtype=np.int64)
    none = np.empty(0, np.float32)
    learned = Learned(pack(policies, game), none, none, np.zeros(game.n_states, np.int32))
    tables, opponents, room, tape = tables_of(game), np.ones(1, np.int32), room_for(_LONG), tape_for(n, 16 * n)
    tape, _ = _played_again(tables, learned, opponents, draws.stream(seed)[0], numbers, room, tape)
    return _rallies_of(tables, learned, opponents, tape, numbers, figures=False)


def _played_again(
    tables: Tables, learned: Learned, opponents: I32, seed_key: np.uint64, numbers: I64, room: Room, tape: Tape
) -> tuple[Tape, Room]:
    """Play rallies onto a tape; both the tape and the room grow as needed."""
    while len(numbers):
        numbers = numbers[replay(tables, learned, opponents, no_starts(), seed_key, numbers, room, tape) :]
        if len(numbers):
            tape, room = longer(tape), room_for(2 * room.rallies.state.shape[1])
    return tape, room


def _rallies_of(tables: Tables, learned: Learned, opponents: I32, tape: Tape, number: I64, *, figures: bool) -> Rallies:
    """Rallies of a tape by their numbers ``[R]``."""
    rally, lengths = tape.rally[: tape.used[0]], tape.length[: tape.used[0]]
    order = np.argsort(rally, kind="stable")
    rows = order[np.searchsorted(rally, number, sorter=order)]
    start, length = (np.cumsum(lengths, dtype=np.int64) - lengths)[rows], lengths[rows]
    count = int(length.sum(dtype=np.int64))
    stroke = np.empty(count, stroke_dtype(tables.rank.shape[1]))
    extra = np.empty((2 if figures else 0, count), np.float32)
    read_tape(tables, learned, opponents, tape, rows, start, stroke, extra)
    server, winner, reason = tape.ended[:, rows]
    policy = np.zeros((len(number), 2), np.uint16)
    policy[:, 1] = np.maximum(opponents[number % len(opponents)], 0)
    return Rallies(
        pairing=np.zeros(len(number), np.uint32),
        match=number.astype(np.uint32),
        rally=np.zeros(len(number), np.uint16),
        policy=policy,
        server=server,
        winner=winner,
        reason=reason,
        score=np.zeros((len(number), 4), np.uint8),
        length=length,
        stroke=stroke,
        log_probability=extra[0] if figures else None,
        value=extra[1] if figures else None,
    )
