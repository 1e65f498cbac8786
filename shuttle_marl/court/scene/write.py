"""Scene files: MCAP with the messages that Foxglove and Lichtblick show, and the comments on the strokes."""

import dataclasses
import io
import json
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from foxglove import Context, open_mcap
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from foxglove.messages import FrameTransform, FrameTransforms, Quaternion, SceneEntity

from shuttle_marl import __version__
from shuttle_marl.base.arrays import F64, I64, Floats, Intp
from shuttle_marl.base.errors import printable
from shuttle_marl.court.match import staging_key
from shuttle_marl.court.scene import SceneError, topics
from shuttle_marl.court.scene.topics import SECOND, Timed, at, bone_frame, colour, disc, entities_on, entity, log_line, numbers_on
from shuttle_marl.court.staging import ENDS, Motion, stage
from shuttle_marl.court.staging.geometry import cross, quaternion, unit
from shuttle_marl.court.staging.skeleton import BONE
from shuttle_marl.game.court import AREA_WORDS, Hands
from shuttle_marl.game.layout import LONGEST_DUEL
from shuttle_marl.game.pairs import looks_of, seat_names
from shuttle_marl.game.rally import Rally, waited_at
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.rules import OUTCOMES, REASONS, IllegalStrokeError
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve_recorded
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.reports import LogPlayers, RallyAnalysis, analyse_rally
from shuttle_marl.reports.rally import Resolve

EPOCH: Final = 1_735_689_600 * SECOND  # start of every scene, 2025-01-01: recorded rallies have no date, and viewers need one
MOST_FPS: Final = 50
LAYOUTS: Final = tuple(  # of the panels, for a rally (``layout``) and a match; attached to every scene
    Path(__file__).parent / "layouts" / f"{scope}.{viewer}.json"
    for scope in ("layout", "match")
    for viewer in ("lichtblick", "foxglove")
)
CUT: Final = SECOND // 1000  # time between two rallies [ns]: too short for a visible interpolation
_COLUMNS, _LEAST_ROWS = 28, 7  # characters in a line of the board, and its rows, so that its height is the same at every stroke
_GRID: Final = 2.0**13  # numbers are rounded to 1/8192: 0.12 mm and 0.014 degrees, and compress to a third
_TOLERANCE: Final = 0.006  # distance of a transform from the interpolated one below which it is left out [m or half radians]
_PACKET: Final = 1.0  # time covered by one message of transforms [s]
_TRAIL, _TRAIL_STEP = 0.48, 0.08  # length of the trail of the shuttle, and time between its points [s]
_TOP: Final = 5  # number of strokes of a policy that are listed
_PATH, _TARGET = colour(1.0, 1.0, 1.0, 0.35), colour(1.0, 0.80, 0.10, 0.30)
_WAITED: Final = colour(1.0, 1.0, 1.0, 0.45)
_FAULT, _WON = colour(0.95, 0.25, 0.20, 0.9), colour(0.20, 0.90, 0.35, 0.9)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class RallyReport:
    """A rally of a log."""

    number: int
    names: tuple[str, str]  # printable, of seats 0 and 1
    game: Game
    played: Rally
    winner: int
    reason: str  # outcome of the last stroke, in words
    before: str  # interval or change of ends before the rally, in words; empty: neither
    analysis: RallyAnalysis  # values of the strokes; NaN where a policy is not known
    key: int  # random seed of the staging
    athletes: tuple[str, str]
    logged: F64  # [2, T] in a log of training, else NaN: probability of each stroke, and estimate of the state, -1 to 1

    @property
    def points_after(self) -> tuple[int, int]:
        """Points of seats 0 and 1 after the rally, before a new game begins."""
        return self.played.points[0] + (self.winner == 0), self.played.points[1] + (self.winner == 1)

    @property
    def in_match(self) -> bool:
        """Whether the rally belongs to a match, as far as its score tells."""
        return bool(self.played.match or any(self.played.games) or any(self.played.points))

    def wins(self, stroke: int) -> dict[str, float]:
        """Probabilities that seat 0 wins rally and match before a stroke; -1: after the rally."""
        return {"rally_win_0": float(self.analysis.rally_win[stroke]), "match_win_0": float(self.analysis.match_win[stroke])}

    def waited(self, stroke: int) -> int | None:
        """Position that the receiver of a stroke chose; None: they had no choice, or the log has none."""
        return waited_at(self.played, self.game, stroke, self.analysis.decisions[stroke].state)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StagedRally:
    """A staged rally at its time in the scene."""

    report: RallyReport
    motion: Motion
    start: int  # time of the first frame [ns]

    def at(self, seconds: float) -> int:
        """Time in the scene [ns] of a time in the rally [s]."""
        return self.start + round(seconds * SECOND)


