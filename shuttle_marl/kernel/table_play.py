"""Play and sum up whole rallies of a learner that acts from a table, a block of them at a time, compiled.

:mod:`shuttle_marl.kernel.sampling` explains their use and calls them; it checks every array from outside. Each stroke depends on
several table reads. Therefore all rallies of a block advance by one stroke together, in passes that do one thing each, so that
the reads of many rallies overlap.

In the game with recovery the learner has **decisions** of two kinds: decision s < S is the stroke in state s, decision S + s the
position where the opponent strikes in state s. Its i-th feasible position is numbered P + 9 s + i, behind the P legal pairs.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F32, F64, I8, I32, I64, U8, U64, UInts
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.game import draws
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.rules import FAULT, WINNER
from shuttle_marl.kernel.core import (
    BLOCK,
    LOW_16,
    OPEN,
    Legal,
    Tables,
    arrival_of,
    choices_in,
    draw,
    extend,
    first_server,
    hurried_in,
    int64,
    legal_strokes,
    limits_of,
    next_state,
    outcome_of,
    position_at,
    states_of,
    stroke_of,
    uniform_choice,
    with_recovery,
)
from shuttle_marl.kernel.players import Players, find_rank, first_guess, place_choice, write_guide

STALE, TOO_LONG, FULL = -1, -2, -3
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


class Starts(NamedTuple):
    """Initial states of some rallies of self-play.

    Attributes:
        states: ``[M]`` states, drawn with equal probabilities.
        fraction: ``[1]`` fraction of the rallies that start in one of them, in units of 1/65536.
    """

    states: I32
    fraction: I64


def no_starts() -> Starts:
    """All rallies start with a serve."""
    return Starts(np.zeros(0, np.int32), np.zeros(1, np.int64))


class Schedule(NamedTuple):
    """Opponents, initial states and draws of the rallies, by their number.

    Attributes:
        opponents: ``[K]`` int32 opponent of rally r is entry r modulo K: an index into ``Learned.players``, or -1: the learner.
        starts: initial states.
        seed_key: key of the seed.
        oldest: entries of the table that were written before this iteration are stale.
    """

    opponents: I32
    starts: Starts
    seed_key: np.uint64
    oldest: int


class BlockRallies(NamedTuple):
    """Up to BLOCK rallies.

    Attributes:
        state: ``[BLOCK, T]`` states of the strokes.
        pair: ``[BLOCK, T]`` legal pairs of the strokes.
        place: ``[BLOCK, T]`` number of the receiver's feasible position; written in the game with recovery alone.
        length: ``[BLOCK]`` number of strokes; STALE if an entry of the table is missing or stale, TOO_LONG if it exceeds T.
        server: ``[BLOCK]`` seat that serves; if ``length`` is STALE, the decision of the entry.
        outcome: ``[BLOCK]`` outcome of the last stroke.
    """

    state: I32
    pair: I32
    place: I32
    length: I64
    server: I64
    outcome: I64


class Lanes(NamedTuple):
    """Rallies that continue, as arrays ``[BLOCK]`` that the passes share.

    Attributes:
        rally: index of the rally in the block.
        key: key of its draws.
        player: player of the next stroke; 0 is the learner.
        other: player of the stroke after it.
        state: state of the striker.
        bits: draw of the stroke.
        block: effort block of the state.
        first: first legal pair of the state.
        reply: index of its first reply.
        limit: index of its first thresholds.
        choices: number of thresholds of a stroke.
        rank: position of the stroke among the legal strokes.
        place: number of the receiver's feasible position; 0 without recovery.
        limits: its thresholds.
        arrival: state of the next striker, contact below and not hurried.
    """

    rally: I64
    key: U64
    player: I64
    other: I64
    state: I64
    bits: U64
    block: I64
    first: I64
    reply: I64
    limit: I64
    choices: I64
    rank: I64
    place: I64
    limits: U64
    arrival: I64


class Workspace(NamedTuple):
    """Arrays to play a block of rallies."""

    rallies: BlockRallies
    lanes: Lanes


def new_workspace(strokes: int) -> Workspace:
    """Allocate arrays for rallies of up to ``strokes`` strokes."""
    kinds = {"key": np.uint64, "bits": np.uint64, "limits": np.uint64}
    lanes: dict[str, Any] = {name: np.zeros(BLOCK, kinds.get(name, np.int64)) for name in Lanes._fields}
    lists: list[I32] = [np.empty((BLOCK, strokes), np.int32) for _ in range(3)]
    ends: list[I64] = [np.empty(BLOCK, np.int64) for _ in range(3)]
    return Workspace(BlockRallies(lists[0], lists[1], lists[2], ends[0], ends[1], ends[2]), Lanes(**lanes))


@inlined
def play(tables: Tables, learned: Learned, schedule: Schedule, numbers: I64, workspace: Workspace) -> None:
    """Play the rallies with these numbers, up to BLOCK, to their end or to a missing or stale entry."""
    rallies, lanes = workspace.rallies, workspace.lanes
    for i in range(numbers.size):
        key = extend(schedule.seed_key, numbers[i])
        opponent = int64(schedule.opponents[numbers[i] % schedule.opponents.size])
        server = first_server(draw(key, 0))
        rallies.server[i] = server
        lanes.rally[i], lanes.key[i], lanes.state[i] = i, key, _initial_state(schedule.starts, opponent, key)
        rival = max(opponent, 0)  # in self-play the learner
        lanes.player[i], lanes.other[i] = (rival, 0) if server else (0, rival)
    count, t = numbers.size, 0
    while count:
        count = _admit(tables, learned, rallies, lanes, count, t, schedule.oldest)
        _choose(tables, learned.players, lanes, count)
        _look_up(tables, rallies, lanes, count, t)
        t += 1
        count = _strike(rallies, lanes, count, t)


@inlined
def _initial_state(starts: Starts, opponent: int, key: np.uint64) -> int:
    """The serve, or a random state of ``starts``."""
    if starts.states.size == 0 or opponent >= 0:
        return int64(0)
    bits = draw(key, START)
    if int64(bits & LOW_16) >= starts.fraction[0]:
        return int64(0)
    return int64(starts.states[uniform_choice(starts.states.size, bits)])


@inlined
def _admit(tables: Tables, learned: Learned, rallies: BlockRallies, lanes: Lanes, count: int, t: int, oldest: int) -> int:
    """Draw stroke ``t`` of each rally whose entries are there and that fits; returns their number."""
    full, recovery, states = t == rallies.state.shape[1], with_recovery(tables), states_of(tables)
    admitted = 0
    for i in range(count):
        rally, s = lanes.rally[i], lanes.state[i]
        decision = s
        missing = lanes.player[i] == 0 and learned.written[np.uint64(s)] < oldest
        if recovery and not missing and lanes.other[i] == 0:
            decision = states + s
            missing = learned.written[np.uint64(decision)] < oldest
        if missing or full:
            rallies.length[rally], rallies.server[rally] = STALE if missing else TOO_LONG, decision
        _move(lanes, i, admitted)
        lanes.state[admitted], lanes.bits[admitted] = s, draw(lanes.key[i], t)
        admitted += not (missing or full)
    return admitted


@inlined
def _move(lanes: Lanes, i: int, to: int) -> None:
    """Move a rally from lane i to an earlier lane."""
    lanes.rally[to], lanes.key[to] = lanes.rally[i], lanes.key[i]
    lanes.player[to], lanes.other[to] = lanes.player[i], lanes.other[i]


@inlined
def _choose(tables: Tables, players: Players, lanes: Lanes, count: int) -> None:
    """Choose a stroke and a position in each lane."""
    for i in range(count):
        s = lanes.state[i]
        legal = legal_strokes(tables, s)
        lanes.block[i], lanes.first[i], lanes.reply[i], lanes.limit[i] = legal.block, legal.pair, legal.reply, legal.limit
        lanes.rank[i] = first_guess(players, lanes.player[i], s, lanes.bits[i])
        lanes.choices[i] = legal.choices
    if with_recovery(tables):
        for i in range(count):
            lanes.place[i] = place_choice(players, lanes.other[i], lanes.state[i], lanes.bits[i])
    for i in range(count):
        lanes.rank[i] = find_rank(players, lanes.player[i], lanes.first[i], lanes.rank[i], lanes.bits[i])


@inlined
def _look_up(tables: Tables, rallies: BlockRallies, lanes: Lanes, count: int, t: int) -> None:
    """Store stroke t of each rally, and read its thresholds and the state that follows."""
    for i in range(count):
        legal = Legal(np.uint64(lanes.block[i]), 0, lanes.first[i], lanes.reply[i], lanes.limit[i], lanes.choices[i])
        k, place = lanes.rank[i], lanes.place[i]
        at = np.uint64(lanes.rally[i]), np.uint64(t)
        rallies.state[at], rallies.pair[at], rallies.place[at] = lanes.state[i], legal.pair + k, place
        lanes.limits[i] = limits_of(tables, legal, k, (rallies.server[lanes.rally[i]] + t) & 1, place)
        lanes.arrival[i] = arrival_of(tables, legal, k)


@inlined
def _strike(rallies: BlockRallies, lanes: Lanes, count: int, t: int) -> int:
    """Decide the last of t strokes of each rally; returns how many rallies continue."""
    alive = 0
    for i in range(count):
        rally, player, other = lanes.rally[i], lanes.player[i], lanes.other[i]
        outcome = outcome_of(lanes.limits[i], lanes.bits[i])
        rallies.length[rally], rallies.outcome[rally] = t, outcome
        _move(lanes, i, alive)
        lanes.state[alive] = next_state(lanes.arrival[i], outcome)
        lanes.player[alive], lanes.other[alive] = other, player
        alive += outcome >= OPEN
    return alive


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


class Tape(NamedTuple):
    """Rallies in the order in which they ended; R = N = 0 if they are not wanted.

    Attributes:
        rally: ``[R]`` number of the rally.
        length: ``[R]`` number of strokes.
        ended: ``[3, R]`` server, winner, and outcome of the last stroke.
        state: ``[N]`` state of every stroke of both players, rally after rally.
        pair: ``[N]`` legal pair of every stroke.
        waited: ``[N]`` position of every receiver; N = 0 in the game without recovery.
        used: ``[2]`` number of rallies and of strokes on the tape.
    """

    rally: I64
    length: I32
    ended: U8
    state: I32
    pair: I32
    waited: I8
    used: I64


def new_tape(rallies: int = 0, strokes: int = 0, *, recovery: bool = False) -> Tape:
    """Allocate a tape of a capacity; with capacity 0 nothing is recorded."""
    return Tape(
        np.empty(rallies, np.int64),
        np.empty(rallies, np.int32),
        np.empty((3, rallies), np.uint8),
        np.empty(strokes, np.int32),
        np.empty(strokes, np.int32),
        np.empty(strokes * recovery, np.int8),
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
        shaping: ``[P]`` addition to the reward of a stroke, or ``[0]``.
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
        used: ``[2]`` number of rallies and of states.
    """

    rally: I64
    state: I32
    used: I64


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
def _write(tables: Tables, tape: Tape, rallies: BlockRallies, i: int, number: int) -> None:
    """Write rally i of a block onto the tape."""
    at, first = tape.used[0], tape.used[1]
    length, server, outcome = rallies.length[i], rallies.server[i], rallies.outcome[i]
    tape.rally[at], tape.length[at] = number, length
    last = (server + length - 1) & 1
    tape.ended[0, at], tape.ended[1, at] = server, last ^ (1 - outcome)
    tape.ended[2, at] = WINNER if outcome else FAULT
    for t in range(length):
        tape.state[first + t], tape.pair[first + t] = rallies.state[i, t], rallies.pair[i, t]
        if with_recovery(tables):
            tape.waited[first + t] = position_at(tables, rallies.state[i, t], rallies.place[i, t])
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
def _place_pair(tables: Tables, learned: Learned, rallies: BlockRallies, i: int, t: int) -> int:
    """Number of the receiver's position at stroke t of rally i, behind the legal pairs."""
    return int64(learned.log_probability.size - N_POSITIONS * (states_of(tables) - rallies.state[i, t]) + rallies.place[i, t])


