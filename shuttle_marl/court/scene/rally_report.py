"""Report of a recorded rally: players, score, and the analysis of its strokes."""

import dataclasses
import zlib
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import printable
from shuttle_marl.court.scene import SceneError
from shuttle_marl.court.staging import Motion
from shuttle_marl.game.court import Hands
from shuttle_marl.game.draws import stream
from shuttle_marl.game.pairs import looks_of, seat_names
from shuttle_marl.game.rally import Rallies, Rally, waited_at
from shuttle_marl.game.rules import OUTCOMES, IllegalStrokeError
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.tables import Game
from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.reports import LogPlayers, RallyAnalysis, analyse_rally

SECOND: Final = 1_000_000_000  # [ns]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RallyReport:
    """A rally of a log."""

    number: int
    names: tuple[str, str]  # printable, of seats 0 and 1
    game: Game
    played: Rally
    winner: int
    reason: str  # outcome of the last stroke, in words
    before: str  # interval or change of ends before the rally, in words; empty: neither
    analysis: RallyAnalysis  # values of the strokes; NaN where a policy is not known
    key: int  # random seed of the staging
    athletes: tuple[str, str]
    logged: F64  # [2, T] in a log of training, else NaN: probability of each stroke, and estimate of the state, -1 to 1

    @property
    def points_after(self) -> tuple[int, int]:
        """Points of seats 0 and 1 after the rally, before a new game begins."""
        return self.played.points[0] + (self.winner == 0), self.played.points[1] + (self.winner == 1)

    @property
    def in_match(self) -> bool:
        """Whether the rally belongs to a match, as far as its score tells."""
        return bool(self.played.match or any(self.played.games) or any(self.played.points))

    def wins(self, stroke: int) -> dict[str, float]:
        """Probabilities that seat 0 wins rally and match before a stroke; -1: after the rally."""
        return {"rally_win_0": float(self.analysis.rally_win[stroke]), "match_win_0": float(self.analysis.match_win[stroke])}

    def waited(self, stroke: int) -> int | None:
        """Position that the receiver of a stroke chose; None: they had no choice, or the log has none."""
        return waited_at(self.played, self.game, stroke, self.analysis.decisions[stroke].state)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StagedRally:
    """A staged rally at its time in the scene."""

    report: RallyReport
    motion: Motion
    start: int  # time of the first frame [ns]

    def at(self, seconds: float) -> int:
        """Time in the scene [ns] of a time in the rally [s]."""
        return self.start + round(seconds * SECOND)

    @property
    def end(self) -> int:
        """Time of the last frame [ns]."""
        return self.at(float(self.motion.time[-1]))


def report_rally(log: RallyLog, number: int, game: Game, players: LogPlayers, hands: Hands | None = None) -> RallyReport:
    """Report of one rally; ``hands``: None: those of the players.

    Raises:
        RecordingError: the log has no such rally, or is damaged.
        RallyError: the strokes do not form a rally.
        SceneError: a stroke is not legal in this game.
    """
    row = log.rally(number)
    header = log.files[log.file_of(number)].header
    first, second = (log.policies[int(policy)].name for policy in row.policy[0])
    looks = looks_of(game, (first, second))
    played = row.row(0, log.catalogue, header.rules, hands or looks.hands).checked()
    try:
        analysis = analyse_rally(played, game, players.of_rally(number), rules=header.rules)
    except IllegalStrokeError as error:
        raise SceneError(f"rally {number}: {error}") from error
    chosen = None if row.log_probability is None else np.exp(row.log_probability.astype(np.float64))
    return RallyReport(
        number=number,
        names=seat_names(game, (printable(first), printable(second))),
        game=game,
        played=played,
        winner=int(row.winner[0]),
        reason=OUTCOMES[played.ending],
        before=Score(points=played.points, games=played.games, server=played.server, rules=header.rules).break_before,
        analysis=analysis,
        key=staging_key(header, row),
        athletes=looks.athletes,
        logged=np.stack([np.full(len(played), np.nan) if part is None else part for part in (chosen, row.value)]),
    )


def staging_key(header: LogHeader, rally: Rallies) -> int:
    """Random seed of the staging of a rally: a function of its content, independent of its position in a log."""
    strokes = zlib.crc32(rally.stroke.astype("<u2").tobytes())
    return int(stream(header.seed, int(rally.match[0]), int(rally.rally[0]), strokes)[0] >> np.uint64(1))
