"""``record="x.mcap"`` of every environment: one rally log of all rallies that it plays, whatever their seeds and their ends."""

import os
import sys
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.base.errors import counted
from shuttle_marl.base.files import problem
from shuttle_marl.game.policy import Policy, called
from shuttle_marl.game.rally import Rallies, Stroke, columns_of, stroke_dtype
from shuttle_marl.game.rules import HURRIED_BELOW, REASONS
from shuttle_marl.game.scoring import Rules
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel.rally import RallyBatch
from shuttle_marl.kernel.taped import TapeReader
from shuttle_marl.recording.header import SINGLE_RALLY, LogHeader, Pair, Player, RecordingError
from shuttle_marl.recording.log_file import files_of
from shuttle_marl.recording.recorder import RallyRecorder

Record = Path | str | Callable[[Rallies], None] | None
"""Option of a batch: the file of a log, a function that is given the rallies as they end, or None."""

LEARNER: Final = "learner"
_COLUMNS: Final = ("seed", "episode", "ending")
_ROWS: Final = 1024


class PlayedRally(NamedTuple):
    """A rally that has ended, or was cut off."""

    seed: int
    episode: int
    rally: int  # number of the rally in its episode
    score: tuple[int, int, int, int] | None  # before the rally, as `ShuttleEnv.score_of` player 0
    server: int
    winner: int  # 2: nobody
    reason: int  # index into `REASONS`
    strokes: tuple[Stroke, ...]
    positions: tuple[int | None, ...]  # where the receiver of each stroke waited; None where a fork does not know it


class Recording:
    """The log of an environment.

    It is ``FILE.part`` until ``close``, or the end of the process (``shuttle-marl recording recover``).
    Each rally has the reason of its end (:data:`shuttle_marl.game.rules.REASONS`). Rallies that an illegal stroke lost, that were
    truncated, or that another reset or ``close`` abandoned after their first stroke, or that of the learner, are in the log too.

    Args:
        path: the log; no file may exist there.
        names: of policy 0, policy 1, and so on.
        rules: of matches; None: rallies alone.

    Raises:
        RecordingError: the path is none, the file exists, or its folder cannot be created.
    """

    def __init__(self, path: Path | str, game: Game, names: Sequence[str], rules: Rules | None = None) -> None:
        if not isinstance(path, (str, os.PathLike)):
            raise RecordingError(f"record {path!r}: expected the name of a file, or None")
        self.path, self._game, self._rows, self._matches = Path(path), game, list[PlayedRally](), 0
        self.reasons = np.zeros(len(REASONS), np.int64)  # number of rallies by the reason of their end
        if files_of(self.path):
            raise RecordingError(f"{path}: exists already; delete it or choose another name")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written ({problem(error)})") from error
        self._header = LogHeader(
            seed=0,
            game=game.hash,
            strokes=game.catalogue.names,
            policies=tuple(Player(name=name) for name in names),
            draws="rally_v0" if rules is None else "match_v0",
            rules=rules or SINGLE_RALLY,
            pair=Pair.of(game),
            columns=columns_of(game, *_COLUMNS),
        )
        self._log: RallyRecorder | None = None
        self._closed = False

    @property
    def rallies(self) -> int:
        """Number of rallies so far."""
        return int(self.reasons.sum())

    def finish_with(self, env: Any) -> None:
        """Finish the log when an environment is deleted, or the process ends, if nobody has closed it."""
        weakref.finalize(env, self.close)

    def add(self, rallies: Rallies) -> None:
        """Record rallies."""
        if self._log is None:
            self._log = RallyRecorder.create(self.path, self._header)
        self.reasons += np.bincount(rallies.reason, minlength=len(REASONS))
        self._log.add(rallies)

    def add_rally(self, rally: PlayedRally) -> None:
        """Record one rally."""
        self._rows.append(rally)
        if len(self._rows) == _ROWS:
            self._add_rows()

    def close(self) -> None:
        """Finish the log, and say on standard error how many rallies it holds."""
        if self._closed:
            return
        self._closed = True
        self._add_rows()
        if self._log is not None:
            self._log.close()
        ends = ", ".join(f"{count:,} {reason}" for count, reason in zip(self.reasons.tolist(), REASONS, strict=True) if count)
        told = f"{counted(self.rallies, 'rally', 'rallies')} ({ends})" if ends else "no rallies, no file"
        sys.stderr.write(f"{self.path}: {told}\n")

    def _add_rows(self) -> None:
        rows, self._rows = self._rows, []
        if not rows:
            return
        strokes = [stroke for row in rows for stroke in row.strokes]
        length = np.array([len(row.strokes) for row in rows], np.int32)
        outcome = np.array([stroke.outcome for stroke in strokes], np.uint8)
        begins = np.zeros(len(strokes) + 1, np.bool_)
        begins[np.cumsum(length) - length] = True
        hurried = np.r_[False, outcome[:-1] >= HURRIED_BELOW][: len(strokes)] & ~begins[:-1]
        match = self._matches - 1 + np.cumsum([row.rally == 0 for row in rows])
        self._matches = int(match[-1]) + 1
        positions = [position for row in rows for position in row.positions]
        self.add(
            Rallies.of(
                self._game,
                match=match.astype(np.uint32),
                rally=np.array([row.rally for row in rows], np.uint16),
                policy=np.tile(np.array([0, 1], np.uint16), (len(rows), 1)),
                server=np.array([row.server for row in rows], np.uint8),
                winner=np.array([row.winner for row in rows], np.uint8),
                reason=np.array([row.reason for row in rows], np.uint8),
                score=np.array([row.score or (0, 0, 0, 0) for row in rows], np.uint8),
                length=length,
                stroke=np.array([stroke.stroke for stroke in strokes], stroke_dtype(self._game.n_strokes)),
                hurried=hurried.astype(np.uint8),
                waited=np.array(positions, np.int8),
                seed=np.array([row.seed for row in rows], np.uint64),
                episode=np.array([row.episode for row in rows], np.uint32),
                ending=np.array([row.strokes[-1].outcome if row.strokes else 0 for row in rows], np.uint8),
            )
        )


def recorder_of(batch: RallyBatch, record: Record, names: Sequence[str], rules: Rules | None = None) -> TapeReader | None:
    """The reader of the rallies of a batch for the option ``record``; None if they are not recorded."""
    if record is None:
        return None
    if callable(record):
        return TapeReader(batch, record)
    log = Recording(record, batch.game, names, rules)
    reader = TapeReader(batch, log.add, log.close, thread=True)
    log.finish_with(reader)
    return reader


def names_of(opponents: str | Policy | Sequence[str | Policy]) -> tuple[str, ...]:
    """Names of the policies of a log of a learner: its own, and those of its opponents."""
    some = [opponents] if isinstance(opponents, str) or not isinstance(opponents, Sequence) else opponents
    return (LEARNER, *(each if isinstance(each, str) else called(each) for each in some))
