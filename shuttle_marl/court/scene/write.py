"""Scene files: MCAP with the messages that Foxglove and Lichtblick show. ``docs/foxglove.md`` lists topics and schemas."""

import dataclasses
import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from foxglove import Channel, Context, channels, open_mcap
from foxglove import messages as fox
from foxglove.mcap import MCAPCompression, MCAPWriteOptions

from shuttle_marl import __version__
from shuttle_marl.base.arrays import F64, Floats
from shuttle_marl.base.errors import printable
from shuttle_marl.court import WatchError
from shuttle_marl.court.match import CourtRally
from shuttle_marl.court.recorded import LogRallies
from shuttle_marl.court.scene import shapes
from shuttle_marl.court.scene.shapes import SECOND, colour, entity, stamp
from shuttle_marl.court.staging import ENDS, Motion, stage
from shuttle_marl.court.staging.geometry import unit
from shuttle_marl.court.staging.skeleton import BONE
from shuttle_marl.game.court import AREA_WORDS, Hands
from shuttle_marl.game.pairs import seat_names
from shuttle_marl.game.rally import Rallies, waited_at
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve_recorded
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.reports import LogPlayers, RallyAnalysis, analyse_rally
from shuttle_marl.reports.rally import Resolve

EPOCH: Final = 1_735_689_600 * SECOND  # start of every scene, 2025-01-01: recorded rallies have no date, and viewers need one
LAYOUTS: Final = tuple(Path(__file__).parent / "layouts" / f"layout.{viewer}.json" for viewer in ("lichtblick", "foxglove"))
CUT: Final = SECOND // 1000  # time between two rallies [ns]: too short for a visible interpolation
_GRID: Final = 2.0**13  # numbers are rounded to 1/8192: 0.12 mm and 0.014 degrees, and compress to a third
_TOP: Final = 5  # number of strokes of a policy that are listed
_BOARD, _COLUMNS = (-4.878, -0.036, 4.041), 44  # centre of the scoreboard [m], beside the picture of both cameras; its width
_PATH, _TARGET, _WAITED = colour(1.0, 1.0, 1.0, 0.35), colour(1.0, 0.80, 0.10, 0.30), colour(1.0, 1.0, 1.0, 0.45)
_FAULT, _WON = colour(0.95, 0.25, 0.20, 0.9), colour(0.20, 0.90, 0.35, 0.9)

COURT: Final = "/scene/court"
PLAYERS: Final = "/scene/players"
STROKE_MARKS: Final = "/scene/stroke"
BOARD: Final = "/scene/board"
SCENES: Final = (COURT, PLAYERS, STROKE_MARKS, BOARD)  # topics of the 3D panel
TF: Final = "/tf"
SCORE: Final = "/rally/score"
STROKE: Final = "/rally/stroke"
SUMMARY: Final = "/rally/summary"


def _object(title: str, *fields: str, **nested: dict[str, Any]) -> dict[str, Any]:
    """JSON schema of an object; each of ``fields`` is a type and the names that have it."""
    properties = {name: {"type": kind} for kind, *names in map(str.split, fields) for name in names}
    return {"title": title, "type": "object", "properties": properties | nested}


_STROKE: Final = _object(
    "shuttle_marl.Stroke",
    "integer number seat",
    "string player stroke shot area technique end waited",
    "number p_succ p_ret probability estimate win_probability rally_win_0 match_win_0 speed_kmh",
    "boolean hurried",
    top={"type": "array", "items": _object("shuttle_marl.Option", "string stroke", "number probability win_probability")},
)
SCHEMAS: Final[dict[str, dict[str, Any]]] = {  # of the topics that plots and tables read
    SCORE: _object(
        "shuttle_marl.Score", "integer rally match points_0 points_1 games_0 games_1 server winner", "string name_0 name_1 reason"
    ),
    STROKE: _STROKE,
    SUMMARY: _object(
        "shuttle_marl.Summary", "integer rally", "string winner reason", strokes={"type": "array", "items": _STROKE}
    ),
}

Timed = tuple[int, str, Any]  # time [ns], topic and content of a message


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Shown:
    """A rally at its time in the scene; probabilities and values are NaN where a policy is not known."""

    game: Game
    rally: CourtRally
    row: Rallies  # the rally in the log
    analysis: RallyAnalysis
    motion: Motion
    start: int  # time of the first frame [ns]

    def at(self, seconds: float) -> int:
        """Time in the scene [ns] of a time in the rally [s]."""
        return self.start + round(seconds * SECOND)


