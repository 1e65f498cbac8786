"""Points, games and matches, and the exact probabilities of winning them.

BWF Laws of Badminton, Law 7: best of three games to 21; a game is won by two clear points, at the latest by the 30th
point; the winner of a rally serves next, so the winner of a game serves first in the next one.
"""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, Bools, Ints
from shuttle_marl.base.errors import ShuttleError


class ScoringError(ShuttleError):
    """Rules, scores or probabilities that no match can have."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rules:
    """When a game and a match are won.

    Attributes:
        points: points that win a game.
        clear: lead that is needed, unless the cap is reached.
        cap: points that win a game whatever the lead.
        games: games that win the match (2: best of three).
    """

    points: int = 21
    clear: int = 2
    cap: int = 30
    games: int = 2

    def __post_init__(self) -> None:
        if not all(isinstance(value, int | np.integer) for value in dataclasses.astuple(self)):
            raise ScoringError(f"{self}: expected whole numbers")
        if not (1 <= self.clear <= self.points <= self.cap <= 127 and 1 <= self.games <= 63):
            raise ScoringError(f"{self}: expected 1 <= clear <= points <= cap <= 127 and 1 <= games <= 63")

    @property
    def max_rallies(self) -> int:
        """Most rallies a match can have."""
        return (2 * self.games - 1) * (2 * self.cap - 1)

    @property
    def as_tuple(self) -> "RulesTuple":
        """The same values for compiled code."""
        return RulesTuple(self.points, self.clear, self.cap, self.games)


class RulesTuple(NamedTuple):
    """Values of :class:`Rules` for compiled code."""

    points: int
    clear: int
    cap: int
    games: int


BWF: Final = Rules()  # the rules of the sport since 2006


RulesName = Literal["21", "15", "11", "21x1", "21x5", "15x1", "15x5", "11x1", "11x3"]
_USUAL: Final[dict[RulesName, Rules]] = {"21": BWF, "15": Rules(points=15, cap=21), "11": Rules(points=11, cap=15, games=3)}
RULES: Final[dict[RulesName, Rules]] = {
    name: _USUAL.get(name) or dataclasses.replace(_USUAL[name[:2]], games=int(name[3]) // 2 + 1) for name in get_args(RulesName)
}
"""Rules by the points of a game: those of the sport, and its trials of best of three to 15 and best of five to 11; ``15x5``: best
of five to 15."""


class RallyCount(NamedTuple):
    """Result of counting one rally; numbers, or arrays of the shape of the arguments."""

    points: Any  # points of the rally's winner in this game, with this rally
    games: Any  # games of the rally's winner, with this one if it was won
    game_won: Any  # whether the rally won the game; then both players start the next one with no points
    match_won: Any  # whether the rally won the match


def count_rally(own: Any, other: Any, games: Any, rules: Any) -> RallyCount:
    """Count one rally. Everything that plays, checks or shows matches uses this function; the rule book has its own.

    It is plain arithmetic because the kernel compiles it unchanged.

    Args:
        own: points of the rally's winner in the current game before the rally; a number, or an array of signed integers.
        games: games won so far by the rally's winner.
        rules: :class:`Rules`; in compiled code :class:`RulesTuple`.
    """
    points = own + 1
    game_won = ((points >= rules.points) & (points - other >= rules.clear)) | (points >= rules.cap)
    games = games + game_won
    return RallyCount(points, games, game_won, games >= rules.games)


def wins_game(own: Any, other: Any, rules: Rules = BWF) -> Any:
    """Whether the first of two point scores has won the game; two numbers, or arrays of any shape."""
    return count_rally(own - 1, other, 0, rules).game_won


def is_over(games: Ints, rules: Rules = BWF) -> Bools:
    """``[...]`` whether matches with ``[..., 2]`` games are over."""
    return np.asarray(games.max(axis=-1) >= rules.games)


def open_scores(rules: Rules = BWF) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Games and points of both players at every score at which a match continues, each after all that can follow it."""
    for games in itertools.product(range(rules.games - 1, -1, -1), repeat=2):
        for own, other in itertools.product(range(rules.cap - 1, -1, -1), repeat=2):
            if not (wins_game(own, other, rules) or wins_game(other, own, rules)):
                yield (games[0], games[1]), (own, other)


def score_fractions(points: tuple[Any, Any], games: tuple[Any, Any], rules: Rules = BWF) -> tuple[Any, Any, Any, Any]:
    """Points and games of both players as fractions of their maxima, for observations; numbers, or arrays of one shape."""
    return points[0] / rules.cap, points[1] / rules.cap, games[0] / rules.games, games[1] / rules.games


