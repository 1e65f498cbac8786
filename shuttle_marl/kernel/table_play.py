"""Play and sum up whole rallies of a learner that acts from a table, a block of them at a time, compiled.

:mod:`shuttle_marl.kernel.sampling` explains their use and calls them; it checks every array from outside. All rallies of a block
advance by one stroke together. A rally waits where an entry of the table is missing or stale, and continues from there when it is
written. Strokes of all rallies stand on one tape, each with the number of the one before it in its rally, so a rally is read
backwards, as its advantages are computed.

The learner has **decisions** of two kinds: decision s < S is the stroke in state s, and where receivers have a choice decision
S + s is the position where the opponent strikes in state s. Its i-th feasible position is numbered P + 9 s + i, behind the P
legal pairs.
"""

from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F32, F64, I8, I32, I64, U8, U64, Bools, UInts
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.game import draws
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.kernel import core
from shuttle_marl.kernel.core import BLOCK, OPEN, Block, Tables, int64
from shuttle_marl.kernel.players import Players, choose, write_guide
from shuttle_marl.kernel.rows import Rows, move

_CHOICE_ONE: Final = np.float32(draws.CHOICE_ONE)
START: Final = 1 << 40  # counter of the draw of the initial state of a rally; no rally has so many strokes


class Learned(NamedTuple):
    """The learner's table, filled for the states that occur."""

    players: Players  # the learner, followed by its opponents
    log_probability: F32  # [P] of the legal pairs; with recovery `[P + 9 S]`
    value: F32  # [S] value to the striker; with recovery `[2 S]`, from S on to the receiver
    written: I32  # [S] or `[2 S]` int32 iteration in which the entry was written; 0: never, -1: requested


class Schedule(NamedTuple):
    """Opponents, initial states and draws of the rallies, by their number."""

    opponents: I32  # [K] opponent of rally r is entry r modulo K: an index into `Learned.players`, or -1: the learner
    starts: I32  # [M] initial states of some rallies of self-play, drawn with equal probabilities
    fraction: int  # fraction of the rallies that start in one of them, in units of 1/65536
    seed_key: np.uint64  # key of the seed
    oldest: int  # entries of the table that were written before this iteration are stale


class Played(NamedTuple):
    """R rallies with consecutive numbers."""

    key: U64  # [R] key of the draws
    server: I8  # [R] seat that serves
    opponent: I32  # [R] index into `Learned.players`, or -1: the learner itself
    served: Bools  # [R] whether the rally starts with a serve
    state: I32  # [R] state of the next stroke
    length: I32  # [R] number of strokes
    last: I64  # [R] index of the last stroke on the tape, -1 before the first
    outcome: I8  # [R] outcome of the last stroke; below OPEN where the rally is over


def new_played(size: int) -> Played:
    """Allocate rallies."""
    kinds = (np.uint64, np.int8, np.int32, np.bool_, np.int32, np.int32, np.int64, np.int8)
    return Played._make(np.empty(size, kind) for kind in kinds)


class Tape(NamedTuple):
    """Strokes of both players in the order in which they were played."""

    state: I32  # [N] state
    pair: I32  # [N] legal pair
    place: I8  # [N] number of the receiver's feasible position
    before: I64  # [N] index of the stroke before it in its rally, -1 for none
    used: I64  # [1] number of strokes on the tape


def new_tape(strokes: int) -> Tape:
    """Allocate a tape."""
    kinds = (np.int32, np.int32, np.int8, np.int64)
    return Tape._make([*(np.empty(strokes, kind) for kind in kinds), np.zeros(1, np.int64)])


