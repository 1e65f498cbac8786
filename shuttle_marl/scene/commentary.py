"""Commentary of a rally: strokes, score, probabilities and values, target areas, and the scoreboard."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from foxglove.messages import Color, CylinderPrimitive, LinePrimitive, LinePrimitiveLineType, SceneEntity, Vector3

from shuttle_marl.game.court import AREAS, area_box
from shuttle_marl.game.layout import LONGEST_DUEL
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.scene import topics
from shuttle_marl.scene.board import boards
from shuttle_marl.scene.report import RallyReport, StagedRally
from shuttle_marl.scene.topics import PLAY, Timed, at, box, colour, entities_on, log_line, numbers_on, point, stamp
from shuttle_marl.staging import ENDS
from shuttle_marl.staging.trajectory import facing

TOP: Final = 5
"""Number of strokes of a policy that are listed."""
_PATH_POINTS: Final = 32
_PATH: Final = colour(1.0, 1.0, 1.0, 0.35)
_TARGET: Final = colour(1.0, 0.80, 0.10, 0.30)
_LANDED: Final = (colour(0.95, 0.25, 0.20, 0.9), colour(0.20, 0.90, 0.35, 0.9))


def commentary(staged: StagedRally) -> Iterator[Timed]:
    """Messages that comment on a rally, not ordered by time."""
    report, trajectory = staged.report, staged.motion.trajectory
    strokes = [stroke_message(staged, i) for i in range(len(report.played))]
    yield entities_on(topics.STROKE_MARKS, staged.at(0), [])
    for i, content in enumerate(strokes):
        time, seat = staged.at(float(trajectory.time[i])), int(content["seat"])
        yield entities_on(topics.STROKE_MARKS, time, _flight(staged, i, time))
        yield numbers_on(topics.STROKE, time, content)
        yield from boards(report, time, _action(report, i), marked=seat)
        yield log_line(time, _sentence(content), report.names[seat])
        yield from _probabilities(report, i, time)
    over = staged.at(float(trajectory.end_time[-1]))
    result = f"{report.names[report.winner]} wins the rally: {_ending(staged)}"
    yield log_line(over, result, "umpire")
    yield from boards(report, over, result, after=True)
    yield entities_on(topics.STROKE_MARKS, over, [_landing(staged, over)])
    yield from _score(staged, strokes)


def _probabilities(report: RallyReport, i: int, time: int) -> Iterator[Timed]:
    """Values and the policy's probabilities at a stroke, as far as they are known."""
    decision, rank, seat = report.analysis.decisions[i], report.analysis.rank[i], report.analysis.decisions[i].seat
    values_known = bool(np.isfinite(decision.value))
    if values_known:
        win, match_win = report.analysis.rally_win[i], report.analysis.match_win[i]
        content = {"rally_win_0": float(win), "match_win_0": float(match_win)}
        yield numbers_on(topics.VALUE, time, {**content, "striker": decision.value, "chosen": float(decision.win[rank])})
    if np.isfinite(decision.probability).all():
        catalogue, p = report.game.catalogue, decision.probability
        by_shot = np.bincount(catalogue.shot[decision.stroke], weights=p, minlength=len(SHOTS)).tolist()
        top = [
            {
                "stroke": catalogue.names[decision.stroke[k]],
                "probability": round(float(p[k]), 4),
                "win_probability": round(float(decision.win[k]), 4),
            }
            for k in (np.argsort(-p, kind="stable")[:TOP] if values_known else ())
        ]
        shots = {shot.replace("-", "_"): share for shot, share in zip(SHOTS, by_shot, strict=True)}
        yield numbers_on(topics.POLICY, time, {"seat": seat, "player": report.names[seat], "top": top, "shots": shots})


def stroke_message(staged: StagedRally, i: int) -> dict[str, Any]:
    """Content of ``/rally/stroke`` for the i-th stroke."""
    report, trajectory = staged.report, staged.motion.trajectory
    decision, rank = report.analysis.decisions[i], report.analysis.rank[i]
    catalogue, stroke, seat = report.played.catalogue, report.played.stroke[i], decision.seat
    effort, opponent_effort = report.efforts(i) or (None, None)
    content = {
        "number": i + 1,
        "seat": seat,
        "player": report.names[seat],
        "stroke": catalogue.names[stroke],
        "shot": SHOTS[catalogue.shot[stroke]],
        "area": AREAS[catalogue.area[stroke]],
        "height": HEIGHTS[catalogue.height[stroke]],
        "technique": TECHNIQUES[catalogue.technique[stroke]],
        "p_succ": float(decision.p_succ[rank]),
        "p_ret": float(decision.p_ret[rank]),
        "probability": float(decision.probability[rank]),
        "win_probability": float(decision.win[rank]),
        "effort": effort,
        "opponent_effort": opponent_effort,
        "duel": report.duel(i),
        "contact_height": round(float(trajectory.contact[i, 2]), 3),
        "speed_kmh": round(3.6 * float(trajectory.flight.launch_speed[i]), 1),
        "flight_time": round(float(trajectory.end_time[i] - trajectory.time[i]), 3),
        "end": ENDS[trajectory.end[i]],
    }
    return topics.known(content)