def serves_from_right(points: Any) -> Any:
    """Whether a server with these points serves from the right service court: an even number (BWF Law 10.1).

    The receiver stands in the court diagonally opposite, their own right one. A number, or an array of any shape.
    """
    return points % 2 == 0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Score:
    """Score of one match before a rally. Seats are 0 and 1.

    Attributes:
        points: of both seats in the current game; (0, 0) when the match is over.
        games: won by both seats.
        finished: points of both seats in each finished game.
        server: seat that serves the next rally, the winner of the last one.
        rules: when a game and the match are won.
    """

    points: tuple[int, int] = (0, 0)
    games: tuple[int, int] = (0, 0)
    finished: tuple[tuple[int, int], ...] = ()
    server: int = 0
    rules: Rules = BWF

    @property
    def over(self) -> bool:
        """Whether the match is over."""
        return max(self.games) >= self.rules.games

    @property
    def winner(self) -> int | None:
        """Seat that won the match; None while it continues."""
        return self.server if self.over else None

    @property
    def by_game(self) -> tuple[tuple[int, int], ...]:
        """Points of both seats in each game that has begun."""
        return self.finished if self.over else (*self.finished, self.points)

    @property
    def ends_changed(self) -> bool:
        """Whether the players are at other ends of the court than in the first rally of the match.

        They change after every game, and in the deciding one when the first of them has half of its points (BWF Law 8).
        """
        return bool((sum(self.games) + (self._deciding and max(self.points) >= self._half)) % 2)

    @property
    def changes_ends(self) -> bool:
        """Whether the players change ends before the rally."""
        begins = self.points == (0, 0) and any(self.games) and not self.over
        return begins or (self._deciding and self.interval)

    @property
    def interval(self) -> bool:
        """Whether an interval precedes the rally, because the leader has just reached half of the points (BWF Law 16.2)."""
        return self.rules.games > 1 and self.points[self.server] == self._half > self.points[1 - self.server]

    @property
    def break_before(self) -> str:
        """What precedes the rally, in words: an interval, a change of ends, both, or nothing."""
        return " and ".join(["interval"] * self.interval + ["change of ends"] * self.changes_ends)

    @property
    def _deciding(self) -> bool:
        return self.rules.games > 1 and self.games[0] == self.games[1] == self.rules.games - 1

    @property
    def _half(self) -> int:
        return (self.rules.points + 1) // 2

    def seen_by(self, seat: int) -> tuple[int, int, int, int]:
        """Points of a seat, of the other seat, games of the seat and of the other seat."""
        return self.points[seat], self.points[1 - seat], self.games[seat], self.games[1 - seat]

    def after(self, winner: int) -> "Score":
        """Score after a rally that a seat won; a match that is over stays as it is."""
        if self.over:
            return self
        points, games = [*self.points], [*self.games]
        counted = count_rally(points[winner], points[1 - winner], games[winner], self.rules)
        points[winner], games[winner] = counted.points, counted.games
        now = (points[0], points[1])
        return Score(
            points=(0, 0) if counted.game_won else now,
            games=(games[0], games[1]),
            finished=(*self.finished, now) if counted.game_won else self.finished,
            server=winner,
            rules=self.rules,
        )


def match_win_probability(
    p_serving: npt.ArrayLike,
    p_receiving: npt.ArrayLike,
    *,
    first_server: int | None = None,
    games: tuple[int, int] = (0, 0),
    points: tuple[int, int] = (0, 0),
    rules: Rules = BWF,
) -> F64:
    """Exact probability that player 0 wins the match, if rallies are independent given who serves.

    Args:
        p_serving: probability that player 0 wins a rally in which player 0 serves; any shape.
        p_receiving: probability that player 0 wins a rally in which player 1 serves; broadcasts against ``p_serving``.
        first_server: who serves the next rally; None: drawn at random, the mean of both.
        games: games won so far by players 0 and 1.
        points: points of both in the current game.

    Raises:
        ScoringError: a probability outside [0, 1], or a score that the rules do not allow.
    """
    serving, receiving = np.broadcast_arrays(np.asarray(p_serving, np.float64), np.asarray(p_receiving, np.float64))
    for p in (serving, receiving):
        if (bad := ~((p >= 0) & (p <= 1))).any():
            raise ScoringError(f"probability of winning a rally {p[bad].flat[0]:g}: expected a number from 0 to 1")
    if first_server not in (None, 0, 1):
        raise ScoringError(f"server {first_server!r}: expected 0, 1, or None to draw it at random")
    if not all(0 <= g < rules.games for g in games):
        raise ScoringError(f"games {games}: expected each from 0 to {rules.games - 1} while the match continues")
    whole_game = _game(serving, receiving, (0, 0), rules)
    one, zero = np.ones_like(serving), np.zeros_like(serving)
    odds: dict[tuple[int, int], tuple[F64, F64]] = {}
    for own in range(rules.games, games[0] - 1, -1):
        for other in range(rules.games, games[1] - 1, -1):
            if rules.games in (own, other):
                odds[own, other] = (one, one) if own == rules.games else (zero, zero)
                continue
            # The winner of a game has won its last rally and serves first in the next game.
            won, lost = odds[own + 1, other][0], odds[own, other + 1][1]
            game = _game(serving, receiving, points, rules) if (own, other) == games and any(points) else whole_game
            odds[own, other] = (lost + game[0] * (won - lost), lost + game[1] * (won - lost))
    now = odds[games]
    return np.asarray((now[0] + now[1]) / 2 if first_server is None else now[first_server])


def _game(serving: F64, receiving: F64, points: tuple[int, int], rules: Rules) -> tuple[F64, F64]:
    """Probability that player 0 wins a game from a score, when player 0 serves next and when player 1 does."""
    own, other = points
    if own < 0 or other < 0 or wins_game(own, other, rules) or wins_game(other, own, rules):
        raise ScoringError(f"points {points}: expected a game that continues, to {rules.points} points, cap {rules.cap}")
    one, zero = np.ones_like(serving), np.zeros_like(serving)
    # Rows of the score table from the cap downwards; below[j] is the row of one more own point.
    below: dict[int, tuple[F64, F64]] = {}
    for i in range(rules.cap, own - 1, -1):
        row: dict[int, tuple[F64, F64]] = {}
        for j in range(rules.cap, other - 1, -1):
            if wins_game(i, j, rules):
                row[j] = (one, one)
            elif wins_game(j, i, rules):
                row[j] = (zero, zero)
            else:
                win, lose = below[j][0], row[j + 1][1]
                row[j] = (lose + serving * (win - lose), lose + receiving * (win - lose))
        below = row
    return below[other]