@compiled
def begin(schedule: Schedule, first: int, played: Played) -> None:
    """Start the rallies with numbers from ``first`` on."""
    for r in range(played.key.size):
        key = core.extend(schedule.seed_key, first + r)
        opponent = schedule.opponents[(first + r) % schedule.opponents.size]
        played.key[r], played.opponent[r], played.server[r] = key, opponent, core.first_server(core.draw(key, 0))
        played.state[r], played.served[r] = 0, True
        if opponent < 0 and schedule.starts.size > 0:
            bits = core.draw(key, START)
            if int64(bits & core.LOW_16) < schedule.fraction:
                played.state[r], played.served[r] = schedule.starts[core.uniform_choice(schedule.starts.size, bits)], False
        played.length[r], played.last[r], played.outcome[r] = 0, -1, OPEN


@inlined
def _resume(played: Played, waiting: I64, first: int, size: int, lanes: Rows, block: Block) -> None:
    """Put some rallies that wait into lanes."""
    for i in range(size):
        r = waiting[first + i]
        lanes.rally[i], lanes.key[i], lanes.state[i], lanes.stroke[i] = r, played.key[r], played.state[r], played.length[r]
        lanes.striker[i], block.outcome[i] = (played.server[r] + played.length[r]) & 1, OPEN


@inlined
def _decides(tables: Tables, opponent: int, striker: int) -> tuple[bool, bool]:
    """Whether the learner, at seat 0, chooses the stroke, and the position against it."""
    alone = opponent < 0
    return alone or striker == 0, core.with_recovery(tables) and (alone or striker != 0)


@inlined
def _admit(tables: Tables, learned: Learned, played: Played, lanes: Rows, block: Block, count: int, oldest: int) -> int:
    """Keep the rallies that continue and whose entries are there, and draw their strokes; returns their number."""
    states, admitted = core.states_of(tables), 0
    for i in range(count):
        s, r, over = lanes.state[i], lanes.rally[i], block.outcome[i] < OPEN
        rival = max(played.opponent[r], 0)  # in self-play the learner
        player, other = (rival, 0) if lanes.striker[i] else (0, rival)
        strikes, waits = _decides(tables, played.opponent[r], lanes.striker[i])
        missing = strikes and learned.written[np.uint64(s)] < oldest
        missing |= waits and learned.written[np.uint64(states + s)] < oldest
        if missing:
            played.state[r] = s
        move(lanes, i, admitted)
        block.player[admitted], block.other[admitted] = player, other
        block.bits[admitted] = core.draw(lanes.key[admitted], lanes.stroke[admitted])
        admitted += not (missing or over)
    return admitted


@inlined
def _note(played: Played, lanes: Rows, block: Block, states: I32, count: int, tape: Tape) -> None:
    """Write the strokes onto the tape."""
    used = tape.used[0]
    for i in range(count):
        at, r = used + i, lanes.rally[i]
        tape.state[at], tape.pair[at], tape.place[at], tape.before[at] = states[i], block.pair[i], block.place[i], played.last[r]
        played.last[r], played.outcome[r] = at, block.outcome[i]
        lanes.stroke[i] += 1
        lanes.striker[i] ^= 1
        played.length[r] = lanes.stroke[i]
    tape.used[0] = used + count


@compiled
def advance(
    tables: Tables,
    learned: Learned,
    schedule: Schedule,
    played: Played,
    waiting: I64,
    lanes: Rows,
    tape: Tape,
    missing: I32,
    collected: "Collected | None",
) -> tuple[int, int]:
    """Play the rallies of ``waiting`` until they end, need an entry of the table, or the tape is full.

    Args:
        lanes: ``[BLOCK]`` room for the rallies that are being played.

    Returns:
        How many rallies still wait, which are moved to the front of ``waiting``, and how many entries are ``missing``.
    """
    block, before, still, wanted = core.new_block(), np.empty(BLOCK, np.int32), 0, 0
    for first in range(0, waiting.size, BLOCK):
        size = min(BLOCK, waiting.size - first)
        _resume(played, waiting, first, size, lanes, block)
        count = _admit(tables, learned, played, lanes, block, size, schedule.oldest)
        while count and tape.used[0] + count <= tape.state.size:
            before[:count] = lanes.state[:count]
            choose(tables, learned.players, lanes.state, lanes.striker, block, count)
            core.strike(tables, lanes.state, block, count)
            _note(played, lanes, block, before, count, tape)
            count = _admit(tables, learned, played, lanes, block, count, schedule.oldest)
        for i in range(count):  # the tape is full
            played.state[lanes.rally[i]] = lanes.state[i]
        for i in range(first, first + size):
            r = waiting[i]
            if played.outcome[r] >= OPEN:
                waiting[still] = r
                still += 1
                wanted = _request(tables, learned, played, r, schedule.oldest, missing, wanted)
            elif collected is not None:
                _credit(tables, learned, collected, played, r, tape)
    return still, wanted