def _score(staged: StagedRally, strokes: list[dict[str, Any]]) -> Iterator[Timed]:
    report, played = staged.report, staged.report.played
    start, over = staged.at(0), staged.at(float(staged.motion.trajectory.end_time[-1]))
    before = {
        "rally": report.number,
        "match": played.match,
        "name_0": report.names[0],
        "name_1": report.names[1],
        "points_0": played.points[0],
        "points_1": played.points[1],
        "games_0": played.games[0],
        "games_1": played.games[1],
        "server": played.server,
    }
    after = {"points_0": report.points_after[0], "points_1": report.points_after[1]}
    yield numbers_on(topics.SCORE, start, before)
    yield numbers_on(topics.SCORE, over, {**before, **after, "winner": report.winner, "reason": report.reason})
    serves = f"{report.names[played.server]} serves"
    yield from boards(report, start, serves, marked=played.server)
    games = f"   games {played.games[0]}-{played.games[1]}" if report.in_match else ""
    score = f"{report.names[0]}  {played.points[0]} - {played.points[1]}  {report.names[1]}{games}"
    yield log_line(start, f"rally {report.number}: {score}, {serves}", "umpire")
    summary = {"rally": report.number, "winner": report.names[report.winner], "reason": report.reason, "strokes": strokes}
    yield numbers_on(topics.SUMMARY, start, summary)
    rally_win, match_win = report.analysis.rally_win.tolist(), report.analysis.match_win.tolist()
    if np.isfinite(rally_win[0]):
        yield numbers_on(topics.VALUE, start, {"rally_win_0": rally_win[0], "match_win_0": match_win[0]})
        yield numbers_on(topics.VALUE, over, {"rally_win_0": rally_win[-1], "match_win_0": match_win[-1]})


def _action(report: RallyReport, i: int) -> str:
    """A stroke on the scoreboard."""
    played, decision, rank = report.played, report.analysis.decisions[i], report.analysis.rank[i]
    catalogue, stroke = played.catalogue, played.stroke[i]
    shot, area = SHOTS[catalogue.shot[stroke]].replace("-", " "), AREAS[catalogue.area[stroke]].replace("-", " ")
    technique = TECHNIQUES[catalogue.technique[stroke]].replace("-", " ")
    lines = [
        f"{shot} to {area}, {technique}",
        f"good {percent(float(decision.p_succ[rank]))}, returned {percent(float(decision.p_ret[rank]))}",
    ]
    efforts, duel = report.efforts(i), report.duel(i)
    if efforts is not None:
        lines.append(f"effort {efforts[decision.seat]} - {efforts[1 - decision.seat]}")
    if duel is not None and duel > 1:
        lines.append(f"{duel}{' or more' if duel == LONGEST_DUEL else ''} net shots in a row")
    return "\n".join(lines)


def _sentence(content: dict[str, Any]) -> str:
    chosen = f", chosen with {percent(content['probability'])}" if "probability" in content else ""
    return (
        f"#{content['number']} {content['shot']} to {content['area']} ({content['technique']}, {content['speed_kmh']:.0f} km/h"
        f"{chosen}): good {percent(content['p_succ'])}, returned {percent(content['p_ret'])}"
    )


def percent(probability: float) -> str:
    """A probability as an integer percentage; 0 % means impossible and 100 % certain."""
    if 0 < probability < 0.005:
        return "under 1 %"
    if 0.995 < probability < 1:
        return "over 99 %"
    return f"{100 * probability:.0f} %"


def _ending(staged: StagedRally) -> str:
    played = staged.report.played
    shot = SHOTS[played.catalogue.shot[played.stroke[-1]]].replace("-", " ")
    return {"winner": f"{shot} is not returned", "out": f"{shot} lands out", "net": f"{shot} into the net"}[
        ENDS[staged.motion.trajectory.end[-1]]
    ]


def _flight(staged: StagedRally, i: int, time: int) -> list[SceneEntity]:
    """Path of the shuttle after a stroke, and the target area."""
    played, trajectory = staged.report.played, staged.motion.trajectory
    path, _ = trajectory.flight.at(i, np.linspace(0, trajectory.end_time[i] - trajectory.time[i], _PATH_POINTS))
    line = LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        pose=at((0, 0, 0)),
        thickness=1.5,
        scale_invariant=True,
        points=[point(p) for p in np.round(path, 3)],
        color=_PATH,
    )
    stroke, sign = played.stroke[i], facing(int(played.striker[i]))
    (x0, x1), (y0, y1) = area_box(int(played.catalogue.area[stroke]), serve=bool(played.catalogue.is_serve[stroke]))
    target = box((sign * (x0 + x1) / 2, sign * (y0 + y1) / 2, 0.006), (x1 - x0, y1 - y0, 0.004), _TARGET)
    return [
        SceneEntity(id="path", timestamp=stamp(time), frame_id=PLAY, lines=[line]),
        SceneEntity(id="target", timestamp=stamp(time), frame_id=PLAY, cubes=[target]),
    ]


def _landing(staged: StagedRally, time: int) -> SceneEntity:
    """Disc where the last shuttle landed: green for a winner, red for a fault."""
    trajectory = staged.motion.trajectory
    x, y, _ = trajectory.end_point[-1]
    shade: Color = _LANDED[int(ENDS[trajectory.end[-1]] == "winner")]
    disc = CylinderPrimitive(
        pose=at((x, y, 0.008)), size=Vector3(x=0.30, y=0.30, z=0.006), bottom_scale=1.0, top_scale=1.0, color=shade
    )
    return SceneEntity(id="landing", timestamp=stamp(time), frame_id=PLAY, cylinders=[disc])
