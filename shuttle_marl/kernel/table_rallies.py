"""Rallies of a learner that acts from a table, a block of them side by side, compiled.

Every stroke waits for one table after another. So all rallies of a block advance together by a stroke, in passes that do one
thing each: what many rallies wait for is then under way at once.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.arrays import I32, I64, U64
from shuttle_marl.kernel.compiling import inlined
from shuttle_marl.kernel.core import (
    BLOCK,
    arrival_of,
    block_of,
    draw,
    extend,
    first_guess,
    first_server,
    next_state,
    outcome_of,
    table_rank,
)

OPEN: Final = 2
"""Least outcome of a stroke after which the rally continues."""
STALE, TOO_LONG = -1, -2
START: Final = np.uint64(1 << 40)
"""Names the draw that says where a rally begins; no rally has so many strokes."""


class Starts(NamedTuple):
    """States in which some rallies of self-play begin.

    Attributes:
        states: ``[M]`` one of them, equally likely.
        share: ``[1]`` of the rallies, in units of 1/65536.
    """

    states: I32
    share: I64


def no_starts() -> Starts:
    """All rallies begin with a serve."""
    return Starts(np.zeros(0, np.int32), np.zeros(1, np.int64))


class Rallies(NamedTuple):
    """The rallies of a block, up to BLOCK of them.

    Attributes:
        state: ``[BLOCK, room]`` states of the strokes of each rally.
        pair: ``[BLOCK, room]`` legal pairs that were played.
        limit: ``[BLOCK, room]`` places of their thresholds.
        length: ``[BLOCK]`` strokes; STALE where an entry is missing, TOO_LONG where there is no room for them.
        server: ``[BLOCK]`` seat that serves; where an entry is missing, its state.
        outcome: ``[BLOCK]`` of the last stroke.
    """

    state: I32
    pair: I32
    limit: I32
    length: I64
    server: I64
    outcome: I64


class Lanes(NamedTuple):
    """Rallies that are not over, as the passes hand them to each other, ``[BLOCK]`` each.

    Attributes:
        rally: number of the rally in the block.
        key: of its draws.
        player: who plays the next stroke; 0 is the learner.
        other: who plays the one behind it.
        state: of the striker.
        bits: draw of the stroke.
        block: block of efforts of the state.
        first: first legal pair of the state.
        reply: place of the first of its replies.
        rank: position of the stroke among the legal ones.
        limits: its thresholds.
        arrival: state of who strikes next, contact below.
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
    rank: I64
    limits: U64
    arrival: I64


class Room(NamedTuple):
    """Room to play a block of rallies."""

    rallies: Rallies
    lanes: Lanes


def room_for(strokes: int) -> Room:
    """Room for rallies of up to a number of strokes."""
    kinds = {"key": np.uint64, "bits": np.uint64, "limits": np.uint64}
    lanes: dict[str, Any] = {name: np.empty(BLOCK, kinds.get(name, np.int64)) for name in Lanes._fields}
    lists: list[I32] = [np.empty((BLOCK, strokes), np.int32) for _ in range(3)]
    ends: list[I64] = [np.empty(BLOCK, np.int64) for _ in range(3)]
    return Room(Rallies(lists[0], lists[1], lists[2], ends[0], ends[1], ends[2]), Lanes(**lanes))


@inlined
def play(tables: Any, learned: Any, opponents: Any, starts: Any, seed_key: Any, numbers: Any, oldest: Any, room: Any) -> None:
    """Play the rallies with some numbers, BLOCK or fewer, to their end or to an entry that is missing or too old."""
    rallies, lanes = room.rallies, room.lanes
    for i in range(numbers.size):
        key = extend(seed_key, numbers[i])
        opponent = np.int64(opponents[numbers[i] % opponents.size])
        server = first_server(draw(key, 0))
        rallies.server[i] = server
        lanes.rally[i], lanes.key[i], lanes.state[i] = i, key, _start(starts, opponent, key)
        rival = max(opponent, 0)  # in self-play the learner
        lanes.player[i], lanes.other[i] = (rival, 0) if server else (0, rival)
    count, t = numbers.size, 0
    while count:
        count = _admit(learned, rallies, lanes, count, t, oldest)
        _choose(tables, learned, lanes, count)
        _look_up(tables, rallies, lanes, count, t)
        t += 1
        count = _strike(rallies, lanes, count, t)


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
def _admit(learned: Any, rallies: Any, lanes: Any, count: Any, t: Any, oldest: Any) -> Any:
    """Draw stroke ``t`` of each rally whose entry and room are there; returns their number."""
    full = t == rallies.state.shape[1]
    kept = 0
    for i in range(count):
        rally, s = lanes.rally[i], lanes.state[i]
        missing = lanes.player[i] == 0 and learned.written[np.uint64(s)] < oldest
        if missing or full:
            rallies.length[rally], rallies.server[rally] = STALE if missing else TOO_LONG, s
        _move(lanes, i, kept)
        lanes.state[kept], lanes.bits[kept] = s, draw(lanes.key[i], t)
        kept += not (missing or full)
    return kept


@inlined
def _move(lanes: Any, i: Any, to: Any) -> None:
    """Move a rally to a place before it."""
    lanes.rally[to], lanes.key[to] = lanes.rally[i], lanes.key[i]
    lanes.player[to], lanes.other[to] = lanes.player[i], lanes.other[i]


@inlined
def _choose(tables: Any, learned: Any, lanes: Any, count: Any) -> None:
    """Choose a stroke for each rally."""
    for i in range(count):
        s = lanes.state[i]
        of = block_of(tables, s)
        head = tables.head[np.uint64(s - tables.first[of, 0])]
        lanes.block[i], lanes.first[i], lanes.reply[i] = of, head[0] + tables.first[of, 1], head[2]
        lanes.rank[i] = first_guess(learned.players, lanes.player[i], s, lanes.bits[i])
    for i in range(count):
        lanes.rank[i] = table_rank(learned.players, lanes.player[i], lanes.first[i], lanes.rank[i], lanes.bits[i])


@inlined
def _look_up(tables: Any, rallies: Any, lanes: Any, count: Any, t: Any) -> None:
    """Note the stroke of each rally, and read its thresholds and where it leads."""
    for i in range(count):
        of, pair = np.uint64(lanes.block[i]), lanes.first[i] + lanes.rank[i]
        limit = pair - tables.first[of, 1] + tables.first[of, 2]
        at = np.uint64(lanes.rally[i]), np.uint64(t)
        rallies.state[at], rallies.pair[at], rallies.limit[at] = lanes.state[i], pair, limit
        lanes.limits[i] = tables.limits[np.uint64(limit)]
        lanes.arrival[i] = arrival_of(tables, of, np.uint64(lanes.reply[i] + lanes.rank[i]))


@inlined
def _strike(rallies: Any, lanes: Any, count: Any, t: Any) -> Any:
    """Decide the t-th stroke of each rally; returns how many continue."""
    kept = 0
    for i in range(count):
        rally, player, other = lanes.rally[i], lanes.player[i], lanes.other[i]
        outcome = outcome_of(lanes.limits[i], lanes.bits[i])
        rallies.length[rally], rallies.outcome[rally] = t, outcome
        _move(lanes, i, kept)
        lanes.state[kept] = next_state(lanes.arrival[i], outcome)
        lanes.player[kept], lanes.other[kept] = other, player
        kept += outcome >= OPEN
    return kept
