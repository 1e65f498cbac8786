"""Rally logs of anybody's loop over an environment of this package."""

import dataclasses
import weakref
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from shuttle_marl.base.errors import OptionError
from shuttle_marl.env.aec import AGENTS, PlayedRally, ShuttleEnv
from shuttle_marl.game.rally.record import Rallies, columns_of, stroke_dtype
from shuttle_marl.game.rules import FAULT, HURRIED_BELOW
from shuttle_marl.recording.header import SINGLE_RALLY, LogHeader, Pair, Player, RecordingError
from shuttle_marl.recording.log_file import existing_parts
from shuttle_marl.recording.recorder import RallyLogWriter

Env = TypeVar("Env")
_BATCH: Final = 1024
"""Rallies of a batch."""


def RecordRallies(env: Env, path: Path | str, *, names: tuple[str, str] = AGENTS) -> Env:
    """Record every rally that an environment plays from here on, and return the environment.

        env = RecordRallies(rally_v0.env(), "rallies.mcap")
        env.reset(seed=0)
        ...
        env.close()

    ``close`` finishes the log, as the end of the process does; until then it is ``FILE.part``, from which
    ``python -m shuttle_marl.recording recover`` makes a log. Another seed begins another log, ``rallies-2.mcap`` and so on,
    because the draws of a log follow from one seed: to write one file, seed the first reset only. Rallies that were cut off, or
    lost by an illegal stroke, are not in the log. Copies and forks of the environment do not record.

    Args:
        env: ``rally_v0`` or ``match_v0``, or a Gymnasium environment of one rally or match, with or without wrappers.
        path: the log; no file may exist there.
        names: of the players at seats 0 and 1.

    Raises:
        OptionError: another kind of environment, such as one of many rallies a step, or one that records already.
        RecordingError: the file exists or cannot be created.
    """
    raw: Any = getattr(env, "unwrapped", env)
    raw = getattr(raw, "raw", raw)
    if not isinstance(raw, ShuttleEnv):
        raise OptionError(
            f"RecordRallies of {type(env).__name__}: expected rally_v0, match_v0, or a Gymnasium environment of one rally "
            "or match; leagues and training record by themselves (--record)"
        )
    if raw.recorder is not None:
        raise OptionError("RecordRallies: this environment records already")
    where = Path(path)
    if existing_parts(where):
        raise RecordingError(f"{where}: exists already; delete it or choose another name")
    try:
        where.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(f"{where}: cannot be written ({error.strerror})") from error
    raw.recorder = RallyWriter(where, raw, names)
    # The log is finished even if the environment is never closed.
    weakref.finalize(raw, raw.recorder.close)
    return env


class RallyWriter:
    """Writes the rallies of an environment, which hands it each one that has ended."""

    def __init__(self, path: Path, env: ShuttleEnv, names: tuple[str, str]) -> None:
        game, rules = env.game, getattr(env, "rules", None)
        self._path, self._logs, self._rows = path, 0, list[PlayedRally]()
        self._header = LogHeader(
            seed=0,
            game=game.hash,
            strokes=game.catalogue.names,
            policies=tuple(Player(name=name) for name in names),
            draws="rally_v0" if rules is None else "match_v0",
            rules=rules or SINGLE_RALLY,
            pair=Pair.of(game),
            columns=columns_of(game),
        )
        self._log: RallyLogWriter | None = None

    def add(self, rally: PlayedRally) -> None:
        """Record a rally.

        Raises:
            RecordingError: the log cannot be written.
        """
        if self._log is None or rally.seed != self._header.seed:
            self.close()
            self._logs += 1
            name = self._path.stem + ("" if self._logs == 1 else f"-{self._logs}")
            self._header = dataclasses.replace(self._header, seed=rally.seed)
            self._log = RallyLogWriter(self._path.with_stem(name), self._header)
        self._rows.append(rally)
        if len(self._rows) == _BATCH:
            self._write(self._log)

    def close(self) -> None:
        """Finish the log.

        Raises:
            RecordingError: the disk is full or fails.
        """
        if self._log is not None:
            self._write(self._log)
            self._log.close()
            self._log = None

    def _write(self, log: RallyLogWriter) -> None:
        rows, self._rows = self._rows, []
        if not rows:
            return
        strokes = [stroke for row in rows for stroke in row.strokes]
        length = np.array([len(row.strokes) for row in rows], np.int32)
        outcome, last = np.array([stroke.outcome for stroke in strokes]), np.cumsum(length) - 1
        hurried = np.r_[False, outcome[:-1] >= HURRIED_BELOW]  # the last stroke of a rally hurries no receiver
        striker, reason = np.array([stroke.player for stroke in strokes]), outcome[last]
        positions = [position for row in rows for position in row.positions]
        log.append(
            Rallies(
                pairing=np.zeros(len(rows), np.uint32),
                match=np.array([row.episode for row in rows], np.uint32),
                rally=np.array([row.rally for row in rows], np.uint16),
                policy=np.tile(np.array([0, 1], np.uint16), (len(rows), 1)),
                server=striker[last - length + 1].astype(np.uint8),
                winner=np.where(reason == FAULT, 1 - striker[last], striker[last]).astype(np.uint8),
                reason=reason.astype(np.uint8),
                score=np.array([row.score or (0, 0, 0, 0) for row in rows], np.uint8),
                length=length,
                stroke=np.array([stroke.stroke for stroke in strokes], stroke_dtype(len(self._header.strokes))),
                hurried=hurried.astype(np.uint8),
                waited=np.array(positions, np.int8) if "waited" in self._header.columns else None,
            )
        )
        log.flush(sync=False)