def frames_of(motion: Motion) -> dict[str, F64]:
    """Frames of reference on the court by name: ``[F, 7]`` place [m] and quaternion (x, y, z, w) at each instant."""
    upright, floor = np.array([0.0, 0.0, 0.0, 1.0]), np.array([1, 1, 0])
    out = {
        shapes.SHUTTLE_FRAME: _joined(motion.shuttle, _heading(motion)),
        shapes.SHUTTLE_FLOOR: _joined(motion.shuttle * floor, upright),
    }
    for seat in (0, 1):
        out[shapes.place_frame(seat)] = _joined(motion.position[:, seat, 0] * floor, upright)
        for bone in shapes.DRAWN:
            out[shapes.bone_frame(seat, bone)] = _joined(
                *(part[:, seat, BONE[bone]] for part in (motion.position, motion.rotation))
            )
    return out


def _joined(place: Floats, turn: Floats) -> F64:
    joined = np.concatenate([place, np.broadcast_to(turn, (len(place), 4))], axis=1, dtype=np.float64)
    return np.rint(joined * _GRID) / _GRID


def _heading(motion: Motion) -> F64:
    """``[F, 4]`` rotation of the shuttle: the cork points forward, in the hand down; on the floor it lies."""
    velocity = motion.shuttle_velocity.astype(np.float64)
    flies = np.linalg.norm(velocity, axis=1) > 0.3
    flies[: motion.contact_frame[0]] = False
    # A shuttle that stops keeps its last direction.
    last = np.maximum.accumulate(np.where(flies, np.arange(len(flies)), -1))
    heading = np.where(last[:, None] < 0, np.array([0.0, 0.0, -1.0]), velocity[last])
    heading[:, 0] += 1e-6
    heading[round(float(motion.trajectory.end_time[-1]) * motion.fps) :, 2] = 0
    x, y, z = unit(heading).T
    return unit(np.stack([-y, x, np.zeros_like(z), 1 + z], axis=1))  # the shortest turn of the z axis


def _transforms(shown: Shown) -> Iterator[Timed]:
    frames = frames_of(shown.motion)
    for seconds, placed in zip(shown.motion.time.tolist(), np.stack(list(frames.values()), axis=1).tolist(), strict=True):
        time = shown.at(seconds)
        about: dict[str, Any] = {"timestamp": stamp(time), "parent_frame_id": shapes.WORLD}
        transforms = [
            fox.FrameTransform(child_frame_id=name, translation=shapes.vector(v[:3]), rotation=shapes.rotation(v[3:]), **about)
            for name, v in zip(frames, placed, strict=True)
        ]
        yield time, TF, fox.FrameTransforms(transforms=transforms)


def _entities(topic: str, time: int, entities: list[fox.SceneEntity]) -> Timed:
    """All entities of a topic of the 3D panel from a time on; earlier ones are deleted, so a seek finds all."""
    everything = fox.SceneEntityDeletion(timestamp=stamp(time), type=fox.SceneEntityDeletionType.All, id="")
    return time, topic, fox.SceneUpdate(deletions=[everything], entities=entities)


def _board(shown: Shown, time: int, points: Sequence[int], marked: int | None, lines: Iterable[str]) -> Timed:
    """The scoreboard: names with games and points, seat 0 first, ``>`` before the marked one, and two lines below them."""
    rally = shown.rally
    rows = [
        f"{'>' if seat == marked else ' '} {rally.names[seat]:<{_COLUMNS - 8}.{_COLUMNS - 8}}"
        f"{rally.games[seat]:>2} {points[seat]:>3}"
        for seat in (0, 1)
    ]
    text = shapes.label("\n".join(f"{row:<{_COLUMNS}}" for row in (*rows, *lines)), _BOARD, shapes.WHITE)
    return _entities(BOARD, time, [entity("board", time, texts=[text])])


def _commentary(shown: Shown) -> Iterator[Timed]:
    rally, trajectory = shown.rally, shown.motion.trajectory
    strokes = [stroke_message(shown, i) for i in range(len(rally))]
    winner, server = int(shown.row.winner[0]), rally.names[rally.server]
    start, over = shown.start, shown.at(float(trajectory.end_time[-1]))
    before = {
        "rally": rally.number,
        "match": int(shown.row.match[0]),
        **{f"name_{seat}": name for seat, name in enumerate(rally.names)},
        **{f"points_{seat}": points for seat, points in enumerate(rally.points)},
        **{f"games_{seat}": games for seat, games in enumerate(rally.games)},
        "server": rally.server,
    }
    yield start, SCORE, before
    serves = f"{server} serves from the {'right' if rally.from_right else 'left'}"
    yield _board(shown, start, rally.points, rally.server, (serves, rally.score.break_before))
    reason = OUTCOMES[rally.ending]
    yield start, SUMMARY, {"rally": rally.number, "winner": rally.names[winner], "reason": reason, "strokes": strokes}
    yield _entities(STROKE_MARKS, start, [])
    for i, content in enumerate(strokes):
        time = shown.at(float(trajectory.time[i]))
        yield _entities(STROKE_MARKS, time, _flight(shown, i, time))
        yield time, STROKE, content
        chosen = [f"chosen {percent(content['probability'])}"] if "probability" in content else []
        odds = [f"good {percent(content['p_succ'])}", f"returned {percent(content['p_ret'])}", *chosen]
        said = f"{content['shot'].replace('-', ' ')} to {content['area']}, {content['technique'].replace('-', ' ')}"
        yield _board(shown, time, rally.points, content["seat"], (said, ", ".join(odds)))
    points = [rally.points[seat] + (seat == winner) for seat in (0, 1)]
    ends = {"winner": "is not returned", "out": "lands out", "net": "into the net"}
    how = f"{strokes[-1]['shot'].replace('-', ' ')} {ends[strokes[-1]['end']]}"
    yield _board(shown, over, points, None, (f"{rally.names[winner]} wins the rally:", how))
    yield over, SCORE, {**before, "points_0": points[0], "points_1": points[1], "winner": winner, "reason": reason}
    # Where the last shuttle landed: green for a winner, red for a fault.
    landed = _spot(trajectory.end_point[-1], 0.30, _WON if strokes[-1]["end"] == "winner" else _FAULT)
    yield _entities(STROKE_MARKS, over, [entity("landing", over, cylinders=[landed])])


