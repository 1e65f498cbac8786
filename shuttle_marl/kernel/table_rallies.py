"""Rallies of a learner that acts from a table, a block of them at a time, compiled.

Each stroke depends on several table reads. Therefore all rallies of a block advance by one stroke together, in passes that do one
thing each, so that the reads of many rallies overlap.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F32, I32, I64, U64
from shuttle_marl.base.compiling import inlined
from shuttle_marl.kernel.core import (
    BLOCK,
    LOW_16,
    OPEN,
    Legal,
    Tables,
    arrival_of,
    draw,
    extend,
    first_server,
    int64,
    legal_strokes,
    limits_of,
    next_state,
    outcome_of,
    uniform_choice,
)
from shuttle_marl.kernel.players import Players, find_rank, first_guess

STALE, TOO_LONG = -1, -2
START: Final = 1 << 40
"""Counter of the draw of the initial state of a rally; no rally has so many strokes."""


class Learned(NamedTuple):
    """The learner's table, filled for the states that occur.

    Attributes:
        players: the learner, followed by its opponents.
        log_probability: ``[P]`` of the legal pairs.
        value: ``[S]`` value to the striker.
        written: ``[S]`` int32 iteration in which the entry was written; 0: never, -1: requested.
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
        limit: ``[BLOCK, T]`` indices of their thresholds.
        length: ``[BLOCK]`` number of strokes; STALE if an entry of the table is missing or stale, TOO_LONG if it exceeds T.
        server: ``[BLOCK]`` seat that serves; if ``length`` is STALE, the state of the entry.
        outcome: ``[BLOCK]`` outcome of the last stroke.
    """

    state: I32
    pair: I32
    limit: I32
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
        rank: position of the stroke among the legal strokes.
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
    rank: I64
    limits: U64
    arrival: I64


class Workspace(NamedTuple):
    """Arrays to play a block of rallies."""

    rallies: BlockRallies
    lanes: Lanes


def new_workspace(strokes: int) -> Workspace:
    """Allocate arrays for rallies of up to ``strokes`` strokes."""
    kinds = {"key": np.uint64, "bits": np.uint64, "limits": np.uint64}
    lanes: dict[str, Any] = {name: np.empty(BLOCK, kinds.get(name, np.int64)) for name in Lanes._fields}
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
        count = _admit(learned, rallies, lanes, count, t, schedule.oldest)
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
def _admit(learned: Learned, rallies: BlockRallies, lanes: Lanes, count: int, t: int, oldest: int) -> int:
    """Draw stroke ``t`` of each rally whose entry is there and that fits; returns their number."""
    full = t == rallies.state.shape[1]
    admitted = 0
    for i in range(count):
        rally, s = lanes.rally[i], lanes.state[i]
        missing = lanes.player[i] == 0 and learned.written[np.uint64(s)] < oldest
        if missing or full:
            rallies.length[rally], rallies.server[rally] = STALE if missing else TOO_LONG, s
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
    """Choose a stroke in each lane."""
    for i in range(count):
        s = lanes.state[i]
        legal = legal_strokes(tables, s)
        lanes.block[i], lanes.first[i], lanes.reply[i], lanes.limit[i] = legal.block, legal.pair, legal.reply, legal.limit
        lanes.rank[i] = first_guess(players, lanes.player[i], s, lanes.bits[i])
    for i in range(count):
        lanes.rank[i] = find_rank(players, lanes.player[i], lanes.first[i], lanes.rank[i], lanes.bits[i])


@inlined
def _look_up(tables: Tables, rallies: BlockRallies, lanes: Lanes, count: int, t: int) -> None:
    """Store stroke t of each rally, and read its thresholds and the state that follows."""
    for i in range(count):
        legal = Legal(np.uint64(lanes.block[i]), 0, lanes.first[i], lanes.reply[i], lanes.limit[i])
        k = lanes.rank[i]
        at = np.uint64(lanes.rally[i]), np.uint64(t)
        rallies.state[at], rallies.pair[at], rallies.limit[at] = lanes.state[i], legal.pair + k, legal.limit + k
        lanes.limits[i] = limits_of(tables, legal, k, (rallies.server[lanes.rally[i]] + t) & 1)
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
