"""Whole rallies from the strokes of a learner alone.

The batched environments draw by counter, so whoever knows the seed and the strokes of the learner knows everything else:
the numbers of the rallies, who serves, what tabulated opponents reply, how each stroke ends. This plays along, compiled,
beside :class:`shuttle_marl.kernel.RallyBatch` or :class:`shuttle_marl.kernel.VersusBatch`; what a collector gathered is
enough, and the environments need not report anything. Needs numba, so it is imported where it is used.
"""

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
_DONE, _NO_ROOM, _TOO_LONG, _ILLEGAL = 0, 1, 2, 3
_LONGEST: Final = 64
"""First guess of the strokes of a rally; a longer one makes room."""


class _Rows(NamedTuple):
    """B rallies that go on: state, seat of the striker and of the server, number and key of the rally, opponent in it and in
    those that begin from now on, and the strokes so far with what was recorded of them."""

    state: npt.NDArray[np.int32]
    striker: npt.NDArray[np.int8]
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


@inlined
def _begin(rows: Any, i: Any, seed_key: Any, server: Any) -> None:
    rows.rally[i] += rows.rally.size
    rows.key[i] = extend(seed_key, rows.rally[i])
    rows.state[i] = 0
    rows.length[i] = 0
    rows.server[i] = server if server >= 0 else first_server(draw(rows.key[i], 0))
    rows.striker[i] = rows.server[i]
    rows.opponent[i] = rows.following[i]


@inlined
def _strike(tables: Any, rows: Any, i: Any, k: Any, bits: Any) -> Any:
    """Note and play the k-th legal stroke of row i; returns its outcome."""
    s = rows.state[i]
    outcome = outcome_of(tables.limits[tables.head[s, 0] + k], bits)
    edge = tables.head[s, 2] + k
    rows.stroke[i, rows.length[i]] = tables.incoming[edge]
    rows.length[i] += 1
    if outcome >= 2:
        rows.state[i] = 2 * edge + outcome - 2
        rows.striker[i] = 1 - rows.striker[i]
    return outcome


@inlined
def _end(rows: Any, ended: Any, i: Any, outcome: Any, r: Any, n: Any) -> None:
    ended.rally[r], ended.opponent[r], ended.server[r] = rows.rally[i], rows.opponent[i], rows.server[i]
    ended.winner[r] = rows.striker[i] if outcome == 1 else 1 - rows.striker[i]
    ended.reason[r], ended.length[r] = outcome, rows.length[i]
    for j in range(rows.length[i]):
        ended.stroke[n + j] = rows.stroke[i, j]
        for e in range(rows.extra.shape[0]):
            ended.extra[e, n + j] = rows.extra[e, i, j]


@compiled
def _follow_row(
    tables: Tables,
    players: Players,
    rows: _Rows,
    ended: _Ended,
    stroke: npt.NDArray[np.int64],
    extra: npt.NDArray[np.float32],
    seat: int,
    seed_key: np.uint64,
    server: int,
    i: int,
    r: int,
    n: int,
) -> tuple[int, int, int]:
    """Play the strokes of row i; returns how that went, and the rallies and strokes that ended up to here."""
    longest = rows.stroke.shape[1]
    t = 0
    while True:
        # Whose stroke comes next: that of the learner, who has played them all, or of an opponent.
        learner = seat < 0 or rows.striker[i] == seat
        if learner and t == stroke.shape[0]:
            return _DONE, r, n
        at = rows.length[i]
        if at == longest:
            return _TOO_LONG, r, n
        bits = draw(rows.key[i], at)
        if learner:
            s, chosen = rows.state[i], stroke[t, i]
            if chosen < 0 or chosen >= tables.rank.shape[1]:
                return _ILLEGAL, r, n
            k = np.int64(tables.rank[tables.head[s, 3], chosen])
            if k < 0:
                return _ILLEGAL, r, n
            for e in range(extra.shape[0]):
                rows.extra[e, i, at] = extra[e, t, i]
            t += 1
        else:
            k = table_choice(players, rows.opponent[i], rows.state[i], tables.head[rows.state[i], 0], bits)
            for e in range(extra.shape[0]):
                rows.extra[e, i, at] = np.nan
        outcome = _strike(tables, rows, i, k, bits)
        if outcome < 2:
            if r == ended.rally.size or n + rows.length[i] > ended.stroke.size:
                return _NO_ROOM, r, n
            _end(rows, ended, i, outcome, r, n)
            r, n = r + 1, n + rows.length[i]
            _begin(rows, i, seed_key, server)


@compiled
def _follow(
    tables: Tables,
    players: Players,
    rows: _Rows,
    ended: _Ended,
    stroke: npt.NDArray[np.int64],
    extra: npt.NDArray[np.float32],
    seat: int,
    seed_key: np.uint64,
    server: int,
    at: tuple[int, int, int],
) -> tuple[int, int, int, int]:
    """Play the strokes of the rows from ``at[0]`` on; a row for which there is no room is left as it was.

    ``at`` and what is returned behind how it went: next row, rallies and strokes that ended.
    """
    i, r, n = at
    kept, kept_extra = np.empty_like(rows.stroke[0]), np.empty_like(rows.extra[:, 0])
    while i < rows.state.size:
        state, striker, first = rows.state[i], rows.striker[i], rows.server[i]
        rally, key, opponent, length = rows.rally[i], rows.key[i], rows.opponent[i], rows.length[i]
        kept[:length] = rows.stroke[i, :length]
        kept_extra[:, :length] = rows.extra[:, i, :length]
        how, r_after, n_after = _follow_row(tables, players, rows, ended, stroke, extra, seat, seed_key, server, i, r, n)
        if how != _DONE:
            rows.state[i], rows.striker[i], rows.server[i] = state, striker, first
            rows.rally[i], rows.key[i], rows.opponent[i], rows.length[i] = rally, key, opponent, length
            rows.stroke[i, :length] = kept[:length]
            rows.extra[:, i, :length] = kept_extra[:, :length]
            return how, i, r, n
        i, r, n = i + 1, r_after, n_after
    return _DONE, i, r, n