def report_rally(log: RallyLog, number: int, game: Game, players: LogPlayers, hands: Hands | None = None) -> RallyReport:
    """Report of one rally; ``hands``: None: those of the players.

    Raises:
        RecordingError: the log has no such rally, or is damaged.
        RallyError: the strokes do not form a rally.
        SceneError: a stroke is not legal in this game.
    """
    row = log.rally(number)
    if not row.finished[0]:
        raise SceneError(f"rally {number} was cut off ({REASONS[row.reason[0]]}), so there is no end to show; choose another")
    header = log.files[log.file_of(number)].header
    first, second = (log.policies[int(policy)].name for policy in row.policy[0])
    looks = looks_of(game, (first, second))
    played = row.row(0, log.catalogue, header.rules, hands or looks.hands).checked()
    try:
        analysis = analyse_rally(played, game, players.of_rally(number), rules=header.rules)
    except IllegalStrokeError as error:
        raise SceneError(f"rally {number}: {error}") from error
    chosen = None if row.log_probability is None else np.exp(row.log_probability.astype(np.float64))
    return RallyReport(
        number=number,
        names=seat_names(game, (printable(first), printable(second))),
        game=game,
        played=played,
        winner=int(row.winner[0]),
        reason=OUTCOMES[played.ending],
        before=Score(points=played.points, games=played.games, server=played.server, rules=header.rules).break_before,
        analysis=analysis,
        key=staging_key(header, row),
        athletes=looks.athletes,
        logged=np.stack([np.full(len(played), np.nan) if part is None else part for part in (chosen, row.value)]),
    )


def boards(report: RallyReport, time: int, text: str, *, after: bool = False, marked: int | None = None) -> list[Timed]:
    """Scoreboards of all cameras: names with games and points, seat 0 first, and text below them, which is wrapped.

    ``after``: the points are those after the rally; ``marked``: seat that serves or strikes.
    """
    points = report.points_after if after else report.played.points
    rows = []
    for seat in (0, 1):
        games = f"{report.played.games[seat]:>2}" if report.in_match else "  "
        first, *others = topics.name_lines(report.names[seat], _COLUMNS - 8)
        rows += [
            f"{'>' if seat == marked else ' '} {first:<{_COLUMNS - 8}}{games} {points[seat]:>3}",
            *(f"  {line}" for line in others),
        ]
    rows.append("")
    for line in text.split("\n"):
        rows += textwrap.wrap(line, _COLUMNS)
    rows += [""] * (_LEAST_ROWS - len(rows))
    block = "\n".join(row.ljust(_COLUMNS) for row in rows)
    shade = colour(0.97, 0.97, 0.97)
    return [
        entities_on(topic, time, [entity("board", time, where, fixed=True, texts=[topics.label(block, place, 16, shade)])])
        for topic, (where, place) in topics.BOARDS.items()
    ]


