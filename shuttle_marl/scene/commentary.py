"""What is said about a rally: every stroke as it is struck, the score, chances and values, target areas, the board."""

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from foxglove.messages import Color, CylinderPrimitive, LinePrimitive, LinePrimitiveLineType, SceneEntity, Vector3

from shuttle_marl.game.court import AREAS, BACK_CUT, HALF_LENGTH, HALF_WIDTH, MIDDLE_CUT, SHORT_SERVICE, SIDE_CUT
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, SHOTS, TECHNIQUES
from shuttle_marl.scene import topics
from shuttle_marl.scene.drawing import at, box, colour, point, stamp, text
from shuttle_marl.scene.poses import PLAY, WORLD
from shuttle_marl.scene.report import Story, Telling
from shuttle_marl.scene.staged import Send, Take, Timed, line, numbers, scene
from shuttle_marl.staging import ENDS
from shuttle_marl.staging.trajectory import facing

_PATH_POINTS: Final = 32
_PATH: Final = colour(1.0, 1.0, 1.0, 0.35)
_TARGET: Final = colour(1.0, 0.80, 0.10, 0.30)
_LANDED: Final = (colour(0.95, 0.25, 0.20, 0.9), colour(0.20, 0.90, 0.35, 0.9))
_BOARD_AT: Final = (-5.2, 0.0)
"""Beside the net post that is the far one in the layouts, out of the way of the shuttle [m]."""
_BOARD: Final = colour(0.97, 0.97, 0.97)
_ACTION: Final = colour(1.0, 0.88, 0.45)


def calls(take: Take) -> Iterator[Timed]:
    """All that is said about a rally."""
    yield from _strokes(take)
    yield from _score(take)


def _strokes(take: Take) -> Iterator[Timed]:
    story, plan = take.story, take.motion.plan
    yield take.at(0), scene(topics.STROKE_MARKS, lambda _: [])
    for i, telling in enumerate(story.tellings):
        time = take.at(float(plan.time[i]))
        seat = int(plan.rally.striker[i])
        content = stroke_message(take, i)
        yield time, scene(topics.STROKE_MARKS, _Marks(take, i))
        yield time, numbers(topics.STROKE, content)
        yield time, scene(topics.BOARD, _Board(score_line(story, after=False), _action(story, i)))
        yield time, line(_sentence(content), story.names[seat])
        yield from ((time, send) for send in _chances(story, seat, telling))
    over = take.at(float(plan.end_time[-1]))
    words = f"{story.names[story.winner]} wins the rally: {_ending(take)}"
    yield over, line(words, "umpire")
    yield over, scene(topics.BOARD, _Board(score_line(story, after=True), words))
    yield over, scene(topics.STROKE_MARKS, _Landing(take))


def _chances(story: Story, seat: int, telling: Telling) -> Iterator[Send]:
    if telling.rally_win is not None:
        yield numbers(
            topics.VALUE,
            {
                "rally_win_0": telling.rally_win,
                "match_win_0": telling.match_win,
                "striker": telling.value,
                "chosen": telling.chosen,
            },
        )
    if telling.shots:
        shots = {shot.replace("-", "_"): p for shot, p in zip(SHOTS, telling.shots, strict=True)}
        top = [dataclasses.asdict(option) for option in telling.top]
        yield numbers(topics.POLICY, {"seat": seat, "player": story.names[seat], "top": top, "shots": shots})


def stroke_message(take: Take, i: int) -> dict[str, Any]:
    """What ``/rally/stroke`` says about the i-th stroke."""
    plan, telling = take.motion.plan, take.story.tellings[i]
    catalogue, stroke = plan.rally.catalogue, plan.rally.stroke[i]
    seat = int(plan.rally.striker[i])
    content = {
        "number": i + 1,
        "seat": seat,
        "player": take.story.names[seat],
        "stroke": catalogue.names[stroke],
        "shot": SHOTS[catalogue.shot[stroke]],
        "area": AREAS[catalogue.area[stroke]],
        "height": HEIGHTS[catalogue.height[stroke]],
        "technique": TECHNIQUES[catalogue.technique[stroke]],
        "p_succ": telling.p_succ,
        "p_ret": telling.p_ret,
        "probability": telling.probability,
        "win_probability": telling.chosen,
        "contact_height": round(float(plan.contact[i, 2]), 3),
        "speed_kmh": round(3.6 * float(plan.flight.launch_speed[i]), 1),
        "flight_time": round(float(plan.end_time[i] - plan.time[i]), 3),
        "end": ENDS[plan.end[i]],
    }
    return {name: value for name, value in content.items() if value is not None}


def _score(take: Take) -> Iterator[Timed]:
    story, plan = take.story, take.motion.plan
    start, over = take.at(0), take.at(float(plan.end_time[-1]))
    before = {
        "rally": story.number,
        "match": story.match,
        "name_0": story.names[0],
        "name_1": story.names[1],
        "points_0": story.points[0],
        "points_1": story.points[1],
        "games_0": story.games[0],
        "games_1": story.games[1],
        "server": story.played.server,
    }
    after = {"points_0": story.points_after[0], "points_1": story.points_after[1]}
    yield start, numbers(topics.SCORE, before)
    yield over, numbers(topics.SCORE, {**before, **after, "winner": story.winner, "reason": story.reason})
    serves = f"{story.names[story.played.server]} serves"
    yield start, scene(topics.BOARD, _Board(score_line(story, after=False), serves))
    yield start, line(f"rally {story.number}: {score_line(story, after=False)}, {serves}", "umpire")
    strokes = [stroke_message(take, i) for i in range(len(story.tellings))]
    summary = {"rally": story.number, "winner": story.names[story.winner], "reason": story.reason, "strokes": strokes}
    yield start, numbers(topics.SUMMARY, summary)
    first = story.tellings[0]
    if first.rally_win is not None:
        yield start, numbers(topics.VALUE, {"rally_win_0": first.rally_win, "match_win_0": first.match_win})
        won = {"rally_win_0": float(story.winner == 0), "match_win_0": story.match_win_after}
        yield over, numbers(topics.VALUE, won)


