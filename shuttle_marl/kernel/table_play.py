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

_CHOICE_ONE: Final = np.float32(draws.CHOICE_ONE)
START: Final = 1 << 40
"""Counter of the draw of the initial state of a rally; no rally has so many strokes."""


class Learned(NamedTuple):
    """The learner's table, filled for the states that occur.

    Attributes:
        players: the learner, followed by its opponents.
        log_probability: ``[P]`` of the legal pairs; with recovery ``[P + 9 S]``.
        value: ``[S]`` value to the striker; with recovery ``[2 S]``, from S on to the receiver.
        written: ``[S]`` or ``[2 S]`` int32 iteration in which the entry was written; 0: never, -1: requested.
    """

    players: Players
    log_probability: F32
    value: F32
    written: I32


class Schedule(NamedTuple):
    """Opponents, initial states and draws of the rallies, by their number.

    Attributes:
        opponents: ``[K]`` int32 opponent of rally r is entry r modulo K: an index into ``Learned.players``, or -1: the learner.
        starts: ``[M]`` initial states of some rallies of self-play, drawn with equal probabilities.
        fraction: fraction of the rallies that start in one of them, in units of 1/65536.
        seed_key: key of the seed.
        oldest: entries of the table that were written before this iteration are stale.
    """

    opponents: I32
    starts: I32
    fraction: int
    seed_key: np.uint64
    oldest: int


class Played(NamedTuple):
    """R rallies with consecutive numbers.

    Attributes:
        key: ``[R]`` key of the draws.
        server: ``[R]`` seat that serves.
        opponent: ``[R]`` index into ``Learned.players``, or -1: the learner itself.
        served: ``[R]`` whether the rally starts with a serve.
        state: ``[R]`` state of the next stroke.
        length: ``[R]`` number of strokes.
        last: ``[R]`` index of the last stroke on the tape, -1 before the first.
        outcome: ``[R]`` outcome of the last stroke; below OPEN where the rally is over.
    """

    key: U64
    server: I8
    opponent: I32
    served: Bools
    state: I32
    length: I32
    last: I64
    outcome: I8


def new_played(size: int) -> Played:
    """Allocate rallies."""
    kinds = (np.uint64, np.int8, np.int32, np.bool_, np.int32, np.int32, np.int64, np.int8)
    return Played._make(np.empty(size, kind) for kind in kinds)


class Tape(NamedTuple):
    """Strokes of both players in the order in which they were played.

    Attributes:
        state: ``[N]`` state.
        pair: ``[N]`` legal pair.
        place: ``[N]`` number of the receiver's feasible position.
        before: ``[N]`` index of the stroke before it in its rally, -1 for none.
        used: ``[1]`` number of strokes on the tape.
    """

    state: I32
    pair: I32
    place: I8
    before: I64
    used: I64


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


class Lanes(NamedTuple):
    """Rallies of a block that continue, as arrays ``[BLOCK]``, beside the ``player`` and ``other`` of their block.

    Attributes:
        rally: index of the rally.
        key: key of its draws.
        state: state of the striker.
        seat: seat of the striker.
        stroke: number of the stroke.
    """

    rally: I64
    key: U64
    state: I64
    seat: I64
    stroke: I64


@inlined
def _resume(played: Played, waiting: I64, first: int, size: int, lanes: Lanes, block: Block) -> None:
    """Put some rallies that wait into lanes."""
    for i in range(size):
        r = waiting[first + i]
        rival = max(played.opponent[r], 0)  # in self-play the learner
        lanes.rally[i], lanes.key[i], lanes.state[i], lanes.stroke[i] = r, played.key[r], played.state[r], played.length[r]
        lanes.seat[i] = (played.server[r] + played.length[r]) & 1
        block.player[i], block.other[i] = (rival, 0) if lanes.seat[i] else (0, rival)


@inlined
def _admit(tables: Tables, learned: Learned, played: Played, lanes: Lanes, block: Block, count: int, oldest: int) -> int:
    """Keep the rallies whose entries are there, and draw their strokes; returns their number."""
    states, admitted = core.states_of(tables), 0
    for i in range(count):
        s = lanes.state[i]
        missing = block.player[i] == 0 and learned.written[np.uint64(s)] < oldest
        if core.with_recovery(tables) and not missing and block.other[i] == 0:
            missing = learned.written[np.uint64(states + s)] < oldest
        if missing:
            played.state[lanes.rally[i]] = s
        _move(lanes, block, i, admitted, s, block.player[i], block.other[i])
        block.bits[admitted] = core.draw(lanes.key[admitted], lanes.stroke[admitted])
        admitted += not missing
    return admitted


