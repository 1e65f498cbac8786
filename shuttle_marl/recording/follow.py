"""Follows rows of collected steps, compiled: which strokes opponents must have played, and how rallies ended.

What :mod:`shuttle_marl.recording.trace` rests on. Needs numba, so it is imported where it is used.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.kernel.core import (
    Players,
    Tables,
    compiled,
    draw,
    extend,
    first_server,
    inlined,
    outcome_of,
    table_choice,
)

DONE, NO_ROOM, TOO_LONG, WRONG = 0, 1, 2, 3
"""How following went: to the end; no room for what ended; a rally outgrew its row; it does not follow from the seed."""


class Rows(NamedTuple):
    """B rallies that go on: seat of the server, number and key of the rally, opponent in it and in those that begin from now
    on, and the strokes so far with what was recorded of them."""

    server: npt.NDArray[np.int8]
    rally: npt.NDArray[np.int64]
    key: npt.NDArray[np.uint64]
    opponent: npt.NDArray[np.int32]
    following: npt.NDArray[np.int32]
    length: npt.NDArray[np.int32]
    stroke: npt.NDArray[np.unsignedinteger]
    extra: npt.NDArray[np.float32]


class Ended(NamedTuple):
    """Room for rallies that ended."""

    rally: npt.NDArray[np.uint32]
    opponent: npt.NDArray[np.int32]
    server: npt.NDArray[np.uint8]
    winner: npt.NDArray[np.uint8]
    reason: npt.NDArray[np.uint8]
    length: npt.NDArray[np.int32]
    stroke: npt.NDArray[np.unsignedinteger]
    extra: npt.NDArray[np.float32]


class Played(NamedTuple):
    """What was collected, ``[B, T]``: strokes, rewards, observations ``[B, T, 3]``, and what is recorded ``[E, B, T]``."""

    stroke: npt.NDArray[np.int64]
    reward: npt.NDArray[np.float32]
    observation: npt.NDArray[np.int32]
    extra: npt.NDArray[np.float32]


class Setting(NamedTuple):
    """What stays: the tables, the opponents, height of each stroke and first edge of the replies to it, and who sits where."""

    tables: Tables
    players: Players
    height: npt.NDArray[np.int8]
    reply_start: npt.NDArray[np.int32]
    seat: int
    server: int


@inlined
def _note(rows: Any, i: Any, stroke: Any) -> None:
    at = rows.length[i]
    rows.stroke[i, at] = stroke
    for e in range(rows.extra.shape[0]):
        rows.extra[e, i, at] = np.nan
    rows.length[i] = at + 1


@inlined
def _end(rows: Any, ended: Any, i: Any, outcome: Any, r: Any, n: Any) -> None:
    length = rows.length[i]
    striker = (rows.server[i] + length - 1) & 1
    ended.rally[r], ended.opponent[r], ended.server[r] = rows.rally[i], rows.opponent[i], rows.server[i]
    ended.winner[r] = striker if outcome == 1 else 1 - striker
    ended.reason[r], ended.length[r] = outcome, length
    for j in range(length):
        ended.stroke[n + j] = rows.stroke[i, j]
    for e in range(rows.extra.shape[0]):
        for j in range(length):
            ended.extra[e, n + j] = rows.extra[e, i, j]


@inlined
def _begin(setting: Any, rows: Any, ended: Any, i: Any, seed_key: Any, r: Any, n: Any) -> Any:
    """Begin rallies until one comes to the learner; those that do not are over. Returns how that went, and r and n."""
    while True:
        rows.rally[i] += rows.rally.size
        rows.key[i] = extend(seed_key, rows.rally[i])
        bits = draw(rows.key[i], 0)
        rows.server[i] = setting.server if setting.server >= 0 else first_server(bits)
        rows.opponent[i] = rows.following[i]
        rows.length[i] = 0
        if setting.seat < 0 or rows.server[i] == setting.seat:
            return DONE, r, n
        start = setting.tables.head[0, 0]
        k = table_choice(setting.players, rows.opponent[i], 0, start, bits)
        outcome = outcome_of(setting.tables.limits[start + k], bits)
        if outcome >= 2:
            return DONE, r, n
        if r == ended.rally.size or n == ended.stroke.size:
            return NO_ROOM, r, n
        _note(rows, i, setting.tables.incoming[setting.tables.head[0, 2] + k])
        _end(rows, ended, i, outcome, r, n)
        r, n = r + 1, n + 1


@inlined
def _last_outcome(setting: Any, rows: Any, i: Any, observation: Any, t: Any, reward: Any) -> Any:
    """How a rally ended in which the learner has just struck; notes the opponent's stroke if that was the last one.

    Returns 0 fault, 1 winner, or -1 where this does not fit to what the learner was paid.
    """
    if setting.seat < 0:
        return int(reward > 0)
    tables, own, incoming, contact = setting.tables, observation[i, t, 0], observation[i, t, 1], observation[i, t, 2]
    n_strokes = tables.rank.shape[1]
    edge = 0
    if incoming < n_strokes:
        row = 2 * own + setting.height[incoming]
        edge = int(setting.reply_start[row]) + int(tables.rank[row, incoming])
    s = 2 * edge + contact
    k = int(tables.rank[tables.head[s, 3], rows.stroke[i, rows.length[i] - 1]])
    if k < 0:
        return -1
    outcome = outcome_of(tables.limits[tables.head[s, 0] + k], draw(rows.key[i], rows.length[i] - 1))
    paid = 2 * outcome - 1
    if outcome >= 2:
        s = 2 * (tables.head[s, 2] + k) + outcome - 2
        bits = draw(rows.key[i], rows.length[i])
        start = tables.head[s, 0]
        k = table_choice(setting.players, rows.opponent[i], s, start, bits)
        _note(rows, i, tables.incoming[tables.head[s, 2] + k])
        outcome = outcome_of(tables.limits[start + k], bits)
        paid = 1 - 2 * outcome
    return outcome if outcome < 2 and paid == reward else -1


@inlined
def _follow_row(setting: Any, rows: Any, ended: Any, played: Any, seed_key: Any, i: Any, r: Any, n: Any) -> Any:
    """Follow row i; returns how that went, and the rallies and strokes that ended up to here."""
    longest = rows.stroke.shape[1] - 2
    n_strokes = setting.tables.rank.shape[1]
    for t in range(played.stroke.shape[1]):
        if rows.length[i] >= longest:
            return TOO_LONG, r, n
        stroke = played.stroke[i, t]
        if stroke < 0 or stroke >= n_strokes:
            return WRONG, r, n
        if setting.seat >= 0:
            own, incoming = played.observation[i, t, 0], played.observation[i, t, 1]
            if own < 0 or own > n_strokes or incoming < 0 or incoming > n_strokes:
                return WRONG, r, n
            if (incoming < n_strokes) == (rows.length[i] == 0 and rows.server[i] == setting.seat):
                return WRONG, r, n
            if incoming < n_strokes:
                _note(rows, i, incoming)
        _note(rows, i, stroke)
        for e in range(rows.extra.shape[0]):
            rows.extra[e, i, rows.length[i] - 1] = played.extra[e, i, t]
        reward = played.reward[i, t]
        if reward != 0:
            outcome = _last_outcome(setting, rows, i, played.observation, t, reward)
            if outcome < 0:
                return WRONG, r, n
            if r == ended.rally.size or n + rows.length[i] > ended.stroke.size:
                return NO_ROOM, r, n
            _end(rows, ended, i, outcome, r, n)
            r, n = r + 1, n + rows.length[i]
            how, r, n = _begin(setting, rows, ended, i, seed_key, r, n)
            if how != DONE:
                return how, r, n
    return DONE, r, n


@compiled
def follow(
    setting: Setting, rows: Rows, ended: Ended, played: Played, seed_key: np.uint64, at: tuple[int, int, int]
) -> tuple[int, int, int, int]:
    """Follow the rows from ``at[0]`` on; a row for which there is no room is left as it was.

    ``at`` and what is returned behind how it went: next row, rallies and strokes that ended.
    """
    i, r, n = at
    kept, kept_extra = np.empty_like(rows.stroke[0]), np.empty_like(rows.extra[:, 0])
    while i < rows.rally.size:
        server, rally, key = rows.server[i], rows.rally[i], rows.key[i]
        opponent, length = rows.opponent[i], rows.length[i]
        for j in range(length):
            kept[j] = rows.stroke[i, j]
        for e in range(rows.extra.shape[0]):
            for j in range(length):
                kept_extra[e, j] = rows.extra[e, i, j]
        how, r_after, n_after = _follow_row(setting, rows, ended, played, seed_key, i, r, n)
        if how != DONE:
            rows.server[i], rows.rally[i], rows.key[i] = server, rally, key
            rows.opponent[i], rows.length[i] = opponent, length
            for j in range(length):
                rows.stroke[i, j] = kept[j]
                for e in range(rows.extra.shape[0]):
                    rows.extra[e, i, j] = kept_extra[e, j]
            return how, i, r, n
        i, r, n = i + 1, r_after, n_after
    return DONE, i, r, n


@compiled
def begin_all(setting: Setting, rows: Rows, ended: Ended, seed_key: np.uint64) -> tuple[int, int, int]:
    """Begin a rally in every row; returns how that went, and the rallies and strokes that ended before the learner struck."""
    how, r, n = DONE, 0, 0
    for i in range(rows.rally.size):
        how, r, n = _begin(setting, rows, ended, i, seed_key, r, n)
        if how != DONE:
            break
    return how, r, n
