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
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.game import draws
from shuttle_marl.game.rally import FAULT, WINNER, Game
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.kernel.compiling import compiled, inlined
from shuttle_marl.kernel.core import (
    Players,
    Tables,
    arrival_of,
    block_of,
    draw,
    extend,
    first_server,
    next_state,
    outcome_of,
    pack,
    put,
    table_choice,
    tables_of,
)
from shuttle_marl.kernel.uncompiled import KernelError, SingleRallies, checked_array, stroke_type

Ints = npt.NDArray[np.int32]
Longs = npt.NDArray[np.int64]
Singles = npt.NDArray[np.float32]
Assess = Callable[[Ints], tuple[Singles, Singles]]
"""``[U]`` states to ``[U, n]`` logits of all strokes and ``[U]`` values to the striker."""

_OPEN: Final = 2
"""Outcome of a rally that is not over."""
_STALE, _TOO_LONG, _NO_ROOM = -1, -2, -3
_START: Final = np.uint64(1 << 40)
"""Names the draw that says where a rally begins; no rally has so many strokes."""
_WHOLE: Final = 1 << 16
_GUESS: Final = 4.0
"""Strokes of the learner in a rally, before the first is played."""
_CHOICE_ONE: Final = np.float32(draws.CHOICE_ONE)


class Learned(NamedTuple):
    """The learner's table, filled where play leads.

    Attributes:
        players: the learner, and behind it its opponents.
        log_probability: ``[P]`` of the legal pairs.
        value: ``[S]`` to the striker.
        written: ``[S]`` int32 when an entry was written; 0 for never, -1 where it is asked for.
    """

    players: Players
    log_probability: Singles
    value: Singles
    written: Ints


class Sums(NamedTuple):
    """What was played, by state and stroke.

    Attributes:
        pair: ``[P, 3]`` number of strokes, sum of their positive advantages, and of their negative ones.
        state: ``[S, 2]`` number of strokes, and sum of the returns.
        visited: ``[S]`` the states that were visited, in the order of their first visit.
        total: ``[7]`` strokes of the learner, rallies, rallies won, sum of the advantages, sum of their squares, strokes of both
            players, and states visited.
    """

    pair: Singles
    state: Singles
    visited: Ints
    total: npt.NDArray[np.float64]


class Strokes(NamedTuple):
    """The learner's strokes one by one, in the order of the rallies; no room where no one asks.

    Attributes:
        state: ``[N]`` where it was played.
        pair: ``[N]`` legal pair.
        following: ``[N]`` the next state of the learner (in self-play: of the opponent), -1 where the rally ends before.
        reward: ``[N]`` with what shaping adds.
        advantage: ``[N]`` lambda-weighted, by the values of the table.
    """

    state: Ints
    pair: Ints
    following: Ints
    reward: Singles
    advantage: Singles


class _Rally(NamedTuple):
    """Room for the strokes of a rally."""

    state: Ints
    pair: Ints
    limit: Ints


def _no_strokes(room: int = 0) -> Strokes:
    return Strokes(*(np.empty(room, kind) for kind in ("i4", "i4", "i4", "f4", "f4")))


class _Starts(NamedTuple):
    """States in which some rallies of self-play begin.

    Attributes:
        states: ``[M]`` one of them, equally likely.
        share: ``[1]`` of the rallies, in units of 1/65536.
    """

    states: Ints
    share: Longs


@inlined
def _start(starts: Any, opponent: Any, key: Any) -> Any:
    """State in which a rally begins: the serve, or one that is drawn."""
    if starts.states.size == 0 or opponent >= 0:
        return np.int64(0)
    bits = draw(key, _START)
    if np.int64(bits & np.uint64(0xFFFF)) >= starts.share[0]:
        return np.int64(0)
    return np.int64(starts.states[np.int64(((bits >> np.uint64(32)) * np.uint64(starts.states.size)) >> np.uint64(32))])