@inlined
def _move(lanes: Lanes, block: Block, i: int, to: int, state: int, player: int, other: int) -> None:
    """Move a rally from lane i to an earlier lane."""
    lanes.rally[to], lanes.key[to], lanes.seat[to], lanes.stroke[to] = (
        lanes.rally[i],
        lanes.key[i],
        lanes.seat[i],
        lanes.stroke[i],
    )
    lanes.state[to], block.player[to], block.other[to] = state, player, other


@inlined
def _note(played: Played, lanes: Lanes, block: Block, states: I64, count: int, tape: Tape) -> int:
    """Write the strokes onto the tape; returns how many rallies continue, which are moved to the first lanes."""
    alive, used = 0, tape.used[0]
    for i in range(count):
        at, r = used + i, lanes.rally[i]
        tape.state[at], tape.pair[at], tape.place[at], tape.before[at] = states[i], block.pair[i], block.place[i], played.last[r]
        played.last[r], played.outcome[r] = at, block.outcome[i]
        lanes.stroke[i] += 1
        played.length[r] = lanes.stroke[i]
        lanes.seat[i] ^= 1
        _move(lanes, block, i, alive, lanes.state[i], block.other[i], block.player[i])
        alive += block.outcome[i] >= OPEN
    tape.used[0] = used + count
    return alive


@compiled
def advance(
    tables: Tables,
    learned: Learned,
    schedule: Schedule,
    played: Played,
    waiting: I64,
    tape: Tape,
    missing: I32,
    collected: "Collected | None",
) -> tuple[int, int]:
    """Play the rallies of ``waiting`` until they end, need an entry of the table, or the tape is full.

    Returns:
        How many rallies still wait, which are moved to the front of ``waiting``, and how many entries are ``missing``.
    """
    block, before = core.new_block(), np.empty(BLOCK, np.int64)
    lanes = Lanes(
        np.empty(BLOCK, np.int64), np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.int64), np.empty(BLOCK, np.int64),
        np.empty(BLOCK, np.int64),
    )  # fmt: skip
    still, wanted = 0, 0
    for first in range(0, waiting.size, BLOCK):
        size = min(BLOCK, waiting.size - first)
        _resume(played, waiting, first, size, lanes, block)
        count = _admit(tables, learned, played, lanes, block, size, schedule.oldest)
        while count and tape.used[0] + count <= tape.state.size:
            before[:count] = lanes.state[:count]
            choose(tables, learned.players, lanes.state, lanes.seat, block, count)
            core.strike(tables, lanes.state, block, count)
            count = _note(played, lanes, block, before, count, tape)
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
    states, s = core.states_of(tables), int64(played.state[r])
    learner_strikes = played.opponent[r] < 0 or (played.server[r] + played.length[r]) & 1 == 0
    learner_waits = core.with_recovery(tables) and (played.opponent[r] < 0 or not learner_strikes)
    if learner_strikes and 0 <= learned.written[s] < oldest:
        missing[wanted], learned.written[s] = s, -1
        wanted += 1
    if learner_waits and 0 <= learned.written[states + s] < oldest:
        missing[wanted], learned.written[states + s] = states + s, -1
        wanted += 1
    return wanted


class Sums(NamedTuple):
    """Sums of an iteration by state and stroke; with recovery by decision, and ``[P + 9 S, 3]``, ``[2 S, 2]``, ``[2 S]``.

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

    With recovery states are decisions. In self-play that which follows a position is the opponent's next position.
    """

    state: I32
    pair: I32
    following: I32
    reward: F32
    advantage: F32


def new_stroke_list(size: int = 0) -> StrokeList:
    """Allocate a list of strokes."""
    return StrokeList(*(np.empty(size, kind) for kind in ("i4", "i4", "i4", "f4", "f4")))


class Collected(NamedTuple):
    """Results of an iteration.

    Attributes:
        sums: sums by state and stroke.
        strokes: the strokes one by one, if they are wanted; at least as long as twice the tape.
        listed: ``[1]`` int64 number of entries of ``strokes`` in use.
        gae_lambda: lambda of the advantages.
        shaping: ``[P]`` addition to the reward of a stroke, or ``[0]``.
    """

    sums: Sums
    strokes: StrokeList
    listed: I64
    gae_lambda: float
    shaping: F32


class _Stroke(NamedTuple):
    """One row of :class:`StrokeList`."""

    state: int
    pair: int
    following: int
    reward: float
    advantage: float


@inlined
def _add(learned: Learned, collected: Collected, at: int, stroke: _Stroke) -> None:
    """Add a stroke to the sums, and to the list, if it is wanted, at index ``at``."""
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
    if strokes.state.size > 0:
        strokes.state[at], strokes.pair[at], strokes.following[at] = s, pair, stroke.following
        strokes.reward[at], strokes.advantage[at] = stroke.reward, a