def _transforms(staged: StagedRally) -> Iterator[Timed]:
    """Transforms of all frames of reference, one message for each :data:`_PACKET`: one message is enough after a seek."""
    motion = staged.motion
    last, length = len(motion.time) - 1, round(_PACKET * motion.fps)
    when = [topics.stamp(staged.at(seconds)) for seconds in motion.time.tolist()]
    frames = {name: (values, _needed(values, motion.contact_frame, length)) for name, values in frames_of(motion).items()}
    for first in range(0, last, length):
        until, transforms = min(first + length, last), []
        for name, (values, needed) in frames.items():
            chosen = needed[(needed >= first) & (needed <= until)]
            if until < last and (values[chosen] == values[first]).all():
                chosen = chosen[:1]  # enough for a frame at rest, unless the rally ends here
            for i, (x, y, z, *q) in zip(chosen.tolist(), values[chosen].tolist(), strict=True):
                about: dict[str, Any] = {"timestamp": when[i], "parent_frame_id": topics.WORLD, "child_frame_id": name}
                turn = Quaternion(x=q[0], y=q[1], z=q[2], w=q[3])
                transforms.append(FrameTransform(**about, translation=topics.vector((x, y, z)), rotation=turn))
        yield staged.at(float(motion.time[first])), topics.TF, FrameTransforms(transforms=transforms)


def _needed(values: F64, exact: I64, packet: int) -> Intp:
    """Instants that are written: viewers interpolate between them. Halves of eighths of the frames, where they are needed."""
    chosen = np.zeros(len(values), dtype=np.bool_)
    chosen[::8] = chosen[::packet] = chosen[exact] = chosen[-1] = True
    for half in (4, 2, 1):
        between = np.arange(half, len(values) - half, 2 * half)
        off = np.abs(values[between] - (values[between - half] + values[between + half]) / 2).max(axis=1)
        chosen[between] |= off > _TOLERANCE
    return np.flatnonzero(chosen)


def frames_of(motion: Motion) -> dict[str, F64]:
    """Frames of reference on the court by name: ``[F, 7]`` place [m] and quaternion (x, y, z, w) at each instant."""
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    half_turn = np.array([0.0, 0.0, 1.0, 0.0]) if motion.trajectory.rally.ends_changed else upright
    out = {topics.SHUTTLE_FRAME: _joined(motion.shuttle, _heading(motion))}
    out[topics.SHUTTLE_FLOOR] = _joined(motion.shuttle * [1, 1, 0], upright)
    for seat in (0, 1):
        out[topics.place_frame(seat)] = _joined(motion.position[:, seat, 0] * [1, 1, 0], half_turn)
        for bone in topics.DRAWN:
            out[bone_frame(seat, bone)] = _joined(*(part[:, seat, BONE[bone]] for part in (motion.position, motion.rotation)))
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
    heading = np.where(last[:, None] < 0, np.array([0.0, 0.0, -1.0]), unit(velocity[last]))
    ended = round(float(motion.trajectory.end_time[-1]) * motion.fps)
    heading[ended:] = unit(heading[ended:] * [1, 1, 0] + [1e-6, 0, 0])
    up = np.where(np.abs(heading[:, 2:]) < 0.95, np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0]]))
    x = unit(cross(up, heading))
    return quaternion(np.stack([x, cross(heading, x), heading], axis=-1))


def _trail(staged: StagedRally) -> Iterator[Timed]:
    motion, contacts = staged.motion, staged.motion.contact_frame
    step, length = max(1, round(_TRAIL_STEP * motion.fps)), round(_TRAIL * motion.fps)
    was_visible = True
    for frame in range(len(motion.time)):
        time = staged.at(float(motion.time[frame]))
        first = max(frame - length, int(contacts[0]))
        rows = np.union1d(np.arange(frame, first - 1, -step), contacts[(contacts >= first) & (contacts <= frame)])
        path = motion.shuttle[rows].astype(np.float64)
        # A shuttle at rest has no trail.
        visible = len(path) > 1 and float(np.ptp(path, axis=0).max()) > 0.05
        if visible:
            fade = np.round(0.95 * np.clip(1 - (frame - rows) / length, 0, 1), 2)
            line = topics.strip(path, [topics.colour(1.0, 0.85, 0.25, alpha) for alpha in fade.tolist()], 3.0)
            yield entities_on(topics.SHUTTLE, time, [topics.entity("trail", time, lines=[line])])
        elif was_visible:
            yield entities_on(topics.SHUTTLE, time, [])
        was_visible = visible