def stroke_message(shown: Shown, i: int) -> dict[str, Any]:
    """Content of ``/rally/stroke`` for the i-th stroke, without entries that are None or NaN."""
    game, rally, row, trajectory = shown.game, shown.rally, shown.row, shown.motion.trajectory
    decision, rank = shown.analysis.decisions[i], shown.analysis.rank[i]
    catalogue, stroke, seat = rally.catalogue, int(rally.stroke[i]), decision.seat
    waited, p, win = waited_at(rally, game, i, decision.state), decision.probability, decision.win
    logged = math.nan if row.log_probability is None else math.exp(row.log_probability[i])
    likeliest = np.argsort(-p, kind="stable")[:_TOP].tolist() if np.isfinite([*p, *win]).all() else []
    content = {
        "number": i + 1,
        "seat": seat,
        "player": rally.names[seat],
        "stroke": catalogue.names[stroke],
        "shot": SHOTS[catalogue.shot[stroke]],
        "area": AREA_WORDS[rally.target(seat, stroke)],
        "technique": TECHNIQUES[catalogue.technique[stroke]],
        "hurried": bool(rally.hurried[i]),
        "p_succ": float(decision.p_succ[rank]),
        "p_ret": float(decision.p_ret[rank]),
        "probability": logged if math.isnan(p[rank]) else float(p[rank]),
        "win_probability": float(win[rank]),
        "top": [
            {"stroke": game.catalogue.names[decision.stroke[k]], "probability": float(p[k]), "win_probability": float(win[k])}
            for k in likeliest
        ],
        "rally_win_0": float(shown.analysis.rally_win[i]),
        "match_win_0": float(shown.analysis.match_win[i]),
        "estimate": None if row.value is None else float(row.value[i]),
        "speed_kmh": round(3.6 * float(trajectory.flight.launch_speed[i]), 1),
        "end": ENDS[trajectory.end[i]],
        "waited": None if waited is None else POSITIONS[waited],
    }
    return {name: value for name, value in content.items() if value is not None and value == value}  # noqa: PLR0124  NaN


def percent(probability: float) -> str:
    """A probability as an integer percentage; 0 % means impossible and 100 % certain."""
    if 0 < probability < 0.005:
        return "under 1 %"
    if 0.995 < probability < 1:
        return "over 99 %"
    return f"{100 * probability:.0f} %"


def _spot(place: Floats, width: float, shade: fox.Color) -> fox.CylinderPrimitive:
    return shapes.disc(shapes.pose((place[0], place[1], 0.008)), (width, width, 0.006), shade)


def _flight(shown: Shown, i: int, time: int) -> list[fox.SceneEntity]:
    rally, trajectory = shown.rally, shown.motion.trajectory
    path, _ = trajectory.flight.at(i, np.linspace(0, trajectory.end_time[i] - trajectory.time[i], 32))
    seat = int(rally.striker[i])
    sign = rally.facing(seat)
    (x0, x1), (y0, y1) = rally.aim_box(seat, int(rally.stroke[i]))
    target = shapes.box((sign * (x0 + x1) / 2, sign * (y0 + y1) / 2, 0.006), (x1 - x0, y1 - y0, 0.004), _TARGET)
    flown = shapes.line("LineStrip", np.round(path, 3), 2.0, _PATH)
    marks = [entity("path", time, lines=[flown]), entity("target", time, cubes=[target])]
    if waited_at(rally, shown.game, i, shown.analysis.decisions[i].state) is not None:
        marks.append(entity("waited", time, cylinders=[_spot(-sign * trajectory.base[i, 1 - seat], 0.9, _WAITED)]))
    return marks