@inlined
def _request(tables: Tables, learned: Learned, played: Played, r: int, oldest: int, missing: I32, wanted: int) -> int:
    """List the entries that the learner needs for the next stroke of a rally; returns the new number of missing entries."""
    s = int64(played.state[r])
    strikes, waits = _decides(tables, played.opponent[r], (played.server[r] + played.length[r]) & 1)
    for decision, needed in ((s, strikes), (core.states_of(tables) + s, waits)):
        if needed and 0 <= learned.written[decision] < oldest:
            missing[wanted], learned.written[decision] = decision, -1
            wanted += 1
    return wanted


class Sums(NamedTuple):
    """Sums of an iteration by state and stroke; with recovery by decision, and ``[P + 9 S, 3]``, ``[2 S, 2]``, ``[2 S]``.

    Attributes:
        total: ``[7]`` strokes of the learner, rallies, rallies won, sum of the advantages, sum of their squares, strokes of both
            players, and number of visited states.
    """

    pair: F32  # [P, 3] number of strokes, sum of their positive advantages, and of their negative ones
    state: F32  # [S, 2] number of strokes, and sum of the returns
    visited: I32  # [S] visited states in the order of their first visit
    total: F64


class StrokeList(NamedTuple):
    """The learner's strokes in the order of the rallies; N = 0 if they are not wanted.

    With recovery states are decisions. In self-play that which follows a position is the opponent's next position.
    """

    state: I32  # [N] state in which it was played
    pair: I32  # [N] legal pair
    following: I32  # [N] next state of the learner (in self-play: of the opponent), -1 if the rally ends before
    reward: F32  # [N] reward, including shaping
    advantage: F32  # [N] lambda-weighted advantage with the values of the table


def new_stroke_list(size: int = 0) -> StrokeList:
    """Allocate a list of strokes."""
    return StrokeList(*(np.empty(size, kind) for kind in ("i4", "i4", "i4", "f4", "f4")))


class Collected(NamedTuple):
    """Results of an iteration."""

    sums: Sums  # sums by state and stroke
    strokes: StrokeList  # the strokes one by one, if they are wanted; at least as long as twice the tape
    listed: I64  # [1] number of entries of `strokes` in use
    gae_lambda: float  # lambda of the advantages
    shaping: F32  # [P] addition to the reward of a stroke, or `[0]`


@inlined
def _add(
    learned: Learned, collected: Collected, at: int, s: int, pair: int, following: int, reward: float, advantage: float
) -> None:
    """Add a stroke to the sums, and to the list, if it is wanted, at index ``at``."""
    sums, strokes, a = collected.sums, collected.strokes, advantage
    if sums.state[s, 0] == 0:
        sums.visited[np.int64(sums.total[6])] = s
        sums.total[6] += 1
    sums.state[s, 0] += 1
    sums.state[s, 1] += a + learned.value[s]
    sums.pair[pair, 0] += 1
    sums.pair[pair, 1 if a > 0 else 2] += a
    sums.total[0] += 1
    sums.total[3] += a
    sums.total[4] += a * a
    if strokes.state.size > 0:
        strokes.state[at], strokes.pair[at], strokes.following[at] = s, pair, following
        strokes.reward[at], strokes.advantage[at] = reward, a


