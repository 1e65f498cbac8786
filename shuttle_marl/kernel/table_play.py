"""Passes over whole rallies of a learner that acts from a table, compiled: to play them, to add them up, and to take the sums.

:mod:`shuttle_marl.kernel.sampling` says what they are for and calls them; it checks every array that comes from outside.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.arrays import F32, F64, I32, I64, U8, UInts
from shuttle_marl.game import draws
from shuttle_marl.game.rules import FAULT, WINNER
from shuttle_marl.kernel.compiling import compiled, inlined
from shuttle_marl.kernel.core import BLOCK, Players, Tables, block_of
from shuttle_marl.kernel.table_rallies import STALE, TOO_LONG, Room, Starts, play

NO_ROOM: Final = -3
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
    log_probability: F32
    value: F32
    written: I32


class Sums(NamedTuple):
    """Sums of an iteration, by state and stroke.

    Attributes:
        pair: ``[P, 3]`` number of strokes, sum of their positive advantages, and of their negative ones.
        state: ``[S, 2]`` number of strokes, and sum of the returns.
        visited: ``[S]`` the states that were visited, in the order of their first visit.
        total: ``[7]`` strokes of the learner, rallies, rallies won, sum of the advantages, sum of their squares, strokes of both
            players, and states visited.
    """

    pair: F32
    state: F32
    visited: I32
    total: F64


class Strokes(NamedTuple):
    """The learner's strokes one by one, in the order of the rallies; no room where no one asks.

    Attributes:
        state: ``[N]`` where it was played.
        pair: ``[N]`` legal pair.
        following: ``[N]`` the next state of the learner (in self-play: of the opponent), -1 where the rally ends before.
        reward: ``[N]`` with what shaping adds.
        advantage: ``[N]`` lambda-weighted, by the values of the table.
    """

    state: I32
    pair: I32
    following: I32
    reward: F32
    advantage: F32


def no_strokes(room: int = 0) -> Strokes:
    """Room for a list of strokes."""
    return Strokes(*(np.empty(room, kind) for kind in ("i4", "i4", "i4", "f4", "f4")))


class Tape(NamedTuple):
    """Rallies as they were played, in the order in which they ended; no room where no one asks.

    Attributes:
        rally: ``[R]`` number.
        length: ``[R]`` strokes.
        ended: ``[3, R]`` who served, who won, and how it ended.
        state: ``[N]`` of every stroke of both players, rally after rally.
        pair: ``[N]`` legal pair.
        used: ``[2]`` places of ``[R]`` and of ``[N]`` that are used.
    """

    rally: I64
    length: I32
    ended: U8
    state: I32
    pair: I32
    used: I64


def tape_for(rallies: int = 0, strokes: int = 0) -> Tape:
    """Room for so many rallies and strokes; for none: nothing is noted."""
    return Tape(
        np.empty(rallies, np.int64),
        np.empty(rallies, np.int32),
        np.empty((3, rallies), np.uint8),
        np.empty(strokes, np.int32),
        np.empty(strokes, np.int32),
        np.zeros(2, np.int64),
    )


def longer(tape: Tape) -> Tape:
    """The same rallies with twice the room."""
    columns = [np.concatenate([column, np.empty_like(column)], axis=-1) for column in tape[:-1]]
    return Tape._make([*columns, tape.used])


@inlined
def _fits(tape: Any, length: Any) -> Any:
    """Whether there is room for another rally."""
    return tape.used[0] < tape.rally.size and tape.used[1] + length <= tape.state.size


@inlined
def _note(tape: Any, rallies: Any, i: Any, number: Any) -> None:
    """Note a rally."""
    at, first = tape.used[0], tape.used[1]
    length, server, outcome = rallies.length[i], rallies.server[i], rallies.outcome[i]
    tape.rally[at], tape.length[at] = number, length
    last = (server + length - 1) & 1
    tape.ended[0, at], tape.ended[1, at] = server, last ^ (1 - outcome)
    tape.ended[2, at] = WINNER if outcome else FAULT
    for t in range(length):
        tape.state[first + t], tape.pair[first + t] = rallies.state[i, t], rallies.pair[i, t]
    tape.used[0] += 1
    tape.used[1] += length


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
def _credit_both(learned: Any, sums: Any, strokes: Any, first: Any, rallies: Any, i: Any, reward: Any, decay: Any) -> None:
    """Add all strokes of a rally in which both players learn; each value is that of its striker."""
    a, after, following, won = 0.0, 0.0, -1, reward
    for t in range(rallies.length[i] - 1, -1, -1):
        s = rallies.state[i, t]
        a = won - after - learned.value[s] - decay * a
        _add(learned, sums, strokes, first + t if first >= 0 else -1, s, rallies.pair[i, t], following, won, a)
        after, following, won = learned.value[s], s, 0.0


@inlined
def _credit(
    learned: Any, sums: Any, strokes: Any, first: Any, rallies: Any, i: Any, reward: Any, decay: Any, shaping: Any
) -> None:
    """Add the learner's strokes of a rally, every other one: from the second on where the opponent serves."""
    a, after, following, won = 0.0, 0.0, -1, reward
    begin = rallies.server[i]
    for j in range((rallies.length[i] - 1 - begin) // 2, -1, -1):
        t = begin + 2 * j
        s = rallies.state[i, t]
        if shaping.size > 0:
            won += shaping[rallies.limit[i, t]]
        a = won + after - learned.value[s] + decay * a
        _add(learned, sums, strokes, first + j if first >= 0 else -1, s, rallies.pair[i, t], following, won, a)
        after, following, won = learned.value[s], s, 0.0


@compiled
def collect(
    tables: Tables,
    learned: Learned,
    opponents: I32,
    starts: Starts,
    seed_key: np.uint64,
    numbers: I64,
    oldest: int,
    decay: float,
    shaping: F32,
    room: Room,
    sums: Sums,
    strokes: Strokes,
    used: int,
    tape: Tape,
    aside: I64,
    asked: I32,
) -> tuple[int, int, int, int]:
    """Play rallies and add them up; returns how many were put aside, how many states are asked for, how many places of the
    list are used, and what room is too small: TOO_LONG, NO_ROOM or 0."""
    waiting, states, small = 0, 0, 0
    listed, noted = strokes.state.size > 0, tape.rally.size > 0
    rallies = room.rallies
    for first in range(0, numbers.size, BLOCK):
        block = numbers[first : first + BLOCK]
        play(tables, learned, opponents, starts, seed_key, block, oldest, room)
        for i in range(block.size):
            number, length, server = block[i], rallies.length[i], rallies.server[i]
            opponent = opponents[number % opponents.size]
            own = length if opponent < 0 else (length - server + 1) // 2
            if length < 0 or (listed and used + own > strokes.state.size) or (noted and not _fits(tape, length)):
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
            reward = 2.0 * rallies.outcome[i] - 1.0
            sums.total[1] += 1
            sums.total[5] += length
            at = used if listed else -1
            if opponent < 0:
                _credit_both(learned, sums, strokes, at, rallies, i, reward, decay)
            else:
                if (server + length - 1) & 1:
                    reward = -reward
                sums.total[2] += reward > 0
                _credit(learned, sums, strokes, at, rallies, i, reward, decay, shaping)
            used += own if listed else 0
            if noted:
                _note(tape, rallies, i, number)
    return waiting, states, used, small


@compiled
def write(tables: Tables, learned: Learned, states: I32, logits: F32, value: F32, now: int) -> int:
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
    states: I32,
    start: I64,
    row: I64,
    stroke: I64,
    log_probability: F32,
    advantage: F32,
    visits: F32,
    returns: F32,
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
def replay(
    tables: Tables,
    learned: Learned,
    opponents: I32,
    starts: Starts,
    seed_key: np.uint64,
    numbers: I64,
    room: Room,
    tape: Tape,
) -> int:
    """Play rallies again, to note them; returns for how many there was room."""
    for first in range(0, numbers.size, BLOCK):
        block = numbers[first : first + BLOCK]
        play(tables, learned, opponents, starts, seed_key, block, np.int32(-(1 << 30)), room)
        for i in range(block.size):
            length = room.rallies.length[i]
            if length < 0 or not _fits(tape, length):
                return first + i
            _note(tape, room.rallies, i, block[i])
    return numbers.size


@compiled
def read_tape(
    tables: Tables,
    learned: Learned,
    opponents: I32,
    tape: Tape,
    rows: I64,
    start: I64,
    stroke: UInts,
    figures: F32,
) -> None:
    """Name the strokes of some rallies of a tape, one rally after the other, with the learner's figures of them.

    Args:
        tables: of the game.
        learned: the learner.
        opponents: by number of the rally.
        tape: the rallies.
        rows: ``[R]`` which of them.
        start: ``[R]`` first stroke of each in the tape.
        stroke: ``[N]`` for the strokes.
        figures: ``[2, N]`` for log-probability and value, NaN where another player strikes; ``[0, N]`` for neither.
    """
    n = 0
    for i in range(rows.size):
        row = rows[i]
        both, server = opponents[tape.rally[row] % opponents.size] < 0, tape.ended[0, row]
        for t in range(tape.length[row]):
            s, pair = tape.state[start[i] + t], tape.pair[start[i] + t]
            of = block_of(tables, s)
            head = tables.head[np.uint64(s - tables.first[of, 0])]
            stroke[n] = tables.stroke[np.uint64(head[2] + pair - head[0] - tables.first[of, 1])]
            if figures.shape[0] > 0:
                own = both or (server + t) & 1 == 0
                figures[0, n] = learned.log_probability[pair] if own else np.nan
                figures[1, n] = learned.value[s] if own else np.nan
            n += 1