def select(log: RallyLog, *, rally: int | None = None, match: int | None = None, pairing: int = 0) -> list[int]:
    """Numbers of the rallies of a scene, in their order: one rally, all of a match, or by default the longest of the log;
    ``pairing``: number of the pairing of the match. Raises WatchError: both rally and match; or the log has no such match or
    rally. Raises RecordingError: the log is damaged."""
    if rally is not None and match is not None:
        raise WatchError("expected one of --rally NUMBER, --match NUMBER")
    if rally is not None:
        return [rally]
    if match is not None:
        numbers = [number for number in log.numbers_of_match(pairing, match).tolist() if log.rally(number).finished[0]]
        if not numbers:
            raise WatchError(f"{log.path}: no match {match} of pairing {pairing}; see `info` for how many pairings there are")
        return numbers
    length, longest = 0, -1
    for first, rallies in log.batches():
        lengths = rallies.length * rallies.finished
        if lengths.max() > length:
            length, longest = lengths.max(), first + int(lengths.argmax())
    if longest < 0:
        raise WatchError(f"{log.path}: no rally that came to its end")
    return [longest]


def write_scene(
    log: RallyLog,
    numbers: Sequence[int],
    game: Game,
    *,
    hands: Hands | None = None,
    athletes: tuple[str, str] | None = None,
    resolve: Resolve = resolve_recorded,
    progress: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> tuple[bytes, dict[str, str]]:
    """Write rallies of a log, one after the other, as the bytes of an MCAP file.

    Args:
        numbers: numbers of the rallies in the log, at least one.
        hands: ``right`` or ``left``, of seats 0 and 1; None: those of the players.
        athletes: ``male`` or ``female``, of seats 0 and 1; None: as the players are.
        resolve: resolves the policies that the log names; by default no modules and no files, because logs are untrusted.
        progress: wraps the numbers, for a progress bar.

    Returns:
        The file, and by the names of unknown policies the reasons; the scene leaves out their probabilities.

    Raises:
        RecordingError: the log has no such rally, is damaged, or was played on another game.
        RallyError: the strokes of a rally do not form one.
        StagingError: an unknown option of the staging.
        WatchError: a rally was cut off, or a stroke is not legal in the game.
    """
    rallies, policies = LogRallies(log, game), LogPlayers(log, game, resolve)
    context, buffer = Context(), io.BytesIO()
    options = MCAPWriteOptions(profile="", compression=MCAPCompression.Zstd, chunk_size=1 << 20, compression_threads=0)
    writer = open_mcap(buffer, context=context, writer_options=options)
    topics: dict[str, Any] = {topic: channels.SceneUpdateChannel(topic, context=context) for topic in SCENES}
    topics[TF] = channels.FrameTransformsChannel(TF, context=context)
    topics |= {topic: Channel(topic, schema=schema, context=context) for topic, schema in SCHEMAS.items()}
    start, drawn, seated = EPOCH, None, set[int]()
    topics[COURT].log(_entities(COURT, start, shapes.court(start))[2], log_time=start)
    for number in map(int, progress(numbers)):
        rally, row = rallies.rally(number), log.rally(number)
        rally = dataclasses.replace(
            rally, names=seat_names(game, rally.names), hands=hands or rally.hands, athletes=athletes or rally.athletes
        )
        analysis = analyse_rally(rally, game, policies.of_rally(number), rules=rally.score.rules)
        motion = stage(rally, seed=rally.key, athletes=rally.athletes)
        shown = Shown(game=game, rally=rally, row=row, analysis=analysis, motion=motion, start=start)
        messages = [*_transforms(shown), *_commentary(shown)]
        if drawn != (drawn := (rally.names, motion.hands, motion.skeletons)):
            messages.append(_entities(PLAYERS, start, shapes.players(start, motion, rally.names)))
        for time, topic, message in sorted(messages, key=lambda timed: timed[0]):
            topics[topic].log(message, log_time=time)
        start = shown.at(float(motion.time[-1])) + CUT
        seated |= set(row.policy[0].tolist())
    for path in LAYOUTS:
        writer.attach(log_time=EPOCH, create_time=EPOCH, name=path.name, media_type="application/json", data=path.read_bytes())
    # Origin of the rallies: log, seeds, game and policies.
    facts = {
        "software": f"shuttle_marl {__version__}",
        "log": printable(log.path.name),
        "rallies": " ".join(str(int(number)) for number in numbers),
        "game": game.hash,
        "seeds": " ".join(dict.fromkeys(str(file.header.seed) for file in log.files)),
        "policies": json.dumps({log.policies[i].name: log.policies[i].hash for i in sorted(seated)}),
    }
    writer.write_metadata("shuttle_marl.court.scene", facts)
    writer.close()
    return buffer.getvalue(), policies.unknown