@inlined
def _play(tables: Any, learned: Any, opponent: Any, start: Any, key: Any, oldest: Any, rally: Any) -> Any:
    """Play a rally from a state on; returns its length, its server and the outcome of its last stroke.

    The length is _STALE where an entry is missing, whose state is then the server; _TOO_LONG where there is no room for it.
    """
    bits = draw(key, 0)
    server = first_server(bits)
    striker, s, t = server, np.int64(start), np.int64(0)
    while True:
        player = opponent if opponent >= 0 and striker == 1 else 0
        if player == 0 and learned.written[s] < oldest:
            return np.int64(_STALE), s, np.int64(_OPEN)
        if t == rally.state.size:
            return np.int64(_TOO_LONG), s, np.int64(_OPEN)
        of = block_of(tables, s)
        head = tables.head[np.uint64(s - tables.first[of, 0])]
        first = head[0] + tables.first[of, 1]
        k = table_choice(learned.players, player, s, first, bits)
        limit = head[0] + k + tables.first[of, 2]
        rally.state[t], rally.pair[t], rally.limit[t] = s, first + k, limit
        t += 1
        outcome = outcome_of(tables.limits[np.uint64(limit)], bits)
        if outcome < _OPEN:
            return t, server, outcome
        s = np.int64(next_state(arrival_of(tables, of, np.uint64(head[2] + k)), outcome))
        striker ^= 1
        bits = draw(key, t)


@inlined
def _add(learned: Any, sums: Any, strokes: Any, at: Any, s: Any, pair: Any, following: Any, reward: Any, a: Any) -> None:
    """Add a stroke with its advantage to the sums, and to the list at a place if there is one."""
    if sums.state[s, 0] == 0:
        sums.visited[np.int64(sums.total[6])] = s
        sums.total[6] += 1
    sums.state[s, 0] += 1
    sums.state[s, 1] += a + learned.value[s]
    sums.pair[pair, 0] += 1
    if a > 0:
        sums.pair[pair, 1] += a
    else:
        sums.pair[pair, 2] += a
    sums.total[0] += 1
    sums.total[3] += a
    sums.total[4] += a * a
    if at >= 0:
        strokes.state[at], strokes.pair[at], strokes.following[at] = s, pair, following
        strokes.reward[at], strokes.advantage[at] = reward, a


@inlined
def _credit_both(learned: Any, sums: Any, strokes: Any, first: Any, rally: Any, length: Any, reward: Any, decay: Any) -> None:
    """Add all strokes of a rally in which both players learn; each value is that of its striker."""
    a, after, following = 0.0, 0.0, -1
    for t in range(length - 1, -1, -1):
        s = rally.state[t]
        won = reward if t == length - 1 else 0.0
        a = won - after - learned.value[s] - decay * a
        _add(learned, sums, strokes, first + t if first >= 0 else -1, s, rally.pair[t], following, won, a)
        after, following = learned.value[s], s


@inlined
def _credit(
    learned: Any, sums: Any, strokes: Any, first: Any, rally: Any, begin: Any, length: Any, reward: Any, decay: Any, shaping: Any
) -> None:
    """Add the learner's strokes of a rally, every other one from ``begin`` on."""
    a, after, following, won = 0.0, 0.0, -1, reward
    last = (length - 1 - begin) // 2
    for j in range(last, -1, -1):
        t = begin + 2 * j
        s = rally.state[t]
        if shaping.size > 0:
            won += shaping[rally.limit[t]]
        a = won + after - learned.value[s] + decay * a
        _add(learned, sums, strokes, first + j if first >= 0 else -1, s, rally.pair[t], following, won, a)
        after, following, won = learned.value[s], s, 0.0


@compiled
def _collect(
    tables: Tables,
    learned: Learned,
    opponents: Ints,
    starts: _Starts,
    seed_key: np.uint64,
    numbers: Longs,
    oldest: int,
    decay: float,
    shaping: Singles,
    rally: _Rally,
    sums: Sums,
    strokes: Strokes,
    used: int,
    aside: Longs,
    asked: Ints,
) -> tuple[int, int, int, int]:
    """Play rallies and add them up; returns how many were put aside, how many states are asked for, how many places of the
    list are used, and what room is too small: _TOO_LONG, _NO_ROOM or 0."""
    waiting, states, small = 0, 0, 0
    for r in range(numbers.size):
        number = numbers[r]
        opponent = opponents[number % opponents.size]
        key = extend(seed_key, number)
        length, server, outcome = _play(tables, learned, opponent, _start(starts, opponent, key), key, oldest, rally)
        begin = 0 if opponent < 0 else server
        own = length if opponent < 0 else (length - begin + 1) // 2
        listed = strokes.state.size > 0
        if length < 0 or (listed and used + own > strokes.state.size):
            aside[waiting] = number
            waiting += 1
            if length == _STALE:
                if learned.written[server] >= 0:
                    asked[states] = server
                    states += 1
                    learned.written[server] = -1
            else:
                small = _TOO_LONG if length == _TOO_LONG else _NO_ROOM
            continue
        reward = 2.0 * outcome - 1.0
        sums.total[1] += 1
        sums.total[5] += length
        first = used if listed else -1
        if opponent < 0:
            _credit_both(learned, sums, strokes, first, rally, length, reward, decay)
        else:
            if (server + length - 1) & 1:
                reward = -reward
            sums.total[2] += reward > 0
            _credit(learned, sums, strokes, first, rally, begin, length, reward, decay, shaping)
        used += own if listed else 0
    return waiting, states, used, small


