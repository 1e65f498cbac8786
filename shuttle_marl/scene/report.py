"""What a scene tells about recorded rallies: who plays, the score, and what every stroke was worth."""

import dataclasses
import zlib
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.exact.profile import ProfileValue, evaluate
from shuttle_marl.game.draws import stream
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.rally import ONE, OUTCOMES, Game
from shuttle_marl.game.scoring import count_rally, ends_changed, match_win_probability
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.table import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording.derived import require_game, states
from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.schema import Rallies
from shuttle_marl.scene.errors import SceneError
from shuttle_marl.staging import PlayedRally
from shuttle_marl.staging.recorded import rally_of

Floats = npt.NDArray[np.float64]

TOP: Final = 5
"""How many strokes of a policy are told."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Option:
    """One of the strokes that a policy could choose.

    Attributes:
        stroke: its name.
        probability: with which the policy chooses it.
        win_probability: exact chance of the striker to win the rally with it.
    """

    stroke: str
    probability: float
    win_probability: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class Telling:
    """What is known about one stroke when it is struck.

    Attributes:
        p_succ: chance that it is good.
        p_ret: chance that the opponent returns it if it is.
        probability: with which the striker's policy chooses it; None: the policy is not known.
        top: the strokes that the policy likes best, the likeliest first; empty: it is not known.
        shots: chance of every shot type, in the order of ``SHOTS``; empty: not known.
        value: exact chance of the striker to win the rally before they choose, both policies given; None: not known.
        chosen: the same once the stroke is chosen, before it is decided.
        rally_win: chance of seat 0 to win the rally before the stroke.
        match_win: chance of seat 0 to win the match before the stroke.
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


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Story:
    """One rally.

    Attributes:
        number: of the rally in the log.
        match: number of its match.
        names: of the policies of seats 0 and 1.
        played: the strokes.
        points: of seats 0 and 1 before the rally.
        games: of seats 0 and 1 before the rally.
        winner: seat that won it.
        reason: how it ended, in words.
        tellings: one a stroke.
        match_win_after: chance of seat 0 to win the match after the rally; None: not known.
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
    tellings: tuple[Telling, ...]
    match_win_after: float | None
    points_after: tuple[int, int]
    ends_changed: bool
    key: int


class Teller:
    """Tells rallies of a log.

    Args:
        log: whose rallies they are.
        game: the game that was played on.

    Attributes:
        unknown: why a policy is not known, by its name; nothing is told of its choices, nor of any value in its rallies.

    Raises:
        RecordingError: the log was played on another game.
    """

    def __init__(self, log: RallyLog, game: Game) -> None:
        require_game(log, game)
        self.unknown: dict[str, str] = {}
        self._log, self._game = log, game
        self._chances = game.chances()
        self._tables: dict[str, TabulatedPolicy | None] = {}
        self._values: dict[tuple[str, str], ProfileValue] = {}

    def tell(self, number: int) -> Story:
        """One rally of the log by its number.

        Raises:
            RecordingError: there is no such rally, or the log is damaged.
            SceneError: a stroke of it is not legal in this game.
        """
        rally = self._log.rally(number)
        header = self._log.files[self._log.file_of(number)].header
        names = (self._log.policies[int(rally.policy[0, 0])].name, self._log.policies[int(rally.policy[0, 1])].name)
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
        after = (points[0] + (winner == 0), points[1] + (winner == 1))
        value = self._value(names)
        match_odds = None if value is None else self._match_odds(header, value, games, points)
        return Story(
            number=number,
            match=int(rally.match[0]),
            names=names,
            played=played,
            points=points,
            games=games,
            winner=winner,
            reason=OUTCOMES[int(rally.reason[0])],
            tellings=tuple(
                self._telling(played, names, i, int(state[i]), int(rank[i]), value, match_odds) for i in range(len(played))
            ),
            match_win_after=None if match_odds is None else match_odds[winner],
            points_after=after,
            ends_changed=ends_changed(points, games, header.rules),
            key=_key(header, rally),
        )

    def _telling(
        self,
        played: PlayedRally,
        names: tuple[str, str],
        i: int,
        state: int,
        rank: int,
        value: ProfileValue | None,
        match_odds: tuple[float, float] | None,
    ) -> Telling:
        game, seat = self._game, int(played.striker[i])
        pairs = slice(int(game.pair_start[state]), int(game.pair_start[state + 1]))
        told = Telling(
            p_succ=float(self._chances[0][pairs.start + rank]),
            p_ret=float(self._chances[1][pairs.start + rank]),
        )
        table = self._table(names[seat])
        if table is None:
            return told
        strokes = game.pair_stroke[pairs]
        p = _chances_of(table, pairs)
        shots = np.bincount(game.catalogue.shot[strokes], weights=p, minlength=len(SHOTS))
        told = dataclasses.replace(told, probability=float(p[rank]), shots=tuple(shots.tolist()))
        if value is None or match_odds is None:
            return told
        wins = (1 + self._stroke_values(value, seat, pairs)) / 2
        best = np.argsort(-p, kind="stable")[:TOP]
        own = float(1 + value.striking[seat][state]) / 2
        rally_win = own if seat == 0 else 1 - own
        return dataclasses.replace(
            told,
            top=tuple(
                Option(
                    stroke=game.catalogue.names[strokes[k]],
                    probability=round(float(p[k]), 4),
                    win_probability=round(float(wins[k]), 4),
                )
                for k in best
            ),
            value=own,
            chosen=float(wins[rank]),
            rally_win=rally_win,
            match_win=match_odds[1] + rally_win * (match_odds[0] - match_odds[1]),
        )

    def _stroke_values(self, value: ProfileValue, seat: int, pairs: slice) -> Floats:
        """``[K]`` what the strokes of a state are worth to the striker, -1 to 1."""
        game = self._game
        steps = np.diff(game.threshold[pairs].astype(np.int64), axis=1, prepend=0, append=ONE) / ONE
        following = 2 * game.pair_edge[pairs].astype(np.int64)
        theirs = value.striking[1 - seat]
        fault, winner, below, above = steps.T
        out: Floats = winner - fault - below * theirs[following] - above * theirs[following + 1]
        return out

    def _table(self, name: str) -> TabulatedPolicy | None:
        """A policy as it is played, None if it cannot be had."""
        if name not in self._tables:
            try:
                self._tables[name] = tabulate(resolve(name, self._game), self._game, name)
            except PolicyError as error:
                self._tables[name], self.unknown[name] = None, str(error)
        return self._tables[name]

    def _value(self, names: tuple[str, str]) -> ProfileValue | None:
        first, second = (self._table(name) for name in names)
        if first is None or second is None:
            return None
        if names not in self._values:
            self._values[names] = evaluate(first, second)
        return self._values[names]

    def _match_odds(
        self, header: LogHeader, value: ProfileValue, games: tuple[int, int], points: tuple[int, int]
    ) -> tuple[float, float]:
        """Chance of seat 0 to win the match if it wins this rally, and if it loses it."""
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
            chance = match_win_probability(
                odds.serving,
                odds.receiving,
                first_server=winner,
                games=(won[0], won[1]),
                points=(score[0], score[1]),
                rules=header.rules,
            )
            out.append(float(chance))
        return out[0], out[1]


def _chances_of(table: TabulatedPolicy, pairs: slice) -> Floats:
    """``[K]`` chances of the legal strokes of one state."""
    upper = table.cumulative[pairs].astype(np.int64)
    return np.diff(upper, prepend=0) / upper[-1]


def _key(header: LogHeader, rally: Rallies) -> int:
    """Names the rally by what it is, wherever in a log it stands."""
    strokes = zlib.crc32(rally.stroke.astype("<u2").tobytes())
    return int(stream(header.seed, int(rally.match[0]), int(rally.rally[0]), strokes)[0] >> np.uint64(1))