def score_line(story: Story, *, after: bool) -> str:
    """The score in one line, seat 0 first."""
    points = story.points_after if after else story.points
    games = f"   games {story.games[0]}-{story.games[1]}" if any(story.games) or story.match or any(story.points) else ""
    return f"{story.names[0]}  {points[0]} - {points[1]}  {story.names[1]}{games}"


def _action(story: Story, i: int) -> str:
    told, played = story.tellings[i], story.played
    stroke = played.stroke[i]
    catalogue = played.catalogue
    shot, area = SHOTS[catalogue.shot[stroke]].replace("-", " "), AREAS[catalogue.area[stroke]].replace("-", " ")
    technique = TECHNIQUES[catalogue.technique[stroke]].replace("-", " ")
    name = story.names[played.striker[i]]
    return f"{name}: {shot} to {area}, {technique}\ngood {percent(told.p_succ)}, returned {percent(told.p_ret)}"


def _sentence(content: dict[str, Any]) -> str:
    chosen = f", chosen with {percent(content['probability'])}" if "probability" in content else ""
    return (
        f"#{content['number']} {content['shot']} to {content['area']} ({content['technique']}, {content['speed_kmh']:.0f} km/h"
        f"{chosen}): good {percent(content['p_succ'])}, returned {percent(content['p_ret'])}"
    )


def percent(chance: float) -> str:
    """A chance in whole percent; what may happen is never 0 %, and what may not happen never 100 %."""
    if 0 < chance < 0.005:
        return "under 1 %"
    if 0.995 < chance < 1:
        return "over 99 %"
    return f"{100 * chance:.0f} %"


def _ending(take: Take) -> str:
    plan = take.motion.plan
    shot = SHOTS[plan.rally.catalogue.shot[plan.rally.stroke[-1]]].replace("-", " ")
    return {"winner": f"{shot} is not returned", "out": f"{shot} lands out", "net": f"{shot} into the net"}[ENDS[plan.end[-1]]]


@dataclasses.dataclass(frozen=True)
class _Board:
    score: str
    words: str

    def __call__(self, time: int) -> list[SceneEntity]:
        lines = [text(self.score, (*_BOARD_AT, 2.85), 0.32, _BOARD)]
        lines += [text(line, (*_BOARD_AT, 2.43 - 0.34 * k), 0.27, _ACTION) for k, line in enumerate(self.words.split("\n"))]
        return [SceneEntity(id="board", timestamp=stamp(time), frame_id=WORLD, texts=lines)]


@dataclasses.dataclass(frozen=True, eq=False)
class _Marks:
    """The way that the shuttle will fly, and the area it is meant for."""

    take: Take
    stroke: int

    def __call__(self, time: int) -> list[SceneEntity]:
        plan, i = self.take.motion.plan, self.stroke
        path, _ = plan.flight.at(i, np.linspace(0, plan.end_time[i] - plan.time[i], _PATH_POINTS))
        way = LinePrimitive(
            type=LinePrimitiveLineType.LineStrip,
            pose=at((0, 0, 0)),
            thickness=1.5,
            scale_invariant=True,
            points=[point(p) for p in np.round(path, 3)],
            color=_PATH,
        )
        area = _area_box(
            plan.rally.catalogue.area[plan.rally.stroke[i]], bool(plan.rally.catalogue.shot[plan.rally.stroke[i]] < N_SERVES)
        )
        sign = facing(int(plan.rally.striker[i]))
        (x0, x1), (y0, y1) = area
        centre = (sign * (x0 + x1) / 2, sign * (y0 + y1) / 2, 0.006)
        target = box(centre, (x1 - x0, y1 - y0, 0.004), _TARGET)
        return [
            SceneEntity(id="path", timestamp=stamp(time), frame_id=PLAY, lines=[way]),
            SceneEntity(id="target", timestamp=stamp(time), frame_id=PLAY, cubes=[target]),
        ]


@dataclasses.dataclass(frozen=True, eq=False)
class _Landing:
    """Where the last shuttle came down: green in court, red if it is a fault."""

    take: Take

    def __call__(self, time: int) -> list[SceneEntity]:
        plan = self.take.motion.plan
        x, y, _ = plan.end_point[-1]
        shade: Color = _LANDED[int(ENDS[plan.end[-1]] == "winner")]
        disc = CylinderPrimitive(
            pose=at((x, y, 0.008)),
            size=Vector3(x=0.30, y=0.30, z=0.006),
            bottom_scale=1.0,
            top_scale=1.0,
            color=shade,
        )
        return [SceneEntity(id="landing", timestamp=stamp(time), frame_id=PLAY, cylinders=[disc])]


def _area_box(area: int, serve: bool) -> tuple[tuple[float, float], tuple[float, float]]:
    """Extent of an area across and along the court, in the striker's frame [m]."""
    depth, side = divmod(int(area), 3)
    across = ((-HALF_WIDTH, -SIDE_CUT), (-SIDE_CUT, SIDE_CUT), (SIDE_CUT, HALF_WIDTH))[side]
    along = ((0.0, MIDDLE_CUT), (MIDDLE_CUT, BACK_CUT), (BACK_CUT, HALF_LENGTH))[depth]
    if serve:
        along = (max(along[0], SHORT_SERVICE), along[1])
    return across, along