@compiled
def _write(tables: Tables, learned: Learned, states: Ints, logits: Singles, value: Singles, now: int) -> int:
    """Write the entries of some states; returns the first whose numbers are not finite, or -1."""
    for i in range(states.size):
        s = states[i]
        of = block_of(tables, s)
        head = tables.head[np.uint64(s - tables.first[of, 0])]
        start, count = head[0] + tables.first[of, 1], head[1]
        highest = np.float32(-np.inf)
        for k in range(count):
            highest = max(highest, logits[i, tables.stroke[np.uint64(head[2] + k)]])
        total = np.float32(0)
        for k in range(count):
            weight = np.exp(logits[i, tables.stroke[np.uint64(head[2] + k)]] - highest)
            learned.log_probability[start + k] = weight
            total += weight
        if not (np.isfinite(total) and np.isfinite(highest) and np.isfinite(value[i])):
            return i
        part, scale, sum_log = np.float32(0), _CHOICE_ONE / total, np.log(total) + highest
        cumulative = learned.players.cumulative[0]
        for k in range(count):
            part += learned.log_probability[start + k]
            cumulative[start + k] = np.uint16(min(part * scale, _CHOICE_ONE) + np.float32(0.5))
            learned.log_probability[start + k] = logits[i, tables.stroke[np.uint64(head[2] + k)]] - sum_log
        cumulative[start + count - 1] = draws.CHOICE_ONE
        guide, k = learned.players.guide[0, s], 0
        for high in range(guide.size):
            while cumulative[start + k] <= high << 12:
                k += 1
            guide[high] = k
        learned.value[s], learned.written[s] = value[i], now
    return -1


@compiled
def _take(
    tables: Tables,
    learned: Learned,
    sums: Sums,
    states: Ints,
    start: Longs,
    row: Longs,
    stroke: Longs,
    log_probability: Singles,
    advantage: Singles,
    visits: Singles,
    returns: Singles,
) -> int:
    """Move the sums of some states out; returns the number of rows, two for a pair with advantages of both signs."""
    rows = 0
    for i in range(states.size):
        s = states[i]
        start[i] = rows
        visits[i], returns[i] = sums.state[s, 0], sums.state[s, 1] / sums.state[s, 0]
        sums.state[s, :] = 0
        of = block_of(tables, s)
        head = tables.head[np.uint64(s - tables.first[of, 0])]
        first = head[0] + tables.first[of, 1]
        for k in range(head[1]):
            pair = first + k
            if sums.pair[pair, 0] == 0:
                continue
            for sign in range(1, 3):
                if sums.pair[pair, sign] != 0:
                    row[rows], stroke[rows] = i, tables.stroke[np.uint64(head[2] + k)]
                    log_probability[rows], advantage[rows] = learned.log_probability[pair], sums.pair[pair, sign]
                    rows += 1
            sums.pair[pair, :] = 0
    start[states.size] = rows
    return rows


