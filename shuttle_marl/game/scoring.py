"""Points, games and matches, for a batch at a time, and the exact odds of winning them.

BWF Laws of Badminton, Law 7: best of three games to 21; a game is won by two clear points, at the latest by the 30th
point; the winner of a rally serves next, so the winner of a game serves first in the next one.
"""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any, Final, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from shuttle_marl.arrays import F64, I8, I16, I64, Bools, Ints
from shuttle_marl.errors import ShuttleError


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
        if not (1 <= self.clear <= self.points <= self.cap <= 127 and 1 <= self.games <= 63):
            raise ScoringError(f"{self}: expected 1 <= clear <= points <= cap <= 127 and 1 <= games <= 63")

    @property
    def max_games(self) -> int:
        """Most games a match can have."""
        return 2 * self.games - 1

    @property
    def max_rallies(self) -> int:
        """Most rallies a match can have."""
        return self.max_games * (2 * self.cap - 1)

    @property
    def numbers(self) -> "Numbers":
        """The same for compiled code."""
        return Numbers(self.points, self.clear, self.cap, self.games)


class Numbers(NamedTuple):
    """The numbers of :class:`Rules`, as compiled code takes them."""

    points: int
    clear: int
    cap: int
    games: int


BWF: Final = Rules()
"""The rules of the sport since 2006."""


class Counted(NamedTuple):
    """Result of counting one rally; numbers, or arrays of the shape that was given.

    Attributes:
        points: points of the rally's winner in this game, with this rally.
        games: games of the rally's winner, with this one if it was won.
        game_won: whether the rally won the game; then both players start the next one with no points.
        match_won: whether the rally won the match.
    """

    points: Any
    games: Any
    game_won: Any
    match_won: Any


def count_rally(own: Any, other: Any, games: Any, rules: Any) -> Counted:
    """Count one rally: the rule of all matches, wherever they are played, checked or shown.

    The kernel compiles this function as it stands, so it is arithmetic alone.

    Args:
        own: points of the rally's winner in the current game before the rally; a number, or an array of signed integers.
        other: points of the rally's loser.
        games: games won so far by the rally's winner.
        rules: :class:`Rules`; in compiled code :class:`Numbers`.
    """
    points = own + 1
    game_won = ((points >= rules.points) & (points - other >= rules.clear)) | (points >= rules.cap)
    games = games + game_won
    return Counted(points, games, game_won, games >= rules.games)


@overload
def wins_game(own: int, other: int, rules: Rules = BWF) -> bool: ...
@overload
def wins_game(own: I8, other: I8, rules: Rules = BWF) -> Bools: ...
def wins_game(own: int | I8, other: int | I8, rules: Rules = BWF) -> bool | Bools:
    """Whether the first of two point scores has won the game; two numbers, or arrays of any shape."""
    won: bool | Bools = count_rally(own - 1, other, 0, rules).game_won
    return won


def is_over(games: Ints, rules: Rules = BWF) -> Bools:
    """``[...]`` whether matches with ``[..., 2]`` games are over."""
    return np.asarray(games.max(axis=-1) >= rules.games)