@inlined
def _options(tables: Tables, learned: Learned, decision: int) -> tuple[int, int, int]:
    """Of a decision: its state, the number of its first option, and how many options it has."""
    states = core.states_of(tables)
    if decision < states:
        legal = core.legal_strokes(tables, decision)
        return decision, int64(legal.pair), int64(legal.n)
    s = decision - states
    return s, learned.players.cumulative.shape[1] + N_POSITIONS * s, core.choices_in(tables, s)


@inlined
def _credit(tables: Tables, learned: Learned, collected: Collected, played: Played, r: int, tape: Tape) -> None:
    """Count a rally that is over, and add the learner's decisions backwards, with the advantages of Schulman et al. 2016."""
    sums, length, alone, states = collected.sums, played.length[r], played.opponent[r] < 0, core.states_of(tables)
    seat, won = (played.server[r] + length - 1) & 1, 2.0 * played.outcome[r] - 1.0
    if seat and not alone:
        won = -won
    sums.total[1] += 1
    sums.total[2] += won > 0 and not alone
    sums.total[5] += length
    struck = length if alone else (length - played.server[r] + 1) // 2
    end = collected.listed[0] + struck + _decides(tables, played.opponent[r], 1)[1] * (length if alone else length - struck)
    collected.listed[0] = end
    gamma, a, after, following, at = -1.0 if alone else 1.0, 0.0, 0.0, -1, int64(played.last[r])
    while at >= 0:
        s, pair = int64(tape.state[at]), int64(tape.pair[at])
        strikes, waits = _decides(tables, played.opponent[r], seat)
        if strikes or waits:
            if not strikes:
                s, pair = states + s, _options(tables, learned, states + s)[1] + tape.place[at]
            elif collected.shaping.size > 0 and not alone:
                won += collected.shaping[pair]
            a = won + gamma * after - learned.value[s] + gamma * collected.gae_lambda * a
            end -= 1 + (strikes and waits)
            _add(learned, collected, end, s, pair, following, won, a)
            if strikes and waits:
                b, then = -(a + learned.value[s]) - learned.value[states + s], states + following if following >= 0 else -1
                pair = _options(tables, learned, states + s)[1] + tape.place[at]
                _add(learned, collected, end + 1, states + s, pair, then, -won, b)
            after, following, won = learned.value[s], s, 0.0
        seat ^= 1
        at = tape.before[at]


@inlined
def _action(tables: Tables, decision: int, k: int) -> int:
    """The k-th option of a decision as an action: catalogue index of a stroke, or n plus a position."""
    states = core.states_of(tables)
    if decision < states:
        return core.stroke_of(tables, core.legal_strokes(tables, decision), k)
    return tables.rank.shape[1] + core.position_at(tables, decision - states, k)


@compiled
def write(tables: Tables, learned: Learned, states: I32, logits: F32, value: F32, now: int) -> int:
    """Write the entries of some decisions; returns the index of the first whose numbers are not finite, or -1."""
    for i in range(states.size):
        s, start, count = _options(tables, learned, int64(states[i]))
        position = states[i] != s
        highest = np.float32(-np.inf)
        for k in range(count):
            highest = max(highest, logits[i, _action(tables, states[i], k)])
        total = np.float32(0)
        for k in range(count):
            weight = np.exp(logits[i, _action(tables, states[i], k)] - highest)
            learned.log_probability[start + k] = weight
            total += weight
        if not (np.isfinite(total) and np.isfinite(highest) and np.isfinite(value[i])):
            return i
        part, scale, sum_log = np.float32(0), _CHOICE_ONE / total, np.log(total) + highest
        cumulative = learned.players.waits[0, s] if position else learned.players.cumulative[0, start : start + count]
        for k in range(count):
            part += learned.log_probability[start + k]
            if k < cumulative.size:
                cumulative[k] = np.uint16(min(part * scale, _CHOICE_ONE) + np.float32(0.5))
            learned.log_probability[start + k] = logits[i, _action(tables, states[i], k)] - sum_log
        if count <= cumulative.size:  # the ninth position is not stored
            cumulative[count - 1] = draws.CHOICE_ONE
        if not position:
            write_guide(learned.players.cumulative[0], start, learned.players.guide[0, s])
        learned.value[states[i]], learned.written[states[i]] = value[i], now
    return -1


