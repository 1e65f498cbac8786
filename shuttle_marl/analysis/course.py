"""The course of a match: score, probabilities of winning, and the strokes that decided rallies."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa

from shuttle_marl.analysis.summary import rally_table
from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.exact.match import Odds, match_table
from shuttle_marl.game.scoring import Rules, Score
from shuttle_marl.game.stroke import SHOTS

_TURN: Final = 0.1
"""Smallest change of the probability of winning a rally that is reported."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RallyRow:
    """A rally of the match; players are 0 and 1.

    Attributes:
        key: game and number of the rally in the data.
        points, games: score before it.
        server, winner: numbers of the players; winner None: not recorded.
        ending: one of :data:`~shuttle_marl.analysis.summary.ENDINGS`.
        last_shot: shot type of the last stroke.
        before, after: probability that player 0 wins the match, before and after it.
        decided: number of the stroke before the last one that changed the probability of winning the rally most, from 1, with the
            player who struck it, its shot type, and the change for that player; None: not known, or less than a tenth.
        seconds: time of the rally in the video [s]; None: unknown.
    """

    key: tuple[int, int]
    points: tuple[int, int]
    games: tuple[int, int]
    server: int
    winner: int | None
    strokes: int
    ending: str
    last_shot: str
    before: float
    after: float
    decided: tuple[int, int, str, float] | None
    seconds: float | None

    @property
    def swing(self) -> float:
        """Change of the probability that player 0 wins the match."""
        return self.after - self.before


def rallies_of(valued: pa.Table, players: tuple[str, str], rules: Rules, chances_of: "Chances") -> list[RallyRow]:
    """Rallies with the score and the probabilities of winning the match."""
    frame = rally_table(valued)
    rows = frame.to_pylist()
    starts = frame["first"].to_pylist()
    column = {
        name: valued[name].to_numpy(zero_copy_only=False)
        for name in ("player", "stroke", "shot", "value_added", "points", "points_opponent", "clock")
    }
    score = Score(rules=rules, server=players.index(rows[0]["server"]))
    out: list[RallyRow] = []
    for row, start, end in zip(rows, starts, [*starts[1:], valued.num_rows], strict=True):
        server = players.index(row["server"])
        winner = None if row["winner"] is None else players.index(row["winner"])
        if out and row["game"] != out[-1].key[0] and score.points != (0, 0):
            # Rallies at the end of a game are missing: the leader won it.
            while score.points != (0, 0):
                score = score.after(int(score.points[1] > score.points[0]))
        score = _as_recorded(score, column, start, players, winner)
        after = score.after(winner) if winner is not None else score
        chance = chances_of.of(score, server)
        if winner is not None:
            chances_of.learn(server, winner)
        chances = (chance, chances_of.of(after, server if winner is None else winner))
        added = column["value_added"][start:end]
        decided = None
        striker = np.array([players.index(name) for name in column["player"][start:end]])
        gain = np.nan_to_num(np.where(striker == winner, added, -added))[:-1]
        if winner is not None and len(gain) and gain.max() >= _TURN:
            k = int(gain.argmax())
            shot = SHOTS[int(column["shot"][start + k])]
            decided = (int(column["stroke"][start + k]), int(striker[k]), shot, float(added[k]))
        clock = column["clock"][start]
        out.append(
            RallyRow(
                key=(row["game"], row["rally"]),
                points=score.points,
                games=score.games,
                server=server,
                winner=winner,
                strokes=row["length"],
                ending=str(row["ending"]),
                last_shot=SHOTS[row["last_shot"]],
                before=chances[0],
                after=chances[1],
                decided=decided,
                seconds=None if clock is None or np.isnan(clock) else float(clock),
            )
        )
        score = after
    return out


def _as_recorded(score: Score, column: Mapping[str, Any], row: int, players: tuple[str, str], winner: int | None) -> Score:
    """The score before a rally, by the points in the data where there are any, because rallies may be missing."""
    own, other = column["points"][row], column["points_opponent"][row]
    if winner is None or own is None or other is None or np.isnan(own) or np.isnan(other):
        return score
    points = [int(own), int(other)] if players.index(column["player"][row]) == 0 else [int(other), int(own)]
    points[winner] -= 1
    return dataclasses.replace(score, points=(max(0, points[0]), max(0, points[1])))


class Chances:
    """Probabilities that player 0 wins the match, while its rallies tell how well both play on the day.

    The odds are one of several, each with a weight, which every rally multiplies by the probability of its result (Bayes).

    Args:
        odds: of player 0.
        weights: ``[K]`` their probabilities before the match.
    """

    def __init__(self, odds: Sequence[Odds], weights: F64, rules: Rules) -> None:
        self._odds, self._weights = odds, weights
        self._tables = [match_table(each.serving, each.receiving, rules) for each in odds]

    def _rally(self, server: int) -> F64:
        return np.array([each.receiving if server else each.serving for each in self._odds])

    def of(self, score: Score, server: int) -> float:
        """At a score; NaN at one that the rules do not allow."""
        if score.over:
            return float(score.winner == 0)
        situation = (*score.games, *score.points, server)
        if situation not in self._tables[0]:
            return float("nan")
        won, lost = np.array([table[situation] for table in self._tables]).T
        return float(self._weights @ (lost + (won - lost) * self._rally(server)))

    def learn(self, server: int, winner: int) -> None:
        """Take the result of a rally into account."""
        won = self._rally(server)
        weights = self._weights * (1 - won if winner else won)
        self._weights = weights / weights.sum() if weights.sum() > 0 else self._weights


def score_of(rallies: Sequence[RallyRow]) -> tuple[tuple[int, int], ...]:
    """Points of both players at the end of each game."""
    ends: dict[int, tuple[int, int]] = {}
    for row in rallies:
        points = list(row.points)
        if row.winner is not None:
            points[row.winner] += 1
        ends[row.key[0]] = (points[0], points[1])
    return tuple(ends[game] for game in sorted(ends))


def rally_numbers(strokes: pa.Table) -> I64:
    """``[N]`` index of the rally of each stroke."""
    first = rally_table(strokes)["first"].to_numpy()
    return np.repeat(np.arange(len(first)), np.diff([*first, strokes.num_rows])).astype(np.int64)
