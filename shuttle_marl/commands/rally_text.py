"""Recorded rallies as text, to be read."""

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.court import AREAS
from shuttle_marl.game.rally import OUTCOMES
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.tables import outcomes


def describe(log: RallyLog, number: int) -> str:
    """One rally: who played whom at what score, a line a stroke, and who won it.

    Raises:
        RecordingError: the log has no such rally, or is damaged.
    """
    rally = log.rally(number)
    names = [log.policies[i].name for i in rally.policy[0]]
    server, winner = int(rally.server[0]), int(rally.winner[0])
    points, games = rally.score[0, :2], rally.score[0, 2:]
    width = max(map(len, names))
    lines = [
        f"rally {number}: {names[0]} v {names[1]}, match {rally.match[0]}, rally {rally.rally[0]}, "
        f"games {games[0]}-{games[1]}, points {points[0]}-{points[1]}, {names[server]} serves"
    ]
    catalogue = log.catalogue
    for i, (stroke, outcome) in enumerate(zip(rally.stroke, outcomes(rally, catalogue), strict=True)):
        shot, area = SHOTS[catalogue.shot[stroke]], AREAS[catalogue.area[stroke]]
        technique, height = TECHNIQUES[catalogue.technique[stroke]], HEIGHTS[catalogue.height[stroke]]
        lines.append(
            f"{i + 1:5}  {names[(server + i) & 1]:{width}}  {shot} to {area}, {technique} from {height} the net"
            f"  [{OUTCOMES[outcome]}]"
        )
    lines.append(f"       {names[winner]} wins the rally ({OUTCOMES[rally.reason[0]]})")
    return "\n".join(lines)


def score_line(log: RallyLog, numbers: npt.NDArray[np.integer]) -> str:
    """The result of a match, from the numbers of its rallies: the points of every game, seat 0 first.

    Raises:
        RecordingError: the log is damaged.
    """
    ends: dict[int, tuple[int, int]] = {}
    for number in numbers:
        rally = log.rally(int(number))
        points = [int(p) for p in rally.score[0, :2]]
        points[int(rally.winner[0])] += 1
        ends[int(rally.score[0, 2:].sum())] = (points[0], points[1])
    return ", ".join(f"{a}-{b}" for a, b in ends.values())
