"""Report of recorded rallies: players, score, and what every stroke was worth."""

import dataclasses
import zlib
from collections.abc import Callable
from typing import Final

import numpy as np

from shuttle_marl.errors import printable
from shuttle_marl.exact.profile import ProfileValue, evaluate
from shuttle_marl.game.draws import stream
from shuttle_marl.game.policy import Policy, PolicyError
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.scoring import count_rally, ends_changed, match_win_probability
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve_recorded
from shuttle_marl.rally.record import Rallies
from shuttle_marl.recording.header import LogHeader, Player
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.replay import require_game, states
from shuttle_marl.scene import SceneError
from shuttle_marl.staging import Motion, PlayedRally
from shuttle_marl.staging.rally import rally_of

Resolve = Callable[[str, Game], Policy]
"""Finds the policy of a name; raises PolicyError for one that it does not find or may not."""

SECOND: Final = 1_000_000_000
"""[ns]"""
TOP: Final = 5
"""Number of strokes of a policy that are listed."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Option:
    """One of the strokes that a policy could choose.

    Attributes:
        stroke: its name.
        probability: with which the policy chooses it.
        win_probability: exact probability that the striker wins the rally with it.
    """

    stroke: str
    probability: float
    win_probability: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class StrokeAnnotation:
    """Probabilities and values of one stroke at the moment it is struck.

    Attributes:
        p_succ: probability that it is good.
        p_ret: probability that the opponent returns it if it is.
        probability: with which the striker's policy chooses it; None: the policy is not known.
        top: the strokes that the policy prefers, the likeliest first; empty: not known.
        shots: probability of every shot type, in the order of ``SHOTS``; empty: not known.
        value: exact probability that the striker wins the rally, before they choose, both policies given; None: not known.
        chosen: the same once the stroke is chosen, before it is decided.
        rally_win: probability that seat 0 wins the rally, before the stroke.
        match_win: probability that seat 0 wins the match, before the stroke.
        efforts: attacking strokes of seats 0 and 1 in the rally before this one, as far as they count; None: they do not.
        duel: net shots in a row that end with the incoming stroke, 3 for three or more; None: they do not count.
    """

    p_succ: float
    p_ret: float
    probability: float | None = None
    top: tuple[Option, ...] = ()
    shots: tuple[float, ...] = ()
    value: float | None = None
    chosen: float | None = None
    rally_win: float | None = None
    match_win: float | None = None
    efforts: tuple[int, int] | None = None
    duel: int | None = None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RallyReport:
    """One rally.

    Attributes:
        number: of the rally in the log.
        match: number of its match.
        names: of the policies of seats 0 and 1, as they are shown: without control characters.
        played: the strokes.
        points: of seats 0 and 1 before the rally.
        games: of seats 0 and 1 before the rally.
        winner: seat that won it.
        reason: how it ended, in words.
        strokes: one annotation a stroke.
        match_win_after: probability that seat 0 wins the match, after the rally; None: not known.
        points_after: of seats 0 and 1 after the rally, before a new game begins.
        ends_changed: whether the players are at other ends than in the first rally of the match.
        key: names the draws of the staging.
    """

    number: int
    match: int
    names: tuple[str, str]
    played: PlayedRally
    points: tuple[int, int]
    games: tuple[int, int]
    winner: int
    reason: str
    strokes: tuple[StrokeAnnotation, ...]
    match_win_after: float | None
    points_after: tuple[int, int]
    ends_changed: bool
    key: int


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StagedRally:
    """One rally, staged, with its place in the scene.

    Attributes:
        report: score and annotations.
        motion: of shuttle and players.
        start: when it begins [ns].
    """

    report: RallyReport
    motion: Motion
    start: int

    def at(self, seconds: float) -> int:
        """An instant of the rally in the scene [ns]."""
        return self.start + round(seconds * SECOND)

    @property
    def end(self) -> int:
        """Time of its last frame [ns]."""
        return self.at(float(self.motion.time[-1]))


class Annotator:
    """Reports rallies of a log.

    Probabilities of a policy are given only if its table is the one that played, by the hash in the log.

    Args:
        log: whose rallies they are.
        game: the game that was played on.
        resolve: finds the policies that the log names. A log comes from anywhere, so by default no module that it names is
            imported and no file opened.

    Attributes:
        unknown: why a policy is not known, by its name as it is shown; then nothing is said of its choices, nor of any value in
            its rallies.

    Raises:
        RecordingError: the log was played on another game.
    """

    def __init__(self, log: RallyLog, game: Game, resolve: Resolve = resolve_recorded) -> None:
        require_game(log, game)
        self.unknown: dict[str, str] = {}
        self._log, self._game, self._resolve = log, game, resolve
        self._tables: dict[Player, TabulatedPolicy | None] = {}
        self._values: dict[tuple[Player, Player], ProfileValue] = {}

    def report(self, number: int) -> RallyReport:
        """One rally of the log by its number.

        Raises:
            RecordingError: there is no such rally, or the log is damaged.
            SceneError: a stroke of it is not legal in this game.
        """
        rally = self._log.rally(number)
        header = self._log.files[self._log.file_of(number)].header
        first, second = (self._log.policies[int(policy)] for policy in rally.policy[0])
        played = rally_of(self._log, rally)
        state, rank = states(self._game, rally)
        if (state < 0).any():
            wrong = int(np.flatnonzero(state < 0)[0])
            raise SceneError(
                f"rally {number}: stroke {wrong + 1}, {played.catalogue.names[played.stroke[wrong]]}, is not legal there"
            )
        games = (int(rally.score[0, 2]), int(rally.score[0, 3]))
        points = (int(rally.score[0, 0]), int(rally.score[0, 1]))
        winner = int(rally.winner[0])
        value = self.values((first, second))
        match_odds = None if value is None else self._match_odds(header, value, games, points)
        return RallyReport(
            number=number,
            match=int(rally.match[0]),
            names=(printable(first.name), printable(second.name)),
            played=played,
            points=points,
            games=games,
            winner=winner,
            reason=OUTCOMES[int(rally.reason[0])],
            strokes=tuple(
                self._annotation((first, second)[seat], seat, int(state[i]), int(rank[i]), value, match_odds)
                for i, seat in enumerate(played.striker.tolist())
            ),
            match_win_after=None if match_odds is None else match_odds[winner],
            points_after=(points[0] + (winner == 0), points[1] + (winner == 1)),
            ends_changed=ends_changed(points, games, header.rules),
            key=staging_key(header, rally),
        )

    def _annotation(
        self,
        striker: Player,
        seat: int,
        state: int,
        rank: int,
        value: ProfileValue | None,
        match_odds: tuple[float, float] | None,
    ) -> StrokeAnnotation:
        game = self._game
        pairs = game.pair_at(state, np.arange(int(game.legal_count(state))))
        p_succ, p_ret, _ = (float(p) for p in game.stroke_probabilities(pairs[rank]))
        efforts = int(game.effort(state)), int(game.opponent_effort(state))
        known = StrokeAnnotation(
            p_succ=p_succ,
            p_ret=p_ret,
            efforts=(efforts if seat == 0 else efforts[::-1]) if game.levels > 1 else None,
            duel=int(game.duel(state)) if game.counts_duels else None,
        )
        table = self.table(striker)
        if table is None:
            return known
        strokes, p = game.legal_strokes(state), table.probability_of(pairs)
        shots = np.bincount(game.catalogue.shot[strokes], weights=p, minlength=len(SHOTS))
        known = dataclasses.replace(known, probability=float(p[rank]), shots=tuple(shots.tolist()))
        if value is None or match_odds is None:
            return known
        wins = (1 + game.stroke_values(value.striking[1 - seat], pairs)) / 2
        own = float(1 + value.striking[seat][state]) / 2
        rally_win = own if seat == 0 else 1 - own
        return dataclasses.replace(
            known,
            top=tuple(
                Option(
                    stroke=game.catalogue.names[strokes[k]],
                    probability=round(float(p[k]), 4),
                    win_probability=round(float(wins[k]), 4),
                )
                for k in np.argsort(-p, kind="stable")[:TOP]
            ),
            value=own,
            chosen=float(wins[rank]),
            rally_win=rally_win,
            match_win=match_odds[1] + rally_win * (match_odds[0] - match_odds[1]),
        )

    def table(self, player: Player) -> TabulatedPolicy | None:
        """The policy as it played; None if it cannot be had, and :attr:`unknown` says why."""
        if player not in self._tables:
            try:
                table = tabulate(self._resolve(player.name, self._game), self._game, player.name)
                _check_same(player, table)
                self._tables[player] = table
            except PolicyError as error:
                self._tables[player], self.unknown[printable(player.name)] = None, printable(str(error))
        return self._tables[player]

    def values(self, players: tuple[Player, Player]) -> ProfileValue | None:
        """Exact values of seat 0 against seat 1; None if one of the policies cannot be had."""
        first, second = (self.table(player) for player in players)
        if first is None or second is None:
            return None
        if players not in self._values:
            self._values[players] = evaluate(first, second)
        return self._values[players]

    def _match_odds(
        self, header: LogHeader, value: ProfileValue, games: tuple[int, int], points: tuple[int, int]
    ) -> tuple[float, float]:
        """Probability that seat 0 wins the match if it wins this rally, and if it loses it."""
        odds = value.odds(0)
        out = []
        for winner in (0, 1):
            score, won = [*points], [*games]
            counted = count_rally(points[winner], points[1 - winner], games[winner], header.rules)
            score[winner], won[winner] = counted.points, counted.games
            if counted.match_won:
                out.append(float(winner == 0))
                continue
            if counted.game_won:
                score = [0, 0]
            probability = match_win_probability(
                odds.serving,
                odds.receiving,
                first_server=winner,
                games=(won[0], won[1]),
                points=(score[0], score[1]),
                rules=header.rules,
            )
            out.append(float(probability))
        return out[0], out[1]


def _check_same(player: Player, table: TabulatedPolicy) -> None:
    """Raise PolicyError for a policy that has the name of the one that played, and is another."""
    if not player.hash:
        raise PolicyError("the log holds no hash of its table; nothing says that this policy is the one that played")
    if table.hash != player.hash:
        raise PolicyError(
            f"the policy of this name is not the one that played: its table is {table.hash[:12]}, in the log {player.hash[:12]}"
        )


def staging_key(header: LogHeader, rally: Rallies) -> int:
    """Seed of the staging of a rally, by its content, wherever in a log it stands."""
    strokes = zlib.crc32(rally.stroke.astype("<u2").tobytes())
    return int(stream(header.seed, int(rally.match[0]), int(rally.rally[0]), strokes)[0] >> np.uint64(1))