@compiled
def _record(
    tables: Tables,
    learned: Learned,
    opponents: Ints,
    seed_key: np.uint64,
    numbers: Longs,
    rally: _Rally,
    lengths: Ints,
    ended: npt.NDArray[np.uint8],
    stroke: npt.NDArray[np.unsignedinteger],
    figures: Singles,
) -> int:
    """Play rallies again for a log; returns their strokes, or what they would need beyond the room there is, negative."""
    n, room = 0, stroke.size
    for r in range(numbers.size):
        opponent = opponents[numbers[r] % opponents.size]
        key = extend(seed_key, numbers[r])
        length, server, outcome = _play(tables, learned, opponent, np.int64(0), key, np.int32(-(1 << 30)), rally)
        lengths[r] = length
        last = (server + length - 1) & 1
        ended[0, r], ended[1, r], ended[2, r] = server, last ^ (1 - outcome), WINNER if outcome else FAULT
        for t in range(length):
            if n + t < room:
                s, pair = rally.state[t], rally.pair[t]
                of = block_of(tables, s)
                head = tables.head[np.uint64(s - tables.first[of, 0])]
                stroke[n + t] = tables.stroke[np.uint64(head[2] + pair - head[0] - tables.first[of, 1])]
                own = opponent < 0 or (server + t) & 1 == 0
                if figures.shape[0] > 0:
                    figures[0, n + t] = learned.log_probability[pair] if own else np.nan
                    figures[1, n + t] = learned.value[s] if own else np.nan
        n += length
    return n if n <= room else -n


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

    state: Ints
    visits: Singles
    returns: Singles
    start: Longs
    row: Longs
    stroke: Longs
    log_probability: Singles
    advantage: Singles
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
        shaping: npt.NDArray[np.floating] | None = None,
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
        self._rally = _Rally(*(np.empty(256, np.int32) for _ in range(3)))
        self._opponents = np.arange(1, len(opponents) + 1, dtype=np.int32) if opponents else np.full(1, -1, np.int32)
        self._starts = _Starts(np.zeros(0, np.int32), np.zeros(1, np.int64))
        self._now = 0
        self._known = np.zeros(0, np.int32)
        self.strokes = _no_strokes()
        self.reset(0)

    @property
    def known(self) -> Ints:
        """The states of the last iteration, whose entries are written again at the beginning of the next one."""
        return self._known

    def reset(self, seed: int, known: npt.NDArray[np.integer] | None = None) -> None:
        """Begin again with rally 0 of a seed. From here on, what is played depends on it, on ``known`` and on the network alone.

        Args:
            seed: names all draws.
            known: ``[U]`` states as :attr:`known` gave them; None: those it gives now.

        Raises:
            KernelError: a state that does not exist.
        """
        self._seed_key = draws.stream(seed)[0]
        self._next, self._played, self._rallies = 0, 0.0, 0
        self._learned.written[:] = 0
        self._now = 0
        if known is not None:
            self._known = self._playable(known)

    def assign(self, opponents: npt.NDArray[np.integer]) -> None:
        """Say whom the learner meets.

        Args:
            opponents: ``[K]`` of rally r the opponent is number r modulo K: from 0 on those given, -1 the learner itself.

        Raises:
            KernelError: a number that is none of an opponent.
        """
        number = checked_array("opponents", opponents, np.int32, (len(opponents),), -1, len(self._learned.players.guide) - 2)
        self._opponents = np.where(number < 0, -1, number + 1).astype(np.int32)

    def restart(self, states: npt.NDArray[np.integer], share: float) -> None:
        """Let some rallies of self-play begin in other states than the serve.

        Args:
            states: ``[M]`` one of them, equally likely.
            share: of the rallies, from 0 to 1.

        Raises:
            KernelError: a state that does not exist or has no legal strokes, or a share out of its range.
        """
        if not 0 <= share <= 1:
            raise KernelError(f"share {share}: expected 0 to 1")
        self._starts = _Starts(self._playable(states), np.full(1, round(share * _WHOLE), np.int64))

    def _playable(self, states: npt.NDArray[np.integer]) -> Ints:
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
        """Play rallies to their end until the learner has played a number of strokes.

        Args:
            count: least number of strokes.
            assess: the network.
            keep: whether to keep the strokes one by one in :attr:`strokes`.

        Raises:
            KernelError: the network gives numbers that are not finite.
        """
        self._now += 1
        self._sums.total[:] = 0
        self.strokes, used = _no_strokes(count + count // 8 + 1024 if keep else 0), 0
        self._first = self._next
        self._refresh(self._known, assess)
        while self._sums.total[0] < count:
            length = self._played / self._rallies if self._rallies else _GUESS
            wanted = max(1, math.ceil((count - self._sums.total[0]) / max(length, 0.5)))
            numbers = np.arange(self._next, self._next + wanted, dtype=np.int64)
            self._next += wanted
            before = self._sums.total[:2].copy()
            used = self._finish(numbers, assess, used)
            self._played += self._sums.total[0] - before[0]
            self._rallies += self._sums.total[1] - before[1]
        self.strokes = Strokes._make([column[:used] for column in self.strokes])
        self._known = self._sums.visited[: int(self._sums.total[6])].copy()

    def _finish(self, numbers: Longs, assess: Assess, used: int) -> int:
        """Play these rallies, whatever entries they need; returns how many strokes are kept."""
        oldest = max(1, self._now - self._age + 1)
        while len(numbers):
            aside, asked = np.empty_like(numbers), np.empty(len(numbers), np.int32)
            waiting, states, used, small = _collect(
                self._tables,
                self._learned,
                self._opponents,
                self._starts,
                self._seed_key,
                numbers,
                oldest,
                self._decay,
                self._shaping,
                self._rally,
                self._sums,
                self.strokes,
                used,
                aside,
                asked,
            )
            if small == _TOO_LONG:
                self._rally = _Rally(*(np.empty(2 * len(part), np.int32) for part in self._rally))
            if small == _NO_ROOM:
                self.strokes = Strokes._make([np.resize(column, 2 * len(column)) for column in self.strokes])
            self._refresh(asked[:states], assess)
            numbers = aside[:waiting]
        return used

    def _refresh(self, states: Ints, assess: Assess) -> None:
        self._learned.written[states] = 0  # what is asked for is asked for again should the network fail
        for first in range(0, len(states), 1 << 13):
            part = np.ascontiguousarray(states[first : first + (1 << 13)])
            logits, value = assess(part)
            logits = checked_array("logits", logits, np.float32, (len(part), self.game.n_strokes))
            value = checked_array("values", value, np.float32, (len(part),))
            wrong = _write(self._tables, self._learned, part, logits, value, self._now)
            if wrong >= 0:
                raise KernelError(f"the network gives no finite numbers in state: {self.game.describe(int(part[wrong]))}")

    def take(self, order: npt.NDArray[np.integer] | None = None) -> Distinct:
        """What was collected, as distinct states; the sums begin again at zero.

        Args:
            order: ``[U]`` numbers from 0 to U - 1, the order in which the states of :attr:`known` come; None: by number of state.
        """
        known = self._known
        states = np.sort(known) if order is None else known[np.asarray(order)]
        room = 2 * min(int(self.game.legal_count(states).sum()), int(self._sums.total[0]))
        row, stroke = np.empty(room, np.int64), np.empty(room, np.int64)
        log_probability, advantage = np.empty(room, np.float32), np.empty(room, np.float32)
        start = np.empty(len(states) + 1, np.int64)
        visits, returns = np.empty(len(states), np.float32), np.empty(len(states), np.float32)
        args = (states, start, row, stroke, log_probability, advantage, visits, returns)
        rows = _take(self._tables, self._learned, self._sums, *args)
        count, rallies, won, total, squares, played = self._sums.total[:6].tolist()
        return Distinct(
            state=states,
            visits=visits,
            returns=returns,
            start=start,
            row=row[:rows],
            stroke=stroke[:rows],
            log_probability=log_probability[:rows],
            advantage=advantage[:rows],
            strokes=int(count),
            deviation=math.sqrt(max(squares / count - (total / count) ** 2, 0.0)),
            rallies=int(rallies),
            won=int(won),
            played=int(played),
        )

    @property
    def count(self) -> int:
        """Strokes of the learner in the last iteration."""
        return int(self._sums.total[0])

    @property
    def numbers(self) -> Longs:
        """``[R]`` numbers of the rallies of the last iteration."""
        return np.arange(self._first, self._next, dtype=np.int64)

    def usual(self, numbers: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
        """``[R]`` which rallies begin with a serve, and in self-play are played by the learner alone."""
        opponent = self._opponents[numbers % len(self._opponents)]
        if not (self._opponents < 0).any():
            return np.ones(len(numbers), np.bool_)
        if not len(self._starts.states):
            return opponent < 0
        bits = draws.draw(draws.extend(np.full(1, self._seed_key), numbers), int(_START))
        return (opponent < 0) & ((bits & np.uint64(_WHOLE - 1)).astype(np.int64) >= self._starts.share[0])

    def record(self, numbers: npt.NDArray[np.integer], *, figures: bool = False) -> SingleRallies:
        """Some rallies of the last iteration as they were played, for a log; before the next iteration.

        Args:
            numbers: ``[R]`` of :attr:`numbers`, of those that begin with a serve.
            figures: whether to give the log-probability and the value of every stroke of the learner.

        Raises:
            KernelError: a rally that was not played in the last iteration.
        """
        highest = self._next - 1
        number = checked_array("rallies", numbers, np.int64, (len(numbers),), self._first, highest)
        lengths, ended = np.empty(len(number), np.int32), np.empty((3, len(number)), np.uint8)
        room = 4096 + int(1.25 * len(number) * max(1.0, self._sums.total[5] / max(1.0, self._sums.total[1])))
        while True:
            stroke = np.empty(room, stroke_type(self.game))
            extra = np.empty((2 if figures else 0, room), np.float32)
            args = (number, self._rally, lengths, ended, stroke, extra)
            used = _record(self._tables, self._learned, self._opponents, self._seed_key, *args)
            if used >= 0:
                break
            room = -used
        return SingleRallies(
            rally=number,
            opponent=np.maximum(self._opponents[number % len(self._opponents)] - 1, 0),
            server=ended[0],
            winner=ended[1],
            reason=ended[2],
            length=lengths,
            stroke=stroke[:used],
            extra=extra[:, :used],
        )
