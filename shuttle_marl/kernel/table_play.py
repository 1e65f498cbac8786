"""Play and sum up whole rallies of a learner that acts from a table, compiled.

:mod:`shuttle_marl.kernel.sampling` explains their use and calls them; it checks every array from outside.
"""

from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F32, F64, I32, I64, U8, UInts
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.game import draws
from shuttle_marl.game.rules import FAULT, WINNER
from shuttle_marl.kernel.core import BLOCK, Tables, hurried_in, legal_strokes, stroke_of
from shuttle_marl.kernel.players import write_guide
from shuttle_marl.kernel.table_rallies import STALE, TOO_LONG, BlockRallies, Learned, Schedule, Workspace, play

FULL: Final = -3
_CHOICE_ONE: Final = np.float32(draws.CHOICE_ONE)


class Sums(NamedTuple):
    """Sums of an iteration by state and stroke.

    Attributes:
        pair: ``[P, 3]`` number of strokes, sum of their positive advantages, and of their negative ones.
        state: ``[S, 2]`` number of strokes, and sum of the returns.
        visited: ``[S]`` visited states in the order of their first visit.
        total: ``[7]`` strokes of the learner, rallies, rallies won, sum of the advantages, sum of their squares, strokes of both
            players, and number of visited states.
    """

    pair: F32
    state: F32
    visited: I32
    total: F64


class StrokeList(NamedTuple):
    """The learner's strokes in the order of the rallies; N = 0 if they are not wanted.

    Attributes:
        state: ``[N]`` state in which it was played.
        pair: ``[N]`` legal pair.
        following: ``[N]`` next state of the learner (in self-play: of the opponent), -1 if the rally ends before.
        reward: ``[N]`` reward, including shaping.
        advantage: ``[N]`` lambda-weighted advantage with the values of the table.
    """

    state: I32
    pair: I32
    following: I32
    reward: F32
    advantage: F32


def new_stroke_list(size: int = 0) -> StrokeList:
    """Allocate a list of strokes."""
    return StrokeList(*(np.empty(size, kind) for kind in ("i4", "i4", "i4", "f4", "f4")))


class Tape(NamedTuple):
    """Rallies in the order in which they ended; R = N = 0 if they are not wanted.

    Attributes:
        rally: ``[R]`` number of the rally.
        length: ``[R]`` number of strokes.
        ended: ``[3, R]`` server, winner, and outcome of the last stroke.
        state: ``[N]`` state of every stroke of both players, rally after rally.
        pair: ``[N]`` legal pair of every stroke.
        used: ``[2]`` number of rallies and of strokes on the tape.
    """

    rally: I64
    length: I32
    ended: U8
    state: I32
    pair: I32
    used: I64


def new_tape(rallies: int = 0, strokes: int = 0) -> Tape:
    """Allocate a tape of a capacity; with capacity 0 nothing is recorded."""
    return Tape(
        np.empty(rallies, np.int64),
        np.empty(rallies, np.int32),
        np.empty((3, rallies), np.uint8),
        np.empty(strokes, np.int32),
        np.empty(strokes, np.int32),
        np.zeros(2, np.int64),
    )


def doubled(tape: Tape) -> Tape:
    """The same rallies with twice the capacity."""
    columns = [np.concatenate([column, np.empty_like(column)], axis=-1) for column in tape[:-1]]
    return Tape._make([*columns, tape.used])


class Credit(NamedTuple):
    """Rewards and advantages of the learner.

    Attributes:
        gae_lambda: lambda of the advantages.
        shaping: ``[L * base pairs]`` addition to the reward of a stroke, or ``[0]``.
    """

    gae_lambda: float
    shaping: F32


class Collected(NamedTuple):
    """Results of an iteration.

    Attributes:
        sums: sums by state and stroke.
        strokes: the strokes one by one, if they are wanted.
        listed: ``[1]`` int64 number of entries of ``strokes`` in use.
        tape: the rallies, if they are wanted.
    """

    sums: Sums
    strokes: StrokeList
    listed: I64
    tape: Tape


class Pending(NamedTuple):
    """Rallies that could not be played to their end.

    Attributes:
        rally: ``[R]`` their numbers.
        state: ``[R]`` states whose entries are missing or stale.
    """

    rally: I64
    state: I32


class Shortage(NamedTuple):
    """Number of entries of :class:`Pending`, and the arrays that are too small: TOO_LONG (workspace), FULL (results) or 0."""

    rallies: int
    states: int
    small: int


class _Stroke(NamedTuple):
    """One row of :class:`StrokeList`."""

    state: int
    pair: int
    following: int
    reward: float
    advantage: float