class Distinct(NamedTuple):
    """N strokes of a learner as U distinct states and R rows of distinct strokes.

    A stroke has one row for its positive advantages and one for its negative advantages. With recovery states are decisions, see
    :data:`~shuttle_marl.kernel.sampling.Assess`, and position p is stroke n + p.
    """

    state: I32  # [U] int32 states
    visits: F32  # [U] float32 number of strokes in each state
    returns: F32  # [U] float32 mean lambda-return in each state
    start: I64  # [U + 1] int64 first row of each state
    row: I64  # [R] int64 index of the state of each row
    stroke: I64  # [R] int64 catalogue index
    log_probability: F32  # [R] float32 log-probability of the stroke when it was played
    advantage: F32  # [R] float32 sum of the advantages
    strokes: int  # N
    deviation: float  # standard deviation of the N advantages
    rallies: int  # number of rallies
    won: int  # number of rallies that the learner won against opponents
    played: int  # number of strokes of both players


@compiled
def take(tables: Tables, learned: Learned, sums: Sums, out: Distinct) -> int:
    """Move the sums of the states of ``out`` to it; returns the number of rows, two for a pair with advantages of both signs."""
    rows, states = 0, out.state
    for i in range(states.size):
        s = states[i]
        _, start, count = _options(tables, learned, int64(s))
        out.start[i] = rows
        out.visits[i], out.returns[i] = sums.state[s, 0], sums.state[s, 1] / sums.state[s, 0]
        sums.state[s, :] = 0
        for k in range(count):
            pair = start + k
            if sums.pair[pair, 0] == 0:
                continue
            for sign in range(1, 3):
                if sums.pair[pair, sign] != 0:
                    out.row[rows], out.stroke[rows] = i, _action(tables, s, k)
                    out.log_probability[rows], out.advantage[rows] = learned.log_probability[pair], sums.pair[pair, sign]
                    rows += 1
            sums.pair[pair, :] = 0
    out.start[states.size] = rows
    return rows


@compiled
def read_strokes(
    tables: Tables, learned: Learned, played: Played, tape: Tape, rows: I64, stroke: UInts, hurried: U8, waited: I8, figures: F32
) -> None:
    """Write the strokes of some rallies, rally after rally, and the learner's figures of them.

    Args:
        rows: ``[R]`` rallies.
        stroke: ``[N]`` output: catalogue indices.
        hurried: ``[N]`` output: whether the striker was hurried.
        waited: ``[N]`` output: position of the receiver.
        figures: ``[2, N]`` output: log-probability and value of the learner's strokes, NaN for others; ``[0, N]``: not wanted.
    """
    end = 0
    for r in rows:
        end += played.length[r]
        at, n, seat = played.last[r], end, (played.server[r] + played.length[r] - 1) & 1
        while at >= 0:
            n -= 1
            s, pair = tape.state[at], tape.pair[at]
            legal = core.legal_strokes(tables, s)
            stroke[n], hurried[n] = core.stroke_of(tables, legal, pair - legal.pair), core.hurried_in(s)
            waited[n] = core.position_at(tables, s, tape.place[at])
            if figures.shape[0] > 0:
                own = played.opponent[r] < 0 or seat == 0
                figures[0, n] = learned.log_probability[pair] if own else np.nan
                figures[1, n] = learned.value[s] if own else np.nan
            seat ^= 1
            at = tape.before[at]
