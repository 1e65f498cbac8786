"""Commentary of a rally: every stroke as it is struck, the score, probabilities and values, target areas, the board."""

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from foxglove.messages import Color, CylinderPrimitive, LinePrimitive, LinePrimitiveLineType, SceneEntity, Vector3

from shuttle_marl.game.court import AREAS, area_box
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import LONGEST_DUEL
from shuttle_marl.scene import topics
from shuttle_marl.scene.board import board_text, boards
from shuttle_marl.scene.frames import PLAY
from shuttle_marl.scene.report import RallyReport, StagedRally, StrokeAnnotation
from shuttle_marl.scene.topics import Send, Timed, at, box, colour, entities_on, log_line, numbers_on, point, stamp
from shuttle_marl.staging import ENDS
from shuttle_marl.staging.trajectory import facing

_PATH_POINTS: Final = 32
_PATH: Final = colour(1.0, 1.0, 1.0, 0.35)
_TARGET: Final = colour(1.0, 0.80, 0.10, 0.30)
_LANDED: Final = (colour(0.95, 0.25, 0.20, 0.9), colour(0.20, 0.90, 0.35, 0.9))


def commentary(staged: StagedRally) -> Iterator[Timed]:
    """Messages that comment on a rally; not in the order of time."""
    yield from _strokes(staged)
    yield from _score(staged)


def _strokes(staged: StagedRally) -> Iterator[Timed]:
    report, trajectory = staged.report, staged.motion.trajectory
    yield staged.at(0), entities_on(topics.STROKE_MARKS, lambda _: [])
    for i, annotation in enumerate(report.strokes):
        time = staged.at(float(trajectory.time[i]))
        seat = int(trajectory.rally.striker[i])
        content = stroke_message(staged, i)
        yield time, entities_on(topics.STROKE_MARKS, _Marks(staged, i))
        yield time, numbers_on(topics.STROKE, content)
        yield from ((time, send) for send in boards(board_text(report, _action(report, i), after=False, marked=seat)))
        yield time, log_line(_sentence(content), report.names[seat])
        yield from ((time, send) for send in _probabilities(report, seat, annotation))
    over = staged.at(float(trajectory.end_time[-1]))
    words = f"{report.names[report.winner]} wins the rally: {_ending(staged)}"
    yield over, log_line(words, "umpire")
    yield from ((over, send) for send in boards(board_text(report, words, after=True)))
    yield over, entities_on(topics.STROKE_MARKS, _Landing(staged))


def _probabilities(report: RallyReport, seat: int, annotation: StrokeAnnotation) -> Iterator[Send]:
    if annotation.rally_win is not None:
        yield numbers_on(
            topics.VALUE,
            {
                "rally_win_0": annotation.rally_win,
                "match_win_0": annotation.match_win,
                "striker": annotation.value,
                "chosen": annotation.chosen,
            },
        )
    if annotation.shots:
        shots = {shot.replace("-", "_"): p for shot, p in zip(SHOTS, annotation.shots, strict=True)}
        top = [dataclasses.asdict(option) for option in annotation.top]
        yield numbers_on(topics.POLICY, {"seat": seat, "player": report.names[seat], "top": top, "shots": shots})


def stroke_message(staged: StagedRally, i: int) -> dict[str, Any]:
    """Content of ``/rally/stroke`` for the i-th stroke."""
    trajectory, annotation = staged.motion.trajectory, staged.report.strokes[i]
    catalogue, stroke = trajectory.rally.catalogue, trajectory.rally.stroke[i]
    seat = int(trajectory.rally.striker[i])
    content = {
        "number": i + 1,
        "seat": seat,
        "player": staged.report.names[seat],
        "stroke": catalogue.names[stroke],
        "shot": SHOTS[catalogue.shot[stroke]],
        "area": AREAS[catalogue.area[stroke]],
        "height": HEIGHTS[catalogue.height[stroke]],
        "technique": TECHNIQUES[catalogue.technique[stroke]],
        "p_succ": annotation.p_succ,
        "p_ret": annotation.p_ret,
        "probability": annotation.probability,
        "win_probability": annotation.chosen,
        "effort": None if annotation.efforts is None else annotation.efforts[seat],
        "opponent_effort": None if annotation.efforts is None else annotation.efforts[1 - seat],
        "duel": annotation.duel,
        "contact_height": round(float(trajectory.contact[i, 2]), 3),
        "speed_kmh": round(3.6 * float(trajectory.flight.launch_speed[i]), 1),
        "flight_time": round(float(trajectory.end_time[i] - trajectory.time[i]), 3),
        "end": ENDS[trajectory.end[i]],
    }
    return {name: value for name, value in content.items() if value is not None}