@inlined
def _advantage(reward: float, value: float, next_value: float, next_advantage: float, gamma: float, gae_lambda: float) -> float:
    """Generalised advantage of Schulman et al. 2016, eq. 16: delta = r + gamma V(s') - V(s), A = delta + gamma lambda A'."""
    return reward + gamma * next_value - value + gamma * gae_lambda * next_advantage


@inlined
def _place_pair(tables: Tables, learned: Learned, s: int, place: int) -> int:
    """Number of the receiver's feasible position in a state, behind the legal pairs."""
    return int64(learned.log_probability.size - N_POSITIONS * (core.states_of(tables) - s) + place)


@inlined
def _credit(tables: Tables, learned: Learned, collected: Collected, played: Played, r: int, tape: Tape) -> None:
    """Count a rally that is over, and add the learner's decisions, backwards."""
    sums, length, alone = collected.sums, played.length[r], played.opponent[r] < 0
    own = length if alone or core.with_recovery(tables) else (length - played.server[r] + 1) // 2
    own += length if alone and core.with_recovery(tables) else 0
    reward = 2.0 * played.outcome[r] - 1.0
    sums.total[1] += 1
    sums.total[5] += length
    end = collected.listed[0] + own
    if alone:
        _credit_both(tables, learned, collected, end, tape, int64(played.last[r]), reward)
    else:
        seat = (played.server[r] + length - 1) & 1
        if seat:
            reward = -reward
        sums.total[2] += reward > 0
        _credit_learner(tables, learned, collected, end, tape, int64(played.last[r]), seat, reward)
    collected.listed[0] = end


@inlined
def _credit_both(tables: Tables, learned: Learned, collected: Collected, end: int, tape: Tape, last: int, reward: float) -> None:
    """Add all strokes of a rally of self-play; each value is that of its striker, so gamma is -1.

    What a stroke returns to the striker, the position against it returns to the receiver with the other sign.
    """
    states = core.states_of(tables)
    a, after, following, won, at = 0.0, 0.0, -1, reward, last
    while at >= 0:
        s = int64(tape.state[at])
        a = _advantage(won, learned.value[s], after, a, -1.0, collected.gae_lambda)
        end -= 1 + core.with_recovery(tables)
        _add(learned, collected, end, _Stroke(s, tape.pair[at], following, won, a))
        if core.with_recovery(tables):
            b, then = -(a + learned.value[s]) - learned.value[states + s], states + following if following >= 0 else -1
            position = _Stroke(states + s, _place_pair(tables, learned, s, tape.place[at]), then, -won, b)
            _add(learned, collected, end + 1, position)
        after, following, won, at = learned.value[s], s, 0.0, tape.before[at]


@inlined
def _credit_learner(
    tables: Tables, learned: Learned, collected: Collected, end: int, tape: Tape, last: int, seat: int, reward: float
) -> None:
    """Add the learner's decisions of a rally whose last striker has this seat: strokes, and where it receives positions."""
    a, after, following, won, at, states = 0.0, 0.0, -1, reward, last, core.states_of(tables)
    while at >= 0:
        s, pair = int64(tape.state[at]), int64(tape.pair[at])
        if seat == 0 or core.with_recovery(tables):
            if seat:
                s, pair = states + s, _place_pair(tables, learned, s, tape.place[at])
            elif collected.shaping.size > 0:
                won += collected.shaping[pair]
            a = _advantage(won, learned.value[s], after, a, 1.0, collected.gae_lambda)
            end -= 1
            _add(learned, collected, end, _Stroke(s, pair, following, won, a))
            after, following, won = learned.value[s], s, 0.0
        seat ^= 1
        at = tape.before[at]


@inlined
def _options(tables: Tables, decision: int, pairs: int) -> tuple[int, int, int]:
    """Of a decision: its state, the number of its first option behind P legal pairs, and how many options it has."""
    states = core.states_of(tables)
    if decision < states:
        legal = core.legal_strokes(tables, decision)
        return decision, int64(legal.pair), int64(legal.n)
    return decision - states, pairs + N_POSITIONS * (decision - states), core.choices_in(tables, decision - states)


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
    pairs = learned.players.cumulative.shape[1]
    for i in range(states.size):
        s, start, count = _options(tables, states[i], pairs)
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
        _, start, count = _options(tables, s, learned.players.cumulative.shape[1])
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
    tables: Tables,
    learned: Learned,
    played: Played,
    tape: Tape,
    rows: I64,
    stroke: UInts,
    hurried: U8,
    waited: I8,
    figures: F32,
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