def _states(staged: StagedRally) -> Iterator[Timed]:
    report, motion, trajectory = staged.report, staged.motion, staged.motion.trajectory
    hips = motion.position[:, :, 0, :2].astype(np.float64)
    speed = np.linalg.norm(np.gradient(hips, 1 / motion.fps, axis=0), axis=2)
    shuttle_speed = np.linalg.norm(motion.shuttle_velocity, axis=1)
    last_stroke = np.searchsorted(motion.contact_frame, np.arange(len(motion.time)), side="right") - 1
    # Every second frame, and the last one, so that the recording is as long as the motion.
    for frame in [*range(0, len(motion.time) - 1, 2), len(motion.time) - 1]:
        seconds, stroke = float(motion.time[frame]), int(last_stroke[frame])
        if stroke < 0:
            phase = "before the serve"
        elif seconds > float(trajectory.end_time[-1]):
            phase = "over"
        else:
            phase = f"{report.names[report.played.striker[stroke]]} struck"
        x, y, z = (round(float(v), 3) for v in motion.shuttle[frame])
        shuttle_state = {"x": x, "y": y, "z": z, "speed": round(float(shuttle_speed[frame]), 2)}
        content: dict[str, Any] = {"phase": phase, "shuttle": shuttle_state}
        for seat in (0, 1):
            px, py = (round(float(v), 3) for v in hips[frame, seat])
            content[f"player_{seat}"] = {"x": px, "y": py, "speed": round(float(speed[frame, seat]), 2)}
        yield numbers_on(topics.STATE, staged.at(seconds), content)


def commentary(staged: StagedRally) -> Iterator[Timed]:
    """Messages that comment on a rally, not ordered by time."""
    report, trajectory = staged.report, staged.motion.trajectory
    strokes = [stroke_message(staged, i) for i in range(len(report.played))]
    yield entities_on(topics.STROKE_MARKS, staged.at(0), [])
    for i, content in enumerate(strokes):
        time, seat = staged.at(float(trajectory.time[i])), int(content["seat"])
        yield entities_on(topics.STROKE_MARKS, time, _flight(staged, i, time))
        yield numbers_on(topics.STROKE, time, content)
        yield from boards(report, time, _action(content), marked=seat)
        chosen = f", chosen with {percent(content['probability'])}" if "probability" in content else ""
        sentence = (
            f"#{i + 1} {content['shot']} to {content['area']} ({content['technique']}"
            f"{chosen}): good {percent(content['p_succ'])}, returned {percent(content['p_ret'])}"
        )
        if "waited" in content:
            sentence += f"; {report.names[1 - seat]} waits {content['waited']}"
        yield log_line(time, sentence, report.names[seat])
        yield from _probabilities(report, i, time)
    over = staged.at(float(trajectory.end_time[-1]))
    result = f"{report.names[report.winner]} wins the rally: {_ending(staged)}"
    yield log_line(over, result, "umpire")
    yield from boards(report, over, result, after=True)
    # Where the last shuttle landed: green for a winner, red for a fault.
    x, y, _ = trajectory.end_point[-1]
    landed = disc(0.30, 0.30, 0.006, at((x, y, 0.008)), _WON if ENDS[trajectory.end[-1]] == "winner" else _FAULT)
    yield entities_on(topics.STROKE_MARKS, over, [entity("landing", over, cylinders=[landed])])
    yield from _score(staged, strokes)