def _score(staged: StagedRally) -> Iterator[Timed]:
    report, trajectory = staged.report, staged.motion.trajectory
    start, over = staged.at(0), staged.at(float(trajectory.end_time[-1]))
    before = {
        "rally": report.number,
        "match": report.match,
        "name_0": report.names[0],
        "name_1": report.names[1],
        "points_0": report.points[0],
        "points_1": report.points[1],
        "games_0": report.games[0],
        "games_1": report.games[1],
        "server": report.played.server,
    }
    after = {"points_0": report.points_after[0], "points_1": report.points_after[1]}
    yield start, numbers_on(topics.SCORE, before)
    yield over, numbers_on(topics.SCORE, {**before, **after, "winner": report.winner, "reason": report.reason})
    serves = f"{report.names[report.played.server]} serves"
    yield from ((start, send) for send in boards(board_text(report, serves, after=False, marked=report.played.server)))
    yield start, log_line(f"rally {report.number}: {score_line(report, after=False)}, {serves}", "umpire")
    strokes = [stroke_message(staged, i) for i in range(len(report.strokes))]
    summary = {"rally": report.number, "winner": report.names[report.winner], "reason": report.reason, "strokes": strokes}
    yield start, numbers_on(topics.SUMMARY, summary)
    first = report.strokes[0]
    if first.rally_win is not None:
        yield start, numbers_on(topics.VALUE, {"rally_win_0": first.rally_win, "match_win_0": first.match_win})
        won = {"rally_win_0": float(report.winner == 0), "match_win_0": report.match_win_after}
        yield over, numbers_on(topics.VALUE, won)


def score_line(report: RallyReport, *, after: bool) -> str:
    """The score in one line, seat 0 first."""
    points = report.points_after if after else report.points
    games = f"   games {report.games[0]}-{report.games[1]}" if any(report.games) or report.match or any(report.points) else ""
    return f"{report.names[0]}  {points[0]} - {points[1]}  {report.names[1]}{games}"


def _action(report: RallyReport, i: int) -> str:
    annotation, played = report.strokes[i], report.played
    stroke = played.stroke[i]
    catalogue = played.catalogue
    shot, area = SHOTS[catalogue.shot[stroke]].replace("-", " "), AREAS[catalogue.area[stroke]].replace("-", " ")
    technique = TECHNIQUES[catalogue.technique[stroke]].replace("-", " ")
    lines = [
        f"{shot} to {area}, {technique}",
        f"good {percent(annotation.p_succ)}, returned {percent(annotation.p_ret)}",
    ]
    if annotation.efforts is not None:
        lines.append(f"effort {annotation.efforts[0]} - {annotation.efforts[1]}")
    if annotation.duel is not None and annotation.duel > 1:
        lines.append(f"{annotation.duel}{' or more' if annotation.duel == LONGEST_DUEL else ''} net shots in a row")
    return "\n".join(lines)


def _sentence(content: dict[str, Any]) -> str:
    chosen = f", chosen with {percent(content['probability'])}" if "probability" in content else ""
    return (
        f"#{content['number']} {content['shot']} to {content['area']} ({content['technique']}, {content['speed_kmh']:.0f} km/h"
        f"{chosen}): good {percent(content['p_succ'])}, returned {percent(content['p_ret'])}"
    )


def percent(probability: float) -> str:
    """A probability in whole percent; what may happen is never 0 %, and what may not happen never 100 %."""
    if 0 < probability < 0.005:
        return "under 1 %"
    if 0.995 < probability < 1:
        return "over 99 %"
    return f"{100 * probability:.0f} %"


def _ending(staged: StagedRally) -> str:
    trajectory = staged.motion.trajectory
    shot = SHOTS[trajectory.rally.catalogue.shot[trajectory.rally.stroke[-1]]].replace("-", " ")
    return {"winner": f"{shot} is not returned", "out": f"{shot} lands out", "net": f"{shot} into the net"}[
        ENDS[trajectory.end[-1]]
    ]


@dataclasses.dataclass(frozen=True, eq=False)
class _Marks:
    """The way that the shuttle will fly, and the area it is meant for."""

    staged: StagedRally
    stroke: int

    def __call__(self, time: int) -> list[SceneEntity]:
        trajectory, i = self.staged.motion.trajectory, self.stroke
        path, _ = trajectory.flight.at(i, np.linspace(0, trajectory.end_time[i] - trajectory.time[i], _PATH_POINTS))
        way = LinePrimitive(
            type=LinePrimitiveLineType.LineStrip,
            pose=at((0, 0, 0)),
            thickness=1.5,
            scale_invariant=True,
            points=[point(p) for p in np.round(path, 3)],
            color=_PATH,
        )
        stroke = trajectory.rally.stroke[i]
        area = area_box(int(trajectory.rally.catalogue.area[stroke]), serve=bool(trajectory.rally.catalogue.is_serve[stroke]))
        sign = facing(int(trajectory.rally.striker[i]))
        (x0, x1), (y0, y1) = area
        centre = (sign * (x0 + x1) / 2, sign * (y0 + y1) / 2, 0.006)
        target = box(centre, (x1 - x0, y1 - y0, 0.004), _TARGET)
        return [
            SceneEntity(id="path", timestamp=stamp(time), frame_id=PLAY, lines=[way]),
            SceneEntity(id="target", timestamp=stamp(time), frame_id=PLAY, cubes=[target]),
        ]


@dataclasses.dataclass(frozen=True, eq=False)
class _Landing:
    """Disc where the last shuttle came down: green in court, red if it is a fault."""

    staged: StagedRally

    def __call__(self, time: int) -> list[SceneEntity]:
        trajectory = self.staged.motion.trajectory
        x, y, _ = trajectory.end_point[-1]
        shade: Color = _LANDED[int(ENDS[trajectory.end[-1]] == "winner")]
        disc = CylinderPrimitive(
            pose=at((x, y, 0.008)),
            size=Vector3(x=0.30, y=0.30, z=0.006),
            bottom_scale=1.0,
            top_scale=1.0,
            color=shade,
        )
        return [SceneEntity(id="landing", timestamp=stamp(time), frame_id=PLAY, cylinders=[disc])]
