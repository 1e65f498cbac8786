"""The course of a match: score, probabilities of winning, and the strokes that decided rallies."""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import I64
from shuttle_marl.exact.match import Odds, match_table
from shuttle_marl.game.scoring import Rules, Score, wins_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.reports.summary import rally_table

_TURN: Final = 0.1
"""Smallest change of the probability of winning a rally that is reported."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RallyRow:
    """A rally of the match; players are 0 and 1.

    Attributes:
        key: game and number of the rally in the data.
        points, games: score before it.
        server, winner: numbers of the players; winner None: not recorded.
        ending: one of :data:`~shuttle_marl.reports.summary.ENDINGS`.
        last_shot, last_area: shot type and target area of the last stroke; area -1: not known, as that of a fault.
        given: shot type and target area of the stroke before it; None: there was none.
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
    last_area: int
    given: tuple[str, int] | None
    before: float
    after: float
    decided: tuple[int, int, str, float] | None
    seconds: float | None

    @property
    def swing(self) -> float:
        """Change of the probability that player 0 wins the match."""
        return self.after - self.before


def rallies_of(
    valued: pa.Table, area: I64, players: tuple[str, str], rules: Rules, chances_of: "Chances"
) -> list[RallyRow]:  # fmt: skip
    """Rallies with the score and the probabilities of winning the match; ``area``: target of each stroke, -1 unknown."""
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
                last_area=int(area[end - 1]),
                given=(SHOTS[int(column["shot"][end - 2])], int(area[end - 2])) if end - start > 1 else None,
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
    """Probabilities that player 0 wins the match.

    Args:
        odds: of player 0, in every rally.
    """

    def __init__(self, odds: Odds, rules: Rules) -> None:
        self._odds, self._table = odds, match_table(odds.serving, odds.receiving, rules)

    def of(self, score: Score, server: int) -> float:
        """At a score; NaN at one that the rules do not allow."""
        if score.over:
            return float(score.winner == 0)
        won, lost = self._table.get((*score.games, *score.points, server), (math.nan, math.nan))
        return lost + (won - lost) * (self._odds.receiving if server else self._odds.serving)


def score_of(rallies: Sequence[RallyRow], rules: Rules) -> tuple[tuple[tuple[int, int], ...], tuple[int, ...]]:
    """Points of both players at the end of each game, and the numbers of the games whose last rally was inferred.

    A last rally that the data lack is added where the rules leave one end: the leader was one rally away from the game, and did
    win it, because the leader served first in the next game, or because there is none.
    """
    ends: dict[int, tuple[list[int], int | None]] = {}
    for row in rallies:
        points = list(row.points)
        if row.winner is not None:
            points[row.winner] += 1
        ends[row.key[0]] = points, None
    for before, row in itertools.pairwise(rallies):
        if row.key[0] != before.key[0] and row.key[1] == 1:
            ends[before.key[0]] = ends[before.key[0]][0], row.server
    inferred = []
    for game, (points, served) in ends.items():
        leader = int(points[1] > points[0])
        over = wins_game(max(points), min(points), rules)
        if not over and served in (leader, None) and wins_game(max(points) + 1, min(points), rules):
            points[leader] += 1
            inferred.append(game)
    return tuple((points[0], points[1]) for _, (points, _) in sorted(ends.items())), tuple(inferred)


def rally_numbers(strokes: pa.Table) -> I64:
    """``[N]`` index of the rally of each stroke."""
    first = rally_table(strokes)["first"].to_numpy()
    return np.repeat(np.arange(len(first)), np.diff([*first, strokes.num_rows])).astype(np.int64)
