"""Analysis of one rally: what every stroke was worth to the two policies that played it, and to perfect play.

Probabilities of winning are exact (:mod:`shuttle_marl.exact`) and belong to one rally, unless a name says ``match``. NaN stands
for what is not known: the choices of a policy that is not available, and real strokes behind a game that belongs to no model.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I32, I64
from shuttle_marl.base.errors import printable
from shuttle_marl.exact import ProfileValue, Solution, evaluate
from shuttle_marl.game.layout import Layout
from shuttle_marl.game.policy import Policy, PolicyError, TabulatedPolicy, hash_of, tabulate
from shuttle_marl.game.rally import Rally
from shuttle_marl.game.rules import IllegalStrokeError
from shuttle_marl.game.scoring import BWF, Rules, Score, match_win_probability
from shuttle_marl.game.shipped import real_strokes
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve_recorded
from shuttle_marl.recording.header import Player
from shuttle_marl.recording.reader import RallyLog, require_game
from shuttle_marl.reports.value import Value

Resolve = Callable[[str, Game], Policy]
"""Returns the policy of a name; raises PolicyError for a name that is unknown or not allowed."""

_UNKNOWN: Final = float("nan")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Players:
    """The policies at seats 0 and 1.

    Attributes:
        tables: policy of each seat; None: not known.
        value: exact values of seat 0 against seat 1; None unless both policies are known.
    """

    tables: tuple[TabulatedPolicy | None, TabulatedPolicy | None]
    value: ProfileValue | None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Decision:
    """The K legal strokes of a state, seen by the striker.

    Attributes:
        stroke: ``[K]`` catalogue indices.
        pair: ``[K]`` legal pairs.
        p_succ: ``[K]`` probability that the stroke is good.
        p_ret: ``[K]`` probability that the opponent returns a good one.
        support: ``[K]`` number of real strokes behind these two (:func:`shuttle_marl.game.shipped.real_strokes`).
        probability: ``[K]`` probability with which the striker's policy chooses the stroke.
        value: probability that the striker wins, before the choice, under both policies.
        win: ``[K]`` probability that the striker wins with the stroke, under both policies from then on.
        optimal: ``[K]`` the same if both play perfectly from then on; NaN without the solved game.
    """

    state: int
    seat: int
    stroke: I32
    pair: I32
    p_succ: F64
    p_ret: F64
    support: F64
    probability: F64
    value: float
    win: F64
    optimal: F64

    @property
    def regret(self) -> F64:
        """``[K]`` probability of winning that a stroke loses to the best one, under perfect play from then on."""
        return np.asarray(self.optimal.max() - self.optimal)


def decision(game: Game, state: int, seat: int, players: Players, solution: Solution | None = None) -> Decision:
    """Values of all legal strokes of a state.

    Args:
        game: tables of the game, or the game of a pair.
        solution: the solved game, for :attr:`Decision.optimal`.

    Raises:
        GameError: the support of the game's model cannot be read.
    """
    game = game.seats[seat]
    stroke = game.legal_strokes(state)
    pair = game.pair_at(state, np.arange(len(stroke)))
    good, returned, _ = game.stroke_probabilities(pair)
    unknown = np.full(len(stroke), _UNKNOWN)
    table, real = players.tables[seat], real_strokes(game)
    played = None if players.value is None else Value(game, players.value.striking, seat, players.tables[1 - seat])
    perfect = None if solution is None else Value(game, solution.value, seat, solution.policy[1 - seat])
    return Decision(
        state=state,
        seat=seat,
        stroke=stroke,
        pair=pair,
        p_succ=good,
        p_ret=returned,
        support=unknown if real is None else real[game.base_pair_edge[pair % game.n_base_pairs]],
        probability=unknown if table is None else table.probability_of(pair),
        value=_UNKNOWN if played is None else float(played.before(state)),
        win=unknown if played is None else played.win(pair),
        optimal=unknown if perfect is None else perfect.win(pair),
    )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RallyAnalysis:
    """Values of a rally of n strokes.

    Attributes:
        decisions: n choices, in the order of play.
        rank: ``[n]`` position of each stroke among the legal ones.
        rally_win: ``[n + 1]`` probability that seat 0 wins the rally before each stroke and after the rally; NaN while it
            continues.
        match_win: ``[n + 1]`` probability that seat 0 wins the match at the same times.
    """

    decisions: tuple[Decision, ...]
    rank: I64
    rally_win: F64
    match_win: F64

    def of_strokes(self, name: str) -> F64:
        """``[n]`` entries of the strokes played in one array of :class:`Decision`, such as ``win`` or ``regret``."""
        return np.array([getattr(choice, name)[k] for choice, k in zip(self.decisions, self.rank, strict=True)], np.float64)


def analyse_rally(
    rally: Rally, game: Game, players: Players, *, rules: Rules = BWF, solution: Solution | None = None
) -> RallyAnalysis:
    """Values of every stroke of a rally.

    Args:
        rally: a rally, finished or still being played, with the score before it.
        game: tables of the game, or the game of a pair.
        solution: the solved game, for :attr:`Decision.optimal`.

    Raises:
        IllegalStrokeError: a stroke is not legal in this game.
        GameError: the support of the game's model cannot be read.
    """
    state, rank = legal_states(rally, game)
    decisions = tuple(
        decision(game, s, seat, players, solution) for s, seat in zip(state.tolist(), rally.striker.tolist(), strict=True)
    )
    before = [choice.value if choice.seat == 0 else 1 - choice.value for choice in decisions]
    rally_win = np.array([*before, _UNKNOWN if rally.winner is None else float(rally.winner == 0)])
    match_win = np.full(len(rally_win), _UNKNOWN)
    if players.value is not None:
        won, lost = match_win_after(players.value, rally.points, rally.games, rules)
        match_win[:-1] = lost + rally_win[:-1] * (won - lost)
        if rally.winner is not None:
            match_win[-1] = (won, lost)[rally.winner]
    return RallyAnalysis(decisions=decisions, rank=rank, rally_win=rally_win, match_win=match_win)


def legal_states(rally: Rally, game: Layout) -> tuple[I64, I64]:
    """State in which each stroke was struck, and position of the stroke among the legal ones, ``[n]`` each.

    Raises:
        IllegalStrokeError: a stroke is not legal in this game; ``row`` is its number, from 0.
    """
    state = rally.states(game).astype(np.int64)
    rank = np.where(state < 0, -1, game.rank(np.maximum(state, 0), rally.stroke)).astype(np.int64)
    if (rank < 0).any():
        wrong = int((rank < 0).argmax())
        stroke = int(rally.stroke[wrong])
        raise IllegalStrokeError(f"stroke {wrong + 1}, {game.catalogue.names[stroke]}, is not legal there", stroke, wrong)
    return state, rank


def match_win_after(
    value: ProfileValue, points: tuple[int, int], games: tuple[int, int], rules: Rules = BWF
) -> tuple[float, float]:
    """Probability that seat 0 wins the match if it wins the next rally, and if it loses it; ``value``: exact values of seat 0
    against seat 1; ``points``: points of both in the current game, before the rally; ``games``: games won by both, before the
    rally."""
    odds = value.odds(0)

    def after(winner: int) -> float:
        score = Score(points=points, games=games, rules=rules).after(winner)
        if score.over:
            return float(score.winner == 0)
        probability = match_win_probability(
            odds.serving, odds.receiving, first_server=winner, games=score.games, points=score.points, rules=rules
        )
        return float(probability)

    return after(0), after(1)


class LogPlayers:
    """The players of a rally log.

    A policy is used only if its table is the one that played, by the hash in the log.

    Args:
        game: the game that was played.
        resolve: finds the policies that the log names. Logs are untrusted: by default no module that a log names is imported and
            no file is opened.

    Attributes:
        unknown: reason why a policy is not known, by its printable name.

    Raises:
        RecordingError: the log was played on another game.
    """

    def __init__(self, log: RallyLog, game: Game, resolve: Resolve = resolve_recorded) -> None:
        require_game(log, game)
        self.unknown: dict[str, str] = {}
        self._log, self._game, self._resolve = log, game, resolve
        self._table = functools.cache(self._tabulated)
        self._players = functools.cache(self._evaluated)

    def of_rally(self, number: int) -> Players:
        """The players of a rally of the log. Raises RecordingError: the log has no such rally, or is damaged."""
        first, second = (self._log.policies[int(policy)] for policy in self._log.rally(number).policy[0])
        return self._players(first, second)

    def _evaluated(self, first: Player, second: Player) -> Players:
        tables = self._table(first, 0), self._table(second, 1)
        value = None if tables[0] is None or tables[1] is None else evaluate(tables[0], tables[1])
        return Players(tables=tables, value=value)

    def _tabulated(self, player: Player, seat: int) -> TabulatedPolicy | None:
        try:
            tables = [tabulate(self._resolve(player.name, game), game) for game in self._game.seats]
            played = hash_of(*tables)
            if not player.hash:
                raise PolicyError("the log holds no hash of its table, so it cannot be compared with the policy that played")
            if player.hash not in (played, tables[seat].hash):
                raise PolicyError(
                    f"the policy of this name is not the one that played: its table is {played[:12]}, "
                    f"in the log {player.hash[:12]}"
                )
        except PolicyError as error:
            self.unknown[printable(player.name)] = printable(str(error))
            return None
        return tables[seat]