@compiled
def _begin_all(rows: _Rows, seed_key: np.uint64, server: int) -> None:
    for i in range(rows.state.size):
        _begin(rows, i, seed_key, server)


class RallyTrace:
    """Plays along with B rows of a batched environment and hands over the rallies that end.

    Rallies that end on an opponent's serve, of which a learner sees nothing, are among them. Of the log they need the header
    says ``draws="rally_v0"``, ``rules=SINGLE_RALLY``, ``matches_per_draw=1``; the number of the match is that of the rally.

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
        self._game, self._tables = game, tables_of(game)
        none = Players(np.empty((0, 0), np.uint16), np.empty((0, 0, 16), np.uint8))
        self._players = pack(opponents, game) if opponents else none
        self._seat = seat if opponents else -1
        self._server = _BY_LOT if server is None else server
        self._columns = tuple(name for name in OF_STROKES if name in columns)
        self._update = "update" in columns
        following = np.arange(batch, dtype=np.int32) % max(1, len(opponents))
        self._rows = _Rows(
            state=np.zeros(batch, np.int32),
            striker=np.zeros(batch, np.int8),
            server=np.zeros(batch, np.int8),
            rally=np.zeros(batch, np.int64),
            key=np.zeros(batch, np.uint64),
            opponent=following.copy(),
            following=following,
            length=np.zeros(batch, np.int32),
            stroke=np.zeros((batch, _LONGEST), np.uint8 if game.n_strokes <= 256 else np.uint16),
            extra=np.zeros((len(self._columns), batch, _LONGEST), np.float32),
        )
        self.reset(seed)

    def reset(self, seed: int) -> None:
        """Begin anew with rally 0 of a seed, as the environment does; rallies that go on are dropped."""
        self._seed_key = draws.stream(seed)[0]
        batch = len(self._rows.rally)
        self._rows.rally[:] = np.arange(batch) - batch
        _begin_all(self._rows, self._seed_key, self._server)

    def assign(self, opponent: npt.NDArray[np.integer]) -> None:
        """Say which opponent ``[B]`` each row meets in the rallies that begin from now on, as ``VersusBatch.assign`` does."""
        self._rows.following[:] = opponent

    def add(self, stroke: npt.NDArray[np.integer], *, update: int = 0, **recorded: npt.NDArray[np.floating]) -> Rallies:
        """Play T strokes of the learner in every row, and take away the rallies that ended.

        Args:
            stroke: ``[T, B]`` catalogue index of the learner's strokes (in self-play, of both players).
            update: how many updates the learner has made.
            **recorded: ``[T, B]`` each, ``log_probability`` and ``value``.

        Returns:
            The rallies that ended, row after row. Policy 0 is the learner (in self-play at both seats), policy 1 + k is
            opponent k; pairing 0.

        Raises:
            RecordingError: a shape that does not fit, a column that was not asked for, or a stroke that is not legal: then
                the environment plays something else than this follows.
        """
        strokes = np.ascontiguousarray(stroke, dtype=np.int64)
        batch = len(self._rows.state)
        if strokes.ndim != 2 or strokes.shape[1] != batch or set(recorded) != set(self._columns):
            raise RecordingError(
                f"strokes of shape {strokes.shape} with {tuple(recorded)}: expected (T, {batch}) with {self._columns}"
            )
        extra = np.empty((len(self._columns), *strokes.shape), np.float32)
        for e, name in enumerate(self._columns):
            extra[e] = recorded[name]
        ended = self._room(int(self._rows.length.sum()) + 3 * strokes.size + batch, strokes.size + batch)
        at = (0, 0, 0)
        while True:
            how, *now = _follow(
                self._tables,
                self._players,
                self._rows,
                ended,
                strokes,
                extra,
                self._seat,
                self._seed_key,
                self._server,
                at,
            )
            at = (now[0], now[1], now[2])
            if how == _DONE:
                return self._rallies(ended, at[1], at[2], update)
            if how == _ILLEGAL:
                raise RecordingError(f"row {at[0]}: a stroke is not legal there; the environment plays other rallies than these")
            if how == _TOO_LONG:
                more = [(0, 0), (0, self._rows.stroke.shape[1])]
                self._rows = self._rows._replace(
                    stroke=np.pad(self._rows.stroke, more), extra=np.pad(self._rows.extra, [(0, 0), *more])
                )
            else:
                larger = self._room(2 * ended.stroke.size, 2 * ended.rally.size)
                old: npt.NDArray[np.generic]
                new: npt.NDArray[np.generic]
                for old, new in zip(ended, larger, strict=True):
                    new[..., : old.shape[-1]] = old
                ended = larger

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
        if self._seat >= 0:
            policy[:, 1 - self._seat] = 1 + ended.opponent[:rallies]
        none = np.zeros(rallies, np.uint32)
        return Rallies(
            pairing=none,
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
