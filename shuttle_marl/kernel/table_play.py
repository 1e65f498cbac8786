"""Passes over whole rallies of a learner that acts from a table, compiled: to play them, to add them up, and to take the sums.

:mod:`shuttle_marl.kernel.sampling` says what they are for and calls them; it checks every array that comes from outside.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.game import draws
from shuttle_marl.game.rally import FAULT, WINNER
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
    table_choice,
)

Ints = npt.NDArray[np.int32]
Longs = npt.NDArray[np.int64]
Singles = npt.NDArray[np.float32]

OPEN: Final = 2
"""Outcome of a rally that is not over."""
STALE, TOO_LONG, NO_ROOM = -1, -2, -3
START: Final = np.uint64(1 << 40)
"""Names the draw that says where a rally begins; no rally has so many strokes."""
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
    """Sums of an iteration, by state and stroke.

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


class Rally(NamedTuple):
    """Room for the strokes of a rally."""

    state: Ints
    pair: Ints
    limit: Ints


def no_strokes(room: int = 0) -> Strokes:
    """Room for a list of strokes."""
    return Strokes(*(np.empty(room, kind) for kind in ("i4", "i4", "i4", "f4", "f4")))


class Starts(NamedTuple):
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
    bits = draw(key, START)
    if np.int64(bits & np.uint64(0xFFFF)) >= starts.share[0]:
        return np.int64(0)
    return np.int64(starts.states[np.int64(((bits >> np.uint64(32)) * np.uint64(starts.states.size)) >> np.uint64(32))])


@inlined
def _play(tables: Any, learned: Any, opponent: Any, start: Any, key: Any, oldest: Any, rally: Any) -> Any:
    """Play a rally from a state on; returns its length, its server and the outcome of its last stroke.

    The length is STALE where an entry is missing, whose state is then the server; TOO_LONG where there is no room for it.
    """
    bits = draw(key, 0)
    server = first_server(bits)
    striker, s, t = server, np.int64(start), np.int64(0)
    while True:
        player = opponent if opponent >= 0 and striker == 1 else 0
        if player == 0 and learned.written[s] < oldest:
            return np.int64(STALE), s, np.int64(OPEN)
        if t == rally.state.size:
            return np.int64(TOO_LONG), s, np.int64(OPEN)
        of = block_of(tables, s)
        head = tables.head[np.uint64(s - tables.first[of, 0])]
        first = head[0] + tables.first[of, 1]
        k = table_choice(learned.players, player, s, first, bits)
        limit = head[0] + k + tables.first[of, 2]
        rally.state[t], rally.pair[t], rally.limit[t] = s, first + k, limit
        t += 1
        outcome = outcome_of(tables.limits[np.uint64(limit)], bits)
        if outcome < OPEN:
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
def collect(
    tables: Tables,
    learned: Learned,
    opponents: Ints,
    starts: Starts,
    seed_key: np.uint64,
    numbers: Longs,
    oldest: int,
    decay: float,
    shaping: Singles,
    rally: Rally,
    sums: Sums,
    strokes: Strokes,
    used: int,
    aside: Longs,
    asked: Ints,
) -> tuple[int, int, int, int]:
    """Play rallies and add them up; returns how many were put aside, how many states are asked for, how many places of the
    list are used, and what room is too small: TOO_LONG, NO_ROOM or 0."""
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
            if length == STALE:
                if learned.written[server] >= 0:
                    asked[states] = server
                    states += 1
                    learned.written[server] = -1
            else:
                small = TOO_LONG if length == TOO_LONG else NO_ROOM
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
def write(tables: Tables, learned: Learned, states: Ints, logits: Singles, value: Singles, now: int) -> int:
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
def take(
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
def record(
    tables: Tables,
    learned: Learned,
    opponents: Ints,
    seed_key: np.uint64,
    numbers: Longs,
    rally: Rally,
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