@inlined
def _fits(tape: Tape, length: int) -> bool:
    """Whether a rally fits onto the tape."""
    fits: bool = tape.used[0] < tape.rally.size and tape.used[1] + length <= tape.state.size
    return fits


@inlined
def _write(tape: Tape, rallies: BlockRallies, i: int, number: int) -> None:
    """Write rally i of a block onto the tape."""
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
def _add(learned: Learned, collected: Collected, at: int, stroke: _Stroke) -> None:
    """Add a stroke to the sums, and to the list at index ``at`` unless that is negative."""
    sums, strokes, s, pair, a = collected.sums, collected.strokes, stroke.state, stroke.pair, stroke.advantage
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
        strokes.state[at], strokes.pair[at], strokes.following[at] = s, pair, stroke.following
        strokes.reward[at], strokes.advantage[at] = stroke.reward, a


@inlined
def _advantage(reward: float, value: float, next_value: float, next_advantage: float, gamma: float, gae_lambda: float) -> float:
    """Generalised advantage of Schulman et al. 2016, eq. 16: delta = r + gamma V(s') - V(s), A = delta + gamma lambda A'."""
    return reward + gamma * next_value - value + gamma * gae_lambda * next_advantage


@inlined
def _credit_both(
    learned: Learned, collected: Collected, first: int, rallies: BlockRallies, i: int, reward: float, credit: Credit
) -> None:
    """Add all strokes of a rally of self-play, backwards; each value is that of its striker, so gamma is -1."""
    a, after, following, won = 0.0, 0.0, -1, reward
    for t in range(rallies.length[i] - 1, -1, -1):
        s = rallies.state[i, t]
        a = _advantage(won, learned.value[s], after, a, -1.0, credit.gae_lambda)
        at = first + t if first >= 0 else -1
        _add(learned, collected, at, _Stroke(s, rallies.pair[i, t], following, won, a))
        after, following, won = learned.value[s], s, 0.0