def _probabilities(report: RallyReport, i: int, time: int) -> Iterator[Timed]:
    decision, rank = report.analysis.decisions[i], report.analysis.rank[i]
    values_known = bool(np.isfinite(decision.value))
    if values_known:
        values = {"striker": decision.value, "chosen": float(decision.win[rank])}
        yield numbers_on(topics.VALUE, time, {**report.wins(i), **values})
    if np.isfinite(decision.probability).all():
        catalogue, p = report.game.catalogue, decision.probability
        by_shot = np.bincount(catalogue.shot[decision.stroke], weights=p, minlength=len(SHOTS)).tolist()
        top = [
            {
                "stroke": catalogue.names[decision.stroke[k]],
                "probability": round(float(p[k]), 4),
                "win_probability": round(float(decision.win[k]), 4),
            }
            for k in (np.argsort(-p, kind="stable")[:_TOP] if values_known else ())
        ]
        shots = {shot.replace("-", "_"): share for shot, share in zip(SHOTS, by_shot, strict=True)}
        about = {"seat": decision.seat, "player": report.names[decision.seat]}
        yield numbers_on(topics.POLICY, time, {**about, "top": top, "shots": shots})


def stroke_message(staged: StagedRally, i: int) -> dict[str, Any]:
    """Content of ``/rally/stroke`` for the i-th stroke."""
    report, trajectory = staged.report, staged.motion.trajectory
    decision, rank = report.analysis.decisions[i], report.analysis.rank[i]
    catalogue, stroke, seat = report.played.catalogue, int(report.played.stroke[i]), decision.seat
    game, state, waited = report.game, decision.state, report.waited(i)
    chosen, estimate = report.logged[:, i].tolist()
    content = {
        "number": i + 1,
        "seat": seat,
        "player": report.names[seat],
        "stroke": catalogue.names[stroke],
        "shot": SHOTS[catalogue.shot[stroke]],
        "area": AREA_WORDS[report.played.target(seat, stroke)],
        "height": HEIGHTS[catalogue.height[stroke]],
        "technique": TECHNIQUES[catalogue.technique[stroke]],
        "p_succ": float(decision.p_succ[rank]),
        "p_ret": float(decision.p_ret[rank]),
        "probability": chosen if np.isnan(decision.probability[rank]) else float(decision.probability[rank]),
        "estimate": estimate,
        "win_probability": float(decision.win[rank]),
        "hurried": bool(report.played.hurried[i]),
        "effort": int(game.effort(state)) if game.levels > 1 else None,
        "opponent_effort": int(game.opponent_effort(state)) if game.levels > 1 else None,
        "duel": int(game.duel(state)) if game.counts_duels else None,
        "contact_height": round(float(trajectory.contact[i, 2]), 3),
        "speed_kmh": round(3.6 * float(trajectory.flight.launch_speed[i]), 1),
        "flight_time": round(float(trajectory.end_time[i] - trajectory.time[i]), 3),
        "end": ENDS[trajectory.end[i]],
        "waited": None if waited is None else POSITIONS[waited],
    }
    return topics.known(content)


def _score(staged: StagedRally, strokes: list[dict[str, Any]]) -> Iterator[Timed]:
    report, played = staged.report, staged.report.played
    start, over = staged.at(0), staged.at(float(staged.motion.trajectory.end_time[-1]))
    before = {
        "rally": report.number,
        "match": played.match,
        **{f"name_{seat}": name for seat, name in enumerate(report.names)},
        **{f"points_{seat}": points for seat, points in enumerate(played.points)},
        **{f"games_{seat}": games for seat, games in enumerate(played.games)},
        "server": played.server,
    }
    after = {f"points_{seat}": points for seat, points in enumerate(report.points_after)}
    yield numbers_on(topics.SCORE, start, before)
    yield numbers_on(topics.SCORE, over, {**before, **after, "winner": report.winner, "reason": report.reason})
    serves = f"{report.names[played.server]} serves from the {'right' if played.from_right else 'left'}"
    yield from boards(report, start, "\n".join(filter(None, (report.before, serves))), marked=played.server)
    won = f"   games {played.games[0]}-{played.games[1]}" if report.in_match else ""
    score = f"{report.names[0]}  {played.points[0]} - {played.points[1]}  {report.names[1]}{won}"
    if report.before:
        yield log_line(start, report.before, "umpire")
    yield log_line(start, f"rally {report.number}: {score}, {serves}", "umpire")
    summary = {"rally": report.number, "winner": report.names[report.winner], "reason": report.reason, "strokes": strokes}
    yield numbers_on(topics.SUMMARY, start, summary)
    if np.isfinite(report.analysis.rally_win[0]):
        yield numbers_on(topics.VALUE, start, report.wins(0))
        yield numbers_on(topics.VALUE, over, report.wins(-1))