@inlined
def _credit_both(
    tables: Tables,
    learned: Learned,
    collected: Collected,
    first: int,
    rallies: BlockRallies,
    i: int,
    reward: float,
    credit: Credit,
) -> None:
    """Add all strokes of a rally of self-play, backwards; each value is that of its striker, so gamma is -1.

    What a stroke returns to the striker, the position against it returns to the receiver with the other sign.
    """
    recovery, states = with_recovery(tables), states_of(tables)
    a, after, following, won = 0.0, 0.0, -1, reward
    for t in range(rallies.length[i] - 1, -1, -1):
        s = rallies.state[i, t]
        a = _advantage(won, learned.value[s], after, a, -1.0, credit.gae_lambda)
        at = first + (1 + recovery) * t if first >= 0 else -1
        _add(learned, collected, at, _Stroke(s, rallies.pair[i, t], following, won, a))
        if recovery:
            b, then = -(a + learned.value[s]) - learned.value[states + s], states + following if following >= 0 else -1
            position = _Stroke(states + s, _place_pair(tables, learned, rallies, i, t), then, -won, b)
            _add(learned, collected, at + 1 if first >= 0 else -1, position)
        after, following, won = learned.value[s], s, 0.0


@inlined
def _credit_learner(
    tables: Tables,
    learned: Learned,
    collected: Collected,
    first: int,
    rallies: BlockRallies,
    i: int,
    reward: float,
    credit: Credit,
) -> None:
    """Add the learner's strokes of a rally, every other one: from the second on if the opponent serves.

    With recovery the learner decides at every stroke: when the opponent strikes, on a position.
    """
    a, after, following, won = 0.0, 0.0, -1, reward
    recovery, states, server = with_recovery(tables), states_of(tables), rallies.server[i]
    begin, step = (0, 1) if recovery else (server, 2)
    for j in range((rallies.length[i] - 1 - begin) // step, -1, -1):
        t = begin + step * j
        s, pair = int64(rallies.state[i, t]), int64(rallies.pair[i, t])
        if recovery and (server + t) & 1:
            s, pair = states + s, _place_pair(tables, learned, rallies, i, t)
        elif credit.shaping.size > 0:
            won += credit.shaping[pair]
        a = _advantage(won, learned.value[s], after, a, 1.0, credit.gae_lambda)
        at = first + j if first >= 0 else -1
        _add(learned, collected, at, _Stroke(s, pair, following, won, a))
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
) -> tuple[int, int]:
    """Play the rallies with these numbers and add them to ``collected``; those that miss entries of the table go to ``pending``.

    Returns:
        Number of rallies before the first for which an array is too small, so that results do not depend on the sizes of arrays;
        and which: TOO_LONG (workspace), FULL (results), or 0.
    """
    sums, strokes, tape, waiting = collected.sums, collected.strokes, collected.tape, pending.used
    recovery = with_recovery(tables)
    listed, taped, used = strokes.state.size > 0, tape.rally.size > 0, collected.listed
    rallies = workspace.rallies
    for first in range(0, numbers.size, BLOCK):
        block = numbers[first : first + BLOCK]
        play(tables, learned, schedule, block, workspace)
        for i in range(block.size):
            number, length, server = block[i], rallies.length[i], rallies.server[i]
            opponent = schedule.opponents[number % schedule.opponents.size]
            if length == STALE:
                pending.rally[waiting[0]] = number
                waiting[0] += 1
                # In self-play both decisions of a state are asked for at once.
                for decision in (server, (server + states_of(tables)) % learned.written.size if opponent < 0 else server):
                    if 0 <= learned.written[decision] < schedule.oldest:
                        pending.state[waiting[1]] = decision
                        waiting[1] += 1
                        learned.written[decision] = -1
                continue
            own = length if opponent < 0 or recovery else (length - server + 1) // 2
            own += length if opponent < 0 and recovery else 0
            if length == TOO_LONG:
                return first + i, TOO_LONG
            if (listed and used[0] + own > strokes.state.size) or (taped and not _fits(tape, length)):
                return first + i, FULL
            reward = 2.0 * rallies.outcome[i] - 1.0
            sums.total[1] += 1
            sums.total[5] += length
            at = used[0] if listed else -1
            if opponent < 0:
                _credit_both(tables, learned, collected, at, rallies, i, reward, credit)
            else:
                if (server + length - 1) & 1:
                    reward = -reward
                sums.total[2] += reward > 0
                _credit_learner(tables, learned, collected, at, rallies, i, reward, credit)
            used[0] += own if listed else 0
            if taped:
                _write(tables, tape, rallies, i, number)
    return numbers.size, 0