@inlined
def _credit_learner(
    learned: Learned, collected: Collected, first: int, rallies: BlockRallies, i: int, reward: float, credit: Credit
) -> None:
    """Add the learner's strokes of a rally, every other one: from the second on if the opponent serves."""
    a, after, following, won = 0.0, 0.0, -1, reward
    begin = rallies.server[i]
    for j in range((rallies.length[i] - 1 - begin) // 2, -1, -1):
        t = begin + 2 * j
        s = rallies.state[i, t]
        if credit.shaping.size > 0:
            won += credit.shaping[rallies.limit[i, t]]
        a = _advantage(won, learned.value[s], after, a, 1.0, credit.gae_lambda)
        at = first + j if first >= 0 else -1
        _add(learned, collected, at, _Stroke(s, rallies.pair[i, t], following, won, a))
        after, following, won = learned.value[s], s, 0.0


@compiled
def collect(
    tables: Tables,
    learned: Learned,
    schedule: Schedule,
    numbers: I64,
    credit: Credit,
    workspace: Workspace,
    collected: Collected,
    pending: Pending,
) -> Shortage:
    """Play the rallies with these numbers and add them to ``collected``; those that cannot be added go to ``pending``."""
    waiting, states, small = 0, 0, 0
    sums, strokes, tape = collected.sums, collected.strokes, collected.tape
    listed, taped, used = strokes.state.size > 0, tape.rally.size > 0, collected.listed[0]
    rallies = workspace.rallies
    for first in range(0, numbers.size, BLOCK):
        block = numbers[first : first + BLOCK]
        play(tables, learned, schedule, block, workspace)
        for i in range(block.size):
            number, length, server = block[i], rallies.length[i], rallies.server[i]
            opponent = schedule.opponents[number % schedule.opponents.size]
            own = length if opponent < 0 else (length - server + 1) // 2
            if length < 0 or (listed and used + own > strokes.state.size) or (taped and not _fits(tape, length)):
                pending.rally[waiting] = number
                waiting += 1
                if length == STALE:
                    if learned.written[server] >= 0:
                        pending.state[states] = server
                        states += 1
                        learned.written[server] = -1
                else:
                    small = TOO_LONG if length == TOO_LONG else FULL
                continue
            reward = 2.0 * rallies.outcome[i] - 1.0
            sums.total[1] += 1
            sums.total[5] += length
            at = used if listed else -1
            if opponent < 0:
                _credit_both(learned, collected, at, rallies, i, reward, credit)
            else:
                if (server + length - 1) & 1:
                    reward = -reward
                sums.total[2] += reward > 0
                _credit_learner(learned, collected, at, rallies, i, reward, credit)
            used += own if listed else 0
            if taped:
                _write(tape, rallies, i, number)
    collected.listed[0] = used
    return Shortage(waiting, states, small)


@compiled
def write(tables: Tables, learned: Learned, states: I32, logits: F32, value: F32, now: int) -> int:
    """Write the entries of some states; returns the index of the first whose numbers are not finite, or -1."""
    cumulative = learned.players.cumulative[0]
    for i in range(states.size):
        s = states[i]
        legal = legal_strokes(tables, s)
        start, count = legal.pair, legal.n
        highest = np.float32(-np.inf)
        for k in range(count):
            highest = max(highest, logits[i, stroke_of(tables, legal, k)])
        total = np.float32(0)
        for k in range(count):
            weight = np.exp(logits[i, stroke_of(tables, legal, k)] - highest)
            learned.log_probability[start + k] = weight
            total += weight
        if not (np.isfinite(total) and np.isfinite(highest) and np.isfinite(value[i])):
            return i
        part, scale, sum_log = np.float32(0), _CHOICE_ONE / total, np.log(total) + highest
        for k in range(count):
            part += learned.log_probability[start + k]
            cumulative[start + k] = np.uint16(min(part * scale, _CHOICE_ONE) + np.float32(0.5))
            learned.log_probability[start + k] = logits[i, stroke_of(tables, legal, k)] - sum_log
        cumulative[start + count - 1] = draws.CHOICE_ONE
        write_guide(cumulative, start, learned.players.guide[0, s])
        learned.value[s], learned.written[s] = value[i], now
    return -1


class DistinctArrays(NamedTuple):
    """Arrays of :class:`shuttle_marl.kernel.sampling.Distinct`, with capacity for all rows."""

    start: I64
    row: I64
    stroke: I64
    log_probability: F32
    advantage: F32
    visits: F32
    returns: F32


@compiled
def take(tables: Tables, learned: Learned, sums: Sums, states: I32, out: DistinctArrays) -> int:
    """Move the sums of some states to ``out``; returns the number of rows, two for a pair with advantages of both signs."""
    rows = 0
    for i in range(states.size):
        s = states[i]
        out.start[i] = rows
        out.visits[i], out.returns[i] = sums.state[s, 0], sums.state[s, 1] / sums.state[s, 0]
        sums.state[s, :] = 0
        legal = legal_strokes(tables, s)
        for k in range(legal.n):
            pair = legal.pair + k
            if sums.pair[pair, 0] == 0:
                continue
            for sign in range(1, 3):
                if sums.pair[pair, sign] != 0:
                    out.row[rows], out.stroke[rows] = i, stroke_of(tables, legal, k)
                    out.log_probability[rows], out.advantage[rows] = learned.log_probability[pair], sums.pair[pair, sign]
                    rows += 1
            sums.pair[pair, :] = 0
    out.start[states.size] = rows
    return rows


@compiled
def replay(tables: Tables, learned: Learned, schedule: Schedule, numbers: I64, workspace: Workspace, tape: Tape) -> int:
    """Play rallies onto a tape; returns the number of rallies that fit."""
    for first in range(0, numbers.size, BLOCK):
        block = numbers[first : first + BLOCK]
        play(tables, learned, schedule, block, workspace)
        for i in range(block.size):
            length = workspace.rallies.length[i]
            if length < 0 or not _fits(tape, length):
                return first + i
            _write(tape, workspace.rallies, i, block[i])
    return numbers.size


@compiled
def read_tape(
    tables: Tables, learned: Learned, opponents: I32, tape: Tape, places: I64, stroke: UInts, hurried: U8, figures: F32
) -> None:
    """Write the strokes of some rallies of a tape, rally after rally, and the learner's figures of them.

    Args:
        opponents: see :class:`Schedule`.
        places: ``[2, R]`` rows of the tape, and index of their first stroke on it.
        stroke: ``[N]`` output: catalogue indices.
        hurried: ``[N]`` output: whether the striker was hurried.
        figures: ``[2, N]`` output: log-probability and value of the learner's strokes, NaN for others; ``[0, N]``: not wanted.
    """
    n = 0
    for i in range(places.shape[1]):
        row, start = places[0, i], places[1, i]
        both, server = opponents[tape.rally[row] % opponents.size] < 0, tape.ended[0, row]
        for t in range(tape.length[row]):
            s, pair = tape.state[start + t], tape.pair[start + t]
            legal = legal_strokes(tables, s)
            stroke[n], hurried[n] = stroke_of(tables, legal, pair - legal.pair), hurried_in(s)
            if figures.shape[0] > 0:
                own = both or (server + t) & 1 == 0
                figures[0, n] = learned.log_probability[pair] if own else np.nan
                figures[1, n] = learned.value[s] if own else np.nan
            n += 1
