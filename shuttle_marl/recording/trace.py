"""Whole rallies from what a collector gathers of the batched environments.

A learner sees neither the stroke with which an opponent ends a rally, nor rallies that end on an opponent's serve, nor the
numbers of the rallies. All of that follows from the seed, because the environments draw by counter; this works it out,
compiled, at the ends of rallies alone. Needs numba, so it is imported where it is used.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl import draws
from shuttle_marl.kernel.core import (
    Players,
    Tables,
    compiled,
    draw,
    extend,
    first_server,
    inlined,
    outcome_of,
    pack,
    table_choice,
    tables_of,
)
from shuttle_marl.policy.table import TabulatedPolicy
from shuttle_marl.rally import Game
from shuttle_marl.recording.schema import OF_STROKES, Rallies, RecordingError

_BY_LOT: Final = -1
_DONE, _NO_ROOM, _TOO_LONG, _WRONG = 0, 1, 2, 3
_LONGEST: Final = 64
"""First guess of the strokes of a rally; a longer one makes room."""


class _Rows(NamedTuple):
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


class _Ended(NamedTuple):
    """Room for rallies that ended."""

    rally: npt.NDArray[np.uint32]
    opponent: npt.NDArray[np.int32]
    server: npt.NDArray[np.uint8]
    winner: npt.NDArray[np.uint8]
    reason: npt.NDArray[np.uint8]
    length: npt.NDArray[np.int32]
    stroke: npt.NDArray[np.unsignedinteger]
    extra: npt.NDArray[np.float32]


class _Played(NamedTuple):
    """What was collected, ``[B, T]``: strokes, rewards, observations ``[B, T, 3]``, and what is recorded ``[E, B, T]``."""

    stroke: npt.NDArray[np.int64]
    reward: npt.NDArray[np.float32]
    observation: npt.NDArray[np.int32]
    extra: npt.NDArray[np.float32]


class _Setting(NamedTuple):
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
            return _DONE, r, n
        start = setting.tables.head[0, 0]
        k = table_choice(setting.players, rows.opponent[i], 0, start, bits)
        outcome = outcome_of(setting.tables.limits[start + k], bits)
        if outcome >= 2:
            return _DONE, r, n
        if r == ended.rally.size or n == ended.stroke.size:
            return _NO_ROOM, r, n
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
            return _TOO_LONG, r, n
        stroke = played.stroke[i, t]
        if stroke < 0 or stroke >= n_strokes:
            return _WRONG, r, n
        if setting.seat >= 0:
            own, incoming = played.observation[i, t, 0], played.observation[i, t, 1]
            if own < 0 or own > n_strokes or incoming < 0 or incoming > n_strokes:
                return _WRONG, r, n
            if (incoming < n_strokes) == (rows.length[i] == 0 and rows.server[i] == setting.seat):
                return _WRONG, r, n
            if incoming < n_strokes:
                _note(rows, i, incoming)
        _note(rows, i, stroke)
        for e in range(rows.extra.shape[0]):
            rows.extra[e, i, rows.length[i] - 1] = played.extra[e, i, t]
        reward = played.reward[i, t]
        if reward != 0:
            outcome = _last_outcome(setting, rows, i, played.observation, t, reward)
            if outcome < 0:
                return _WRONG, r, n
            if r == ended.rally.size or n + rows.length[i] > ended.stroke.size:
                return _NO_ROOM, r, n
            _end(rows, ended, i, outcome, r, n)
            r, n = r + 1, n + rows.length[i]
            how, r, n = _begin(setting, rows, ended, i, seed_key, r, n)
            if how != _DONE:
                return how, r, n
    return _DONE, r, n


@compiled
def _follow(
    setting: _Setting, rows: _Rows, ended: _Ended, played: _Played, seed_key: np.uint64, at: tuple[int, int, int]
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
        if how != _DONE:
            rows.server[i], rows.rally[i], rows.key[i] = server, rally, key
            rows.opponent[i], rows.length[i] = opponent, length
            for j in range(length):
                rows.stroke[i, j] = kept[j]
                for e in range(rows.extra.shape[0]):
                    rows.extra[e, i, j] = kept_extra[e, j]
            return how, i, r, n
        i, r, n = i + 1, r_after, n_after
    return _DONE, i, r, n


@compiled
def _begin_all(setting: _Setting, rows: _Rows, ended: _Ended, seed_key: np.uint64) -> tuple[int, int, int]:
    how, r, n = _DONE, 0, 0
    for i in range(rows.rally.size):
        how, r, n = _begin(setting, rows, ended, i, seed_key, r, n)
        if how != _DONE:
            break
    return how, r, n


class RallyTrace:
    """Follows B rows of a batched environment and hands over the rallies that end.

    Rallies that end on an opponent's serve are among them. The header of their log says ``draws="rally_v0"``,
    ``rules=SINGLE_RALLY``, ``matches_per_draw=1``; the number of a match is that of its rally.

    Args:
        game: the tables.
        batch: number of rows B.
        opponents: the opponents of ``VersusEnv``; none: self-play, as in ``RallyEnv``.
        seed: of the environment.
        seat: seat of the learner, where there are opponents.
        server: seat that serves, 0 or 1; None: by lot.
        columns: those of ``log_probability``, ``value`` and ``update`` that are recorded.
    """

    def __init__(
        self,
        game: Game,
        batch: int,
        *,
        opponents: Sequence[TabulatedPolicy] = (),
        seed: int = 0,
        seat: Literal[0, 1] = 0,
        server: Literal[0, 1] | None = None,
        columns: tuple[str, ...] = (),
    ) -> None:
        none = Players(np.empty((0, 0), np.uint16), np.empty((0, 0, 16), np.uint8))
        self._setting = _Setting(
            tables=tables_of(game),
            players=pack(opponents, game) if opponents else none,
            height=game.catalogue.height.astype(np.int8),
            reply_start=game.reply_start.ravel(),
            seat=seat if opponents else -1,
            server=_BY_LOT if server is None else server,
        )
        self._columns = tuple(name for name in OF_STROKES if name in columns)
        self._update = "update" in columns
        following = np.arange(batch, dtype=np.int32) % max(1, len(opponents))
        self._rows = _Rows(
            server=np.zeros(batch, np.int8),
            rally=np.zeros(batch, np.int64),
            key=np.zeros(batch, np.uint64),
            opponent=following.copy(),
            following=following,
            length=np.zeros(batch, np.int32),
            stroke=np.zeros((batch, _LONGEST), np.uint8 if game.n_strokes <= 256 else np.uint16),
            extra=np.zeros((len(self._columns), batch, _LONGEST), np.float32),
        )
        self._unseen: list[Rallies] = []
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Begin anew with rally 0 of a seed, as the environment does; rallies that go on are dropped."""
        self._seed_key = draws.stream(seed)[0]
        batch = len(self._rows.rally)
        room = batch
        while True:
            self._rows.rally[:] = np.arange(batch) - batch
            ended = self._room(room, room)
            how, r, n = _begin_all(self._setting, self._rows, ended, self._seed_key)
            if how == _DONE:
                break
            room *= 2
        self._unseen = [self._rallies(ended, r, n, 0)]

    def assign(self, opponent: npt.NDArray[np.integer]) -> None:
        """Say which opponent ``[B]`` each row meets in the rallies that begin from now on, as ``VersusBatch.assign`` does."""
        self._rows.following[:] = opponent

    def add(
        self,
        stroke: npt.NDArray[np.integer],
        reward: npt.NDArray[np.floating],
        observation: npt.NDArray[np.integer] | None = None,
        *,
        update: int = 0,
        **recorded: npt.NDArray[np.floating],
    ) -> Rallies:
        """Follow T steps of every row, and take away the rallies that ended.

        Args:
            stroke: ``[B, T]`` catalogue index of the learner's strokes (in self-play, of both players).
            reward: ``[B, T]`` of the striker, 0 where the rally goes on.
            observation: ``[B, T, 3]`` what the learner saw before each stroke; in self-play not needed.
            update: how many updates the learner has made.
            **recorded: ``[B, T]`` each, ``log_probability`` and ``value``.

        Returns:
            The rallies that ended, row after row. Policy 0 is the learner (in self-play at both seats), policy 1 + k is
            opponent k; pairing 0.

        Raises:
            RecordingError: a shape that does not fit, a column that was not asked for, or steps that do not follow from the
                seed: then the environment plays other rallies than these.
        """
        batch, steps = len(self._rows.rally), np.shape(stroke)[-1]
        seen: npt.ArrayLike = np.empty((batch, steps, 3), np.int32) if self._setting.seat < 0 else np.asarray(observation)
        shapes = {"stroke": np.shape(stroke), "reward": np.shape(reward), "observation": np.shape(seen)[:2]}
        shapes |= {name: np.shape(column) for name, column in recorded.items()}
        if set(shapes.values()) != {(batch, steps)} or set(recorded) != set(self._columns):
            raise RecordingError(f"shapes {shapes}: expected ({batch}, T) for these and for {self._columns}")
        extra = np.empty((len(self._columns), batch, steps), np.float32)
        for e, name in enumerate(self._columns):
            extra[e] = recorded[name]
        played = _Played(
            stroke=np.ascontiguousarray(stroke, dtype=np.int64),
            reward=np.ascontiguousarray(reward, dtype=np.float32),
            observation=np.ascontiguousarray(seen, dtype=np.int32),
            extra=extra,
        )
        ended = self._room(int(self._rows.length.sum()) + 3 * batch * steps + batch, batch * steps + batch)
        at = (0, 0, 0)
        while True:
            how, *now = _follow(self._setting, self._rows, ended, played, self._seed_key, at)
            at = (now[0], now[1], now[2])
            if how == _DONE:
                found = [*self._begun(update), self._rallies(ended, at[1], at[2], update)]
                return Rallies.join(found) if len(found) > 1 else found[0]
            if how == _WRONG:
                raise RecordingError(f"row {at[0]}: its strokes do not follow from the seed; the environment plays other rallies")
            if how == _TOO_LONG:
                more = [(0, 0), (0, self._rows.stroke.shape[1])]
                self._rows = self._rows._replace(
                    stroke=np.pad(self._rows.stroke, more), extra=np.pad(self._rows.extra, [(0, 0), *more])
                )
            else:
                larger = self._room(2 * ended.stroke.size, 2 * ended.rally.size)
                for field, old in ended._asdict().items():
                    getattr(larger, field)[..., : old.shape[-1]] = old
                ended = larger

    def _begun(self, update: int) -> list[Rallies]:
        """The rallies that were over as the rows began, once."""
        begun, self._unseen = self._unseen, []
        return [dataclasses.replace(r, update=np.full(len(r), update, np.uint32)) if self._update else r for r in begun]

    def _room(self, strokes: int, rallies: int) -> _Ended:
        return _Ended(
            rally=np.empty(rallies, np.uint32),
            opponent=np.empty(rallies, np.int32),
            server=np.empty(rallies, np.uint8),
            winner=np.empty(rallies, np.uint8),
            reason=np.empty(rallies, np.uint8),
            length=np.empty(rallies, np.int32),
            stroke=np.empty(strokes, self._rows.stroke.dtype),
            extra=np.empty((len(self._columns), strokes), np.float32),
        )

    def _rallies(self, ended: _Ended, rallies: int, strokes: int, update: int) -> Rallies:
        policy = np.zeros((rallies, 2), np.uint16)
        if self._setting.seat >= 0:
            policy[:, 1 - self._setting.seat] = 1 + ended.opponent[:rallies]
        return Rallies(
            pairing=np.zeros(rallies, np.uint32),
            match=ended.rally[:rallies],
            rally=np.zeros(rallies, np.uint16),
            policy=policy,
            server=ended.server[:rallies],
            winner=ended.winner[:rallies],
            reason=ended.reason[:rallies],
            score=np.zeros((rallies, 4), np.uint8),
            length=ended.length[:rallies],
            stroke=ended.stroke[:strokes],
            update=np.full(rallies, update, np.uint32) if self._update else None,
            **{name: ended.extra[e, :strokes] for e, name in enumerate(self._columns)},
        )
