"""The log of the rallies that a person played: one file for each match against the same opponent."""

import threading
import time
from collections import OrderedDict
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.court.match import FRIEND, PERSON, CourtRally
from shuttle_marl.court.plan import Plan
from shuttle_marl.court.policies import PolicyTables
from shuttle_marl.game.rally.record import Rallies, columns_of, stroke_dtype
from shuttle_marl.policy import baselines
from shuttle_marl.recording.header import LogHeader, Pair, Player
from shuttle_marl.recording.recorder import RallyRecorder

_MOST_OPEN: Final = 8
"""Maximum number of open logs: pages in several tabs play matches in turn."""


class MatchLog:
    """Records finished rallies; :meth:`close` finishes the open logs.

    Args:
        folder: folder of the logs, created with the first rally.
    """

    def __init__(self, folder: Path, policies: PolicyTables) -> None:
        self._folder, self._policies = folder, policies
        self._open: OrderedDict[object, RallyRecorder] = OrderedDict()
        self._recorded: set[tuple[object, int]] = set()
        self._lock = threading.Lock()
        self._started, self._count = time.strftime("%Y%m%d-%H%M%S"), 0

    def add(self, plan: Plan, rally: CourtRally) -> None:
        """Record a rally if it is finished and not recorded yet.

        Raises:
            RecordingError: the log cannot be written.
        """
        winner = rally.winner
        if winner is None:
            return
        match = (plan.seed, plan.points, rally.names, plan.sides_in(rally.number))
        with self._lock:
            if (match, rally.number) in self._recorded:
                return
            recorder = self._recorder(match, plan, rally)
            recorder.add(self._row(rally, winner))
            recorder.flush(sync=False)
            self._recorded.add((match, rally.number))

    def close(self) -> None:
        """Finish the open logs."""
        with self._lock:
            while self._open:
                self._open.popitem()[1].close()

    def _recorder(self, match: object, plan: Plan, rally: CourtRally) -> RallyRecorder:
        if match in self._open:
            self._open.move_to_end(match)
            return self._open[match]
        if len(self._open) == _MOST_OPEN:
            self._open.popitem(last=False)[1].close()
        sides = plan.sides_in(rally.number)
        policies = self._policies.between(sides)
        players = tuple(
            Player(name=name)
            if name in (PERSON, FRIEND) or side.policy == baselines.REMEMBERING
            else Player(name=name, hash=policies.table(side, seat).hash)
            for seat, (name, side) in enumerate(zip(rally.names, sides, strict=True))
        )
        header = LogHeader(
            seed=plan.seed,
            game=policies.game.hash,
            strokes=rally.catalogue.names,
            policies=players,
            draws="match_v0",
            rules=plan.rules,
            pair=Pair.of(policies.game),
            columns=columns_of(policies.game),
        )
        self._count += 1
        self._folder.mkdir(parents=True, exist_ok=True)
        recorder = RallyRecorder.create(self._folder / f"played-{self._started}-{self._count}.mcap", header)
        self._open[match] = recorder
        return recorder

    @staticmethod
    def _row(rally: CourtRally, winner: int) -> Rallies:
        return Rallies(
            pairing=np.zeros(1, np.uint32),
            match=np.zeros(1, np.uint32),
            rally=np.array([rally.number], np.uint16),
            policy=np.array([[0, 1]], np.uint16),
            server=np.array([rally.server], np.uint8),
            winner=np.array([winner], np.uint8),
            reason=np.array([rally.ending], np.uint8),
            score=np.array([[*rally.points, *rally.games]], np.uint8),
            length=np.array([len(rally)], np.int32),
            stroke=rally.stroke.astype(stroke_dtype(len(rally.catalogue))),
            hurried=rally.hurried.astype(np.uint8),
            waited=None if rally.waited is None else rally.waited.astype(np.int8),
        )