def _action(stroke: dict[str, Any]) -> str:
    shot, technique = (stroke[name].replace("-", " ") for name in ("shot", "technique"))
    lines = [f"{shot} to {stroke['area']}, {technique}"]
    lines.append(f"good {percent(stroke['p_succ'])}, returned {percent(stroke['p_ret'])}")
    if stroke["hurried"]:
        lines.append("hurried")
    if "effort" in stroke:
        efforts = stroke["effort"], stroke["opponent_effort"]
        lines.append(f"effort {efforts[stroke['seat']]} - {efforts[1 - stroke['seat']]}")
    if (duel := stroke.get("duel", 0)) > 1:
        lines.append(f"{duel}{' or more' if duel == LONGEST_DUEL else ''} net shots in a row")
    return "\n".join(lines)


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
    ends = {"winner": "is not returned", "out": "lands out", "net": "into the net"}
    return f"{shot} {ends[ENDS[staged.motion.trajectory.end[-1]]]}"


def _flight(staged: StagedRally, i: int, time: int) -> list[SceneEntity]:
    played, trajectory = staged.report.played, staged.motion.trajectory
    path, _ = trajectory.flight.at(i, np.linspace(0, trajectory.end_time[i] - trajectory.time[i], 32))
    seat = int(played.striker[i])
    sign = played.facing(seat)
    (x0, x1), (y0, y1) = played.aim_box(seat, int(played.stroke[i]))
    target = topics.box((sign * (x0 + x1) / 2, sign * (y0 + y1) / 2, 0.006), (x1 - x0, y1 - y0, 0.004), _TARGET)
    marks = [entity("path", time, lines=[topics.strip(path, [_PATH], 1.5)]), entity("target", time, cubes=[target])]
    if staged.report.waited(i) is not None:
        x, y = -sign * trajectory.base[i, 1 - seat]
        marks.append(entity("waited", time, cylinders=[disc(0.9, 0.9, 0.006, at((x, y, 0.008)), _WAITED)]))
    return marks


def select(
    log: RallyLog, *, rally: int | None = None, match: int | None = None, pairing: int = 0, best: int | None = None
) -> list[int]:
    """Numbers of the rallies of a scene, in their order.

    Args:
        match: number of a match: all its rallies.
        pairing: number of the pairing of the match.
        best: number of rallies: the longest of the log, the longest last. The default is the longest.

    Raises:
        SceneError: more than one of rally, match and best; or the log has no such match or rally.
        RecordingError: the log is damaged.
    """
    if sum(choice is not None for choice in (rally, match, best)) > 1:
        raise SceneError("expected one of --rally NUMBER, --match NUMBER, --best COUNT")
    if rally is not None:
        return [rally]
    if match is not None:
        numbers = [number for number in log.numbers_of_match(pairing, match).tolist() if log.rally(number).finished[0]]
        if not numbers:
            raise SceneError(f"{log.path}: no match {match} of pairing {pairing}; see `info` for how many pairings there are")
        return numbers
    best = 1 if best is None else best
    if best < 1:
        raise SceneError(f"--best {best}: expected 1 or more")
    found: list[tuple[int, int]] = []
    for first, rallies in log.batches():
        longest = np.argsort(-rallies.length * rallies.finished, kind="stable")[:best]
        found += [(int(rallies.length[row]), first + int(row)) for row in longest if rallies.finished[row]]
        found = sorted(found, key=lambda entry: (-entry[0], entry[1]))[:best]
    if not found:
        raise SceneError(f"{log.path}: no rally that came to its end")
    return [number for _, number in reversed(found)]


