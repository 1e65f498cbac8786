"""Whole rallies from what a collector gathers of the batched environments.

A learner sees neither the stroke with which an opponent ends a rally, nor rallies that end on an opponent's serve, nor the
numbers of the rallies. All of that follows from the seed, because the environments draw by counter; this works it out,
compiled, at the ends of rallies alone. Needs numba, so it is imported where it is used.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from shuttle_marl.game import draws
from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.kernel.core import Players, pack, tables_of
from shuttle_marl.recording.follow import DONE, TOO_LONG, WRONG, Ended, Played, Rows, Setting, begin_all, follow
from shuttle_marl.recording.schema import OF_STROKES, Rallies, RecordingError

_BY_LOT: Final = -1
_LONGEST: Final = 64
"""First guess of the strokes of a rally; a longer one makes room."""


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
        self._setting = Setting(
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
        self._rows = Rows(
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
            how, r, n = begin_all(self._setting, self._rows, ended, self._seed_key)
            if how == DONE:
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
        played = Played(
            stroke=np.ascontiguousarray(stroke, dtype=np.int64),
            reward=np.ascontiguousarray(reward, dtype=np.float32),
            observation=np.ascontiguousarray(seen, dtype=np.int32),
            extra=extra,
        )
        ended = self._room(int(self._rows.length.sum()) + 3 * batch * steps + batch, batch * steps + batch)
        at = (0, 0, 0)
        while True:
            how, *now = follow(self._setting, self._rows, ended, played, self._seed_key, at)
            at = (now[0], now[1], now[2])
            if how == DONE:
                found = [*self._begun(update), self._rallies(ended, at[1], at[2], update)]
                return Rallies.join(found) if len(found) > 1 else found[0]
            if how == WRONG:
                raise RecordingError(f"row {at[0]}: its strokes do not follow from the seed; the environment plays other rallies")
            if how == TOO_LONG:
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

    def _room(self, strokes: int, rallies: int) -> Ended:
        return Ended(
            rally=np.empty(rallies, np.uint32),
            opponent=np.empty(rallies, np.int32),
            server=np.empty(rallies, np.uint8),
            winner=np.empty(rallies, np.uint8),
            reason=np.empty(rallies, np.uint8),
            length=np.empty(rallies, np.int32),
            stroke=np.empty(strokes, self._rows.stroke.dtype),
            extra=np.empty((len(self._columns), strokes), np.float32),
        )

    def _rallies(self, ended: Ended, rallies: int, strokes: int, update: int) -> Rallies:
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