@inlined
def _options(tables: Tables, decision: int, pairs: int) -> tuple[int, int, int]:
    """Of a decision: its state, the number of its first option behind P legal pairs, and how many options it has."""
    states = states_of(tables)
    if decision < states:
        legal = legal_strokes(tables, decision)
        return decision, int64(legal.pair), int64(legal.n)
    return decision - states, pairs + N_POSITIONS * (decision - states), choices_in(tables, decision - states)


@inlined
def _action(tables: Tables, decision: int, k: int) -> int:
    """The k-th option of a decision as an action: catalogue index of a stroke, or n plus a position."""
    states = states_of(tables)
    if decision < states:
        return stroke_of(tables, legal_strokes(tables, decision), k)
    return tables.rank.shape[1] + position_at(tables, decision - states, k)


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
def replay(tables: Tables, learned: Learned, schedule: Schedule, numbers: I64, workspace: Workspace, tape: Tape) -> int:
    """Play rallies onto a tape; returns the number of rallies that fit."""
    for first in range(0, numbers.size, BLOCK):
        block = numbers[first : first + BLOCK]
        play(tables, learned, schedule, block, workspace)
        for i in range(block.size):
            length = workspace.rallies.length[i]
            if length < 0 or not _fits(tape, length):
                return first + i
            _write(tables, tape, workspace.rallies, i, block[i])
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