def write_scene(
    log: RallyLog,
    numbers: Sequence[int],
    game: Game,
    *,
    hands: Hands | None = None,
    athletes: tuple[str, str] | None = None,
    fps: int = 50,
    resolve: Resolve = resolve_recorded,
    progress: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> tuple[bytes, dict[str, str]]:
    """Write rallies of a log, one after the other, as the bytes of an MCAP file.

    Args:
        numbers: numbers of the rallies in the log, at least one.
        hands: ``right`` or ``left``, of seats 0 and 1; None: those of the players.
        athletes: ``male`` or ``female``, of seats 0 and 1; None: as the players are.
        fps: frames per second, 25 to 50; viewers warn about more.
        resolve: resolves the policies that the log names; by default no modules and no files, because logs are untrusted.
        progress: wraps the numbers, for a progress bar.

    Returns:
        The file, and by the names of unknown policies the reasons; the scene leaves out their probabilities.

    Raises:
        RecordingError: the log has no such rally, is damaged, or was played on another game.
        RallyError: the strokes of a rally do not form one.
        SceneError: a stroke is not legal in the game, or the frame rate is out of range.
        StagingError: an unknown option of the staging.
    """
    if not 25 <= fps <= MOST_FPS:
        raise SceneError(f"{fps} frames per second: expected 25 to {MOST_FPS}; viewers warn about more")
    policies = LogPlayers(log, game, resolve)
    context, buffer = Context(), io.BytesIO()
    options = MCAPWriteOptions(profile="", compression=MCAPCompression.Zstd, chunk_size=1 << 20, compression_threads=0)
    writer = open_mcap(buffer, context=context, writer_options=options)
    channels, start = topics.channels_of(context), EPOCH
    shown: tuple[object, ...] = ()
    for i, number in enumerate(progress(numbers)):
        report = report_rally(log, int(number), game, policies, hands)
        motion = stage(report.played, seed=report.key, athletes=athletes or report.athletes, fps=fps)
        staged = StagedRally(report=report, motion=motion, start=start)
        messages = [*_transforms(staged), *_trail(staged), *_states(staged), *commentary(staged)]
        looks = report.names, motion.hands, motion.skeletons
        if shown != looks:
            shown = looks
            messages.insert(0, entities_on(topics.PLAYERS, start, topics.players(start, motion, report.names)))
        if not i:
            messages.insert(0, entities_on(topics.COURT, start, topics.court(start)))
        for time, topic, message in sorted(messages, key=lambda timed: timed[0]):
            channels[topic].log(message, log_time=time)
        start = staged.at(float(motion.time[-1])) + CUT
    for path in LAYOUTS:
        writer.attach(log_time=EPOCH, create_time=EPOCH, name=path.name, media_type="application/json", data=path.read_bytes())
    # Origin of the rallies: log, seeds, game and policies.
    seated = sorted({int(policy) for number in numbers for policy in log.rally(int(number)).policy[0]})
    facts = {
        "software": f"shuttle_marl {__version__}",
        "log": printable(log.path.name),
        "rallies": " ".join(str(int(number)) for number in numbers),
        "game": game.hash,
        "seeds": " ".join(dict.fromkeys(str(file.header.seed) for file in log.files)),
        "policies": json.dumps({log.policies[i].name: log.policies[i].hash for i in seated}),
    }
    writer.write_metadata("shuttle_marl.court.scene", facts)
    writer.close()
    return buffer.getvalue(), policies.unknown