def open_scores(rules: Rules = BWF) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Games and points of both players at every score at which a match continues, each after all that can follow it."""
    for games in itertools.product(range(rules.games - 1, -1, -1), repeat=2):
        for own, other in itertools.product(range(rules.cap - 1, -1, -1), repeat=2):
            if not (wins_game(own, other, rules) or wins_game(other, own, rules)):
                yield (games[0], games[1]), (own, other)


def as_shares(points: tuple[Any, Any], games: tuple[Any, Any], rules: Rules = BWF) -> tuple[Any, Any, Any, Any]:
    """Points and games of both players as shares of the most that they can have, for observations: from 0 to 1.

    Numbers, or arrays of one shape.
    """
    return points[0] / rules.cap, points[1] / rules.cap, games[0] / rules.games, games[1] / rules.games


def ends_changed(points: tuple[int, int], games: tuple[int, int], rules: Rules = BWF) -> bool:
    """Whether the players are at other ends of the court than in the first rally of the match.

    They change after every game, and in the deciding one when the first of them has half of its points (BWF Law 8).

    Args:
        points: of both in the current game.
        games: won by both.
        rules: of the match.
    """
    deciding = rules.games > 1 and games[0] == games[1] == rules.games - 1
    halved = deciding and max(points) >= (rules.points + 1) // 2
    return bool((sum(games) + halved) % 2)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Score:
    """The scores of B matches, of at most G games each. Players are 0 and 1.

    Attributes:
        by_game: ``[B, G, 2]`` int8 points in each game, zero in games not yet begun.
        games: ``[B, 2]`` int8 games won.
        server: ``[B]`` int8 who serves the next rally: the winner of the last one.
        rules: when a game and a match are won.
    """

    by_game: I8
    games: I8
    server: I8
    rules: Rules

    def __len__(self) -> int:
        return len(self.server)

    @property
    def over(self) -> Bools:
        """``[B]`` whether the match is over."""
        return is_over(self.games, self.rules)

    @property
    def winner(self) -> I8:
        """``[B]`` who won the match, -1 while it continues."""
        return np.where(self.over, self.games.argmax(axis=1), -1).astype(np.int8)

    @property
    def game(self) -> I64:
        """``[B]`` index of the current game, of the last one played when the match is over."""
        return self.games.sum(axis=1, dtype=np.int64) - self.over

    @property
    def points(self) -> I8:
        """``[B, 2]`` points in the current game, of the last one played when the match is over."""
        return self.by_game[np.arange(len(self)), self.game]

    def seen_by(self, player: Ints | int) -> I16:
        """``[B, 4]`` points of a player, of the opponent, games of the player, of the opponent."""
        rows = np.arange(len(self))
        points = self.points
        columns = (points[rows, player], points[rows, 1 - player], self.games[rows, player], self.games[rows, 1 - player])
        return np.stack(columns, axis=1).astype(np.int16)


def new(first_server: npt.ArrayLike, rules: Rules = BWF) -> Score:
    """B matches at love all.

    Args:
        first_server: ``[B]`` who serves the first rally, 0 or 1.
        rules: when a game and a match are won.

    Raises:
        ScoringError: a server that is neither 0 nor 1, or no one-dimensional batch.
    """
    server = np.asarray(first_server)
    if server.ndim != 1 or not np.isin(server, (0, 1)).all():
        raise ScoringError(f"first server {first_server!r}: expected a one-dimensional array of 0 and 1")
    batch = len(server)
    return Score(
        by_game=np.zeros((batch, rules.max_games, 2), dtype=np.int8),
        games=np.zeros((batch, 2), dtype=np.int8),
        server=server.astype(np.int8),
        rules=rules,
    )


def step(score: Score, winner: Ints) -> Score:
    """Count one rally of each match.

    Args:
        score: before the rally; not changed.
        winner: ``[B]`` who won it, 0 or 1; -1 where no rally has ended. Matches that are over stay as they are.
    """
    rows = np.flatnonzero((winner >= 0) & ~score.over)
    won_by = winner[rows]
    by_game, games, server = score.by_game.copy(), score.games.copy(), score.server.copy()
    game = score.game[rows]
    server[rows] = won_by
    counted = count_rally(by_game[rows, game, won_by], by_game[rows, game, 1 - won_by], games[rows, won_by], score.rules)
    by_game[rows, game, won_by], games[rows, won_by] = counted.points, counted.games
    return Score(by_game=by_game, games=games, server=server, rules=score.rules)


def game_win_probability(
    p_serving: npt.ArrayLike,
    p_receiving: npt.ArrayLike,
    *,
    points: tuple[int, int] = (0, 0),
    server: int | None = None,
    rules: Rules = BWF,
) -> F64:
    """Exact probability that player 0 wins the current game.

    Args:
        p_serving: probability that player 0 wins a rally in which player 0 serves; any shape.
        p_receiving: probability that player 0 wins a rally in which player 1 serves; broadcasts against ``p_serving``.
        points: points of players 0 and 1.
        server: who serves next; None: drawn at random, the mean of both.
        rules: when a game is won.

    Returns:
        One probability for each pair of probabilities.

    Raises:
        ScoringError: a probability outside [0, 1], or a score that the rules do not allow.
    """
    serving, receiving = _probabilities(p_serving, p_receiving)
    _check_server(server)
    return _by_server(_game(serving, receiving, points, rules), server)


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
        rules: when a game and the match are won.

    Returns:
        One probability for each pair of probabilities.

    Raises:
        ScoringError: a probability outside [0, 1], or a score that the rules do not allow.
    """
    serving, receiving = _probabilities(p_serving, p_receiving)
    _check_server(first_server)
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
    return _by_server(odds[games], first_server)


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


def _probabilities(p_serving: npt.ArrayLike, p_receiving: npt.ArrayLike) -> tuple[F64, F64]:
    serving, receiving = np.broadcast_arrays(np.asarray(p_serving, np.float64), np.asarray(p_receiving, np.float64))
    for p in (serving, receiving):
        bad = ~((p >= 0) & (p <= 1))
        if bad.any():
            raise ScoringError(f"probability of winning a rally {p[bad].flat[0]:g}: expected a number from 0 to 1")
    return serving, receiving


def _check_server(server: int | None) -> None:
    if server not in (None, 0, 1):
        raise ScoringError(f"server {server!r}: expected 0, 1, or None to draw it at random")


def _by_server(odds: tuple[F64, F64], server: int | None) -> F64:
    return np.asarray((odds[0] + odds[1]) / 2 if server is None else odds[server])
