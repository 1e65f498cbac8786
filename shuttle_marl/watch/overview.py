"""A match at a glance: probability of winning it over its rallies, costliest strokes, accuracy and marks of both sides."""

from collections import Counter
from collections.abc import Iterable
from typing import Final

import numpy as np

from shuttle_marl.analysis.marks import MARKS
from shuttle_marl.analysis.rally import Players, match_win_after
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.watch import messages
from shuttle_marl.watch.match import CourtRally

MOMENTS: Final = 5
"""Number of costliest strokes."""


def match_overview(
    rallies: Iterable[tuple[CourtRally, Players, messages.Analysis]], moments: int = MOMENTS
) -> messages.MatchReply:
    """The overview of a match.

    Args:
        rallies: finished rallies of the match in their order, with their players and the values of their strokes.
        moments: maximum number of costliest strokes, of those that are marked as mistakes. The cost of a stroke is its loss
            times the difference that the rally makes to the probability of winning the match.
    """
    rows: list[messages.MatchRally] = []
    costly: list[messages.Moment] = []
    marks: tuple[Counter[str], Counter[str]] = (Counter(), Counter())
    sound: tuple[list[bool], list[bool]] = ([], [])
    after: float | None = None
    for rally, players, values in rallies:
        winner = rally.winner
        if winner is None or players.value is None:
            break
        won, lost = match_win_after(players.value, rally.points, rally.games, rally.score.rules)
        swing = np.abs(np.diff([*(value.win for value in values.strokes), float(winner == 0)])).max()
        win, size = round(values.strokes[0].match, 5), len(rally)
        rows.append(messages.MatchRally(rally.number, win, rally.points, rally.games, winner, size, round(float(swing), 5)))
        after = round((won, lost)[winner], 5)
        seats = rally.striker.tolist()
        for i, (value, seat) in enumerate(zip(values.strokes, seats, strict=True)):
            marks[seat][value.mark] += 1
            shot = SHOTS[rally.catalogue.shot[rally.stroke[i]]]
            if "?" in value.mark:
                costly.append(messages.Moment(rally.number, i, seat, shot, value.mark, value.loss, value.loss * (won - lost)))
            if value.change is not None:
                sound[seat].append("?" not in value.mark)
    # Where one side wins for certain, no stroke costs the match: then the cost of the rally decides.
    costly.sort(key=lambda moment: (-round(moment.cost, 4), -moment.loss))
    means = [float(np.mean(part)) if part else None for part in sound]
    return messages.MatchReply(
        rallies=rows,
        win_after=after,
        moments=costly[:moments],
        accuracy=(means[0], means[1]),
        marks=([marks[0][mark] for mark in MARKS], [marks[1][mark] for mark in MARKS]),
    )
