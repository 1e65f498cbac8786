"""What moves or changes: bones and shuttle, trail and target, the board, and the numbers that plots show."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from foxglove.messages import (
    Color,
    CylinderPrimitive,
    FrameTransform,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Log,
    LogLevel,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    Vector3,
)

from shuttle_marl.court import AREAS, BACK_CUT, HALF_LENGTH, HALF_WIDTH, MIDDLE_CUT, SHORT_SERVICE, SIDE_CUT
from shuttle_marl.scene import topics
from shuttle_marl.scene.drawing import SECOND, at, box, colour, point, stamp, text, update
from shuttle_marl.scene.poses import WORLD, poses_of
from shuttle_marl.scene.story import Story, Telling
from shuttle_marl.staging import ENDS, Motion
from shuttle_marl.staging.plan import facing
from shuttle_marl.stroke import HEIGHTS, N_SERVES, SHOTS, TECHNIQUES

Floats = npt.NDArray[np.float64]
Send = Callable[[topics.Topics, int], None]
Timed = tuple[int, Send]
"""A message: when [ns], and what sends it then."""

_TRAIL: Final = 0.45
"""Length of the trail of the shuttle [s]."""
_TRAIL_POINTS: Final = 16
_EVERY: Final = 2
"""Trail and states come with every second frame."""
_PATH_POINTS: Final = 32
_TRAIL_COLOUR: Final = (1.0, 0.85, 0.25)
_PATH: Final = colour(1.0, 1.0, 1.0, 0.35)
_TARGET: Final = colour(1.0, 0.80, 0.10, 0.30)
_LANDED: Final = (colour(0.95, 0.25, 0.20, 0.9), colour(0.20, 0.90, 0.35, 0.9))
_BOARD: Final = colour(0.97, 0.97, 0.97)
_ACTION: Final = colour(1.0, 0.88, 0.45)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Take:
    """One rally, staged, with its place in the scene.

    Attributes:
        story: what is told.
        motion: what is seen.
        start: when it begins [ns].
    """

    story: Story
    motion: Motion
    start: int

    def at(self, seconds: float) -> int:
        """An instant of the rally in the scene [ns]."""
        return self.start + round(seconds * SECOND)

    @property
    def end(self) -> int:
        """When its last frame is shown [ns]."""
        return self.at(float(self.motion.time[-1]))


def messages(take: Take) -> list[Timed]:
    """All messages of a rally in the order of time."""
    found = [*_transforms(take), *_trail(take), *_states(take), *_strokes(take), *_score(take)]
    return sorted(found, key=lambda timed: timed[0])


def _transforms(take: Take) -> Iterator[Timed]:
    poses = poses_of(take.motion)
    place, turn = poses.translation.tolist(), poses.rotation.tolist()
    for frame, seconds in enumerate(take.motion.time.tolist()):
        yield take.at(seconds), _Transforms(poses.child, poses.parent, place[frame], turn[frame])


@dataclasses.dataclass(frozen=True)
class _Transforms:
    child: tuple[str, ...]
    parent: tuple[str, ...]
    place: list[list[float]]
    turn: list[list[float]]

    def __call__(self, to: topics.Topics, time: int) -> None:
        when = stamp(time)
        rows = zip(self.child, self.parent, self.place, self.turn, strict=True)
        moved = [
            FrameTransform(
                timestamp=when,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=Vector3(x=x, y=y, z=z),
                rotation=Quaternion(x=i, y=j, z=k, w=w),
            )
            for child, parent, (x, y, z), (i, j, k, w) in rows
        ]
        to.tf.log(FrameTransforms(transforms=moved), log_time=time)


def _scene(topic: str, entities: Callable[[int], list[SceneEntity]]) -> Send:
    def send(to: topics.Topics, time: int) -> None:
        message: SceneUpdate = update(time, entities(time))
        to.scenes[topic].log(message, log_time=time)

    return send


def _json(topic: str, content: dict[str, Any]) -> Send:
    kept = {name: value for name, value in content.items() if value is not None}

    def send(to: topics.Topics, time: int) -> None:
        to.json[topic].log(kept, log_time=time)

    return send


def _log(words: str, name: str, level: LogLevel = LogLevel.Info) -> Send:
    def send(to: topics.Topics, time: int) -> None:
        to.log.log(Log(timestamp=stamp(time), level=level, message=words, name=name), log_time=time)

    return send


def _trail(take: Take) -> Iterator[Timed]:
    motion = take.motion
    back = max(1, round(_TRAIL * motion.fps / _TRAIL_POINTS))
    for frame in range(0, len(motion.time), _EVERY):
        rows = np.arange(max(frame - _TRAIL_POINTS * back, motion.contact_frame[0]), frame + 1)[::-1][::back][::-1]
        path = np.round(np.asarray(motion.shuttle[rows], dtype=np.float64), 3).astype(np.float64)
        # What no longer moves leaves no trail.
        shown = len(path) > 1 and float(np.ptp(path, axis=0).max()) > 0.05
        yield take.at(float(motion.time[frame])), _scene(topics.SHUTTLE, _Trail(path if shown else path[:0]))


@dataclasses.dataclass(frozen=True, eq=False)
class _Trail:
    path: Floats

    def __call__(self, time: int) -> list[SceneEntity]:
        if not len(self.path):
            return []
        fade = np.linspace(0.0, 0.95, len(self.path))
        line = LinePrimitive(
            type=LinePrimitiveLineType.LineStrip,
            pose=at((0, 0, 0)),
            thickness=3.0,
            scale_invariant=True,
            points=[point(p) for p in self.path],
            color=colour(*_TRAIL_COLOUR),
            colors=[colour(*_TRAIL_COLOUR, round(float(alpha), 2)) for alpha in fade],
        )
        return [SceneEntity(id="trail", timestamp=stamp(time), frame_id=WORLD, lines=[line])]


def _states(take: Take) -> Iterator[Timed]:
    motion, plan = take.motion, take.motion.plan
    hips = motion.position[:, :, 0, :2].astype(np.float64)
    speed = np.linalg.norm(np.gradient(hips, 1 / motion.fps, axis=0), axis=2)
    fast = np.linalg.norm(motion.shuttle_velocity, axis=1)
    flying = np.searchsorted(motion.contact_frame, np.arange(len(motion.time)), side="right") - 1
    for frame in range(0, len(motion.time), _EVERY):
        seconds, stroke = float(motion.time[frame]), int(flying[frame])
        over = seconds > float(plan.end_time[-1])
        phase = "before the serve" if stroke < 0 else "over" if over else f"{take.story.names[plan.rally.striker[stroke]]} struck"
        x, y, z = (round(float(v), 3) for v in motion.shuttle[frame])
        content: dict[str, Any] = {"phase": phase, "shuttle": {"x": x, "y": y, "z": z, "speed": round(float(fast[frame]), 2)}}
        for seat in (0, 1):
            px, py = (round(float(v), 3) for v in hips[frame, seat])
            content[f"player_{seat}"] = {"x": px, "y": py, "speed": round(float(speed[frame, seat]), 2)}
        yield take.at(seconds), _json(topics.STATE, content)


def _strokes(take: Take) -> Iterator[Timed]:
    story, plan = take.story, take.motion.plan
    yield take.at(0), _scene(topics.STROKE_MARKS, lambda _: [])
    for i, telling in enumerate(story.tellings):
        time = take.at(float(plan.time[i]))
        seat = int(plan.rally.striker[i])
        content = stroke_message(take, i)
        yield time, _scene(topics.STROKE_MARKS, _Marks(take, i))
        yield time, _json(topics.STROKE, content)
        yield time, _scene(topics.BOARD, _Board(score_line(story, after=False), _action(story, i)))
        yield time, _log(_sentence(content), story.names[seat])
        yield from ((time, send) for send in _numbers(story, seat, telling))
    over = take.at(float(plan.end_time[-1]))
    words = f"{story.names[story.winner]} wins the rally: {_ending(take)}"
    yield over, _log(words, "umpire")
    yield over, _scene(topics.BOARD, _Board(score_line(story, after=True), words))
    yield over, _scene(topics.STROKE_MARKS, _Landing(take))


def _numbers(story: Story, seat: int, telling: Telling) -> Iterator[Send]:
    if telling.rally_win is not None:
        yield _json(
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
        yield _json(topics.POLICY, {"seat": seat, "player": story.names[seat], "top": top, "shots": shots})


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
    yield start, _json(topics.SCORE, before)
    yield over, _json(topics.SCORE, {**before, **after, "winner": story.winner, "reason": story.reason})
    serves = f"{story.names[story.played.server]} serves"
    yield start, _scene(topics.BOARD, _Board(score_line(story, after=False), serves))
    yield start, _log(f"rally {story.number}: {score_line(story, after=False)}, {serves}", "umpire")
    strokes = [stroke_message(take, i) for i in range(len(story.tellings))]
    summary = {"rally": story.number, "winner": story.names[story.winner], "reason": story.reason, "strokes": strokes}
    yield start, _json(topics.SUMMARY, summary)
    first = story.tellings[0]
    if first.rally_win is not None:
        yield start, _json(topics.VALUE, {"rally_win_0": first.rally_win, "match_win_0": first.match_win})
        won = {"rally_win_0": float(story.winner == 0), "match_win_0": story.match_win_after}
        yield over, _json(topics.VALUE, won)


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
    return f"{name}: {shot} to {area}, {technique}\ngood {100 * told.p_succ:.0f} %, returned {100 * told.p_ret:.0f} %"


def _sentence(content: dict[str, Any]) -> str:
    chosen = f", chosen with {100 * content['probability']:.0f} %" if "probability" in content else ""
    return (
        f"#{content['number']} {content['shot']} to {content['area']} ({content['technique']}, {content['speed_kmh']:.0f} km/h"
        f"{chosen}): good {100 * content['p_succ']:.0f} %, returned {100 * content['p_ret']:.0f} %"
    )


def _ending(take: Take) -> str:
    plan = take.motion.plan
    shot = SHOTS[plan.rally.catalogue.shot[plan.rally.stroke[-1]]].replace("-", " ")
    return {"winner": f"{shot} is not returned", "out": f"{shot} lands out", "net": f"{shot} into the net"}[ENDS[plan.end[-1]]]


@dataclasses.dataclass(frozen=True)
class _Board:
    score: str
    words: str

    def __call__(self, time: int) -> list[SceneEntity]:
        lines = [text(self.score, (0, 0, 3.05), 0.32, _BOARD)]
        lines += [text(line, (0, 0, 2.66 - 0.30 * k), 0.22, _ACTION) for k, line in enumerate(self.words.split("\n"))]
        return [SceneEntity(id="board", timestamp=stamp(time), frame_id=WORLD, texts=lines)]


@dataclasses.dataclass(frozen=True, eq=False)
class _Marks:
    """The way that the shuttle will fly, and the area it is meant for."""

    take: Take
    stroke: int

    def __call__(self, time: int) -> list[SceneEntity]:
        plan, i = self.take.motion.plan, self.stroke
        path, _ = plan.flight.at(i, np.linspace(0, plan.end_time[i] - plan.time[i], _PATH_POINTS))
        line = LinePrimitive(
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
            SceneEntity(id="path", timestamp=stamp(time), frame_id=WORLD, lines=[line]),
            SceneEntity(id="target", timestamp=stamp(time), frame_id=WORLD, cubes=[target]),
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
        return [SceneEntity(id="landing", timestamp=stamp(time), frame_id=WORLD, cylinders=[disc])]


def _area_box(area: int, serve: bool) -> tuple[tuple[float, float], tuple[float, float]]:
    """Extent of an area across and along the court, in the striker's frame [m]."""
    depth, side = divmod(int(area), 3)
    across = ((-HALF_WIDTH, -SIDE_CUT), (-SIDE_CUT, SIDE_CUT), (SIDE_CUT, HALF_WIDTH))[side]
    along = ((0.0, MIDDLE_CUT), (MIDDLE_CUT, BACK_CUT), (BACK_CUT, HALF_LENGTH))[depth]
    if serve:
        along = (max(along[0], SHORT_SERVICE), along[1])
    return across, along
