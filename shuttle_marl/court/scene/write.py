"""Scene files: MCAP with the messages that Foxglove and Lichtblick show, and the comments on the strokes."""

import io
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from foxglove import Context, open_mcap
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from foxglove.messages import SceneEntity

from shuttle_marl import __version__
from shuttle_marl.base.errors import printable
from shuttle_marl.court.scene import SceneError, topics
from shuttle_marl.court.scene.motion import motion_messages
from shuttle_marl.court.scene.rally_report import SECOND, RallyReport, StagedRally, report_rally
from shuttle_marl.court.scene.topics import Timed, at, boards, colour, disc, entities_on, entity, log_line, numbers_on
from shuttle_marl.court.staging import ENDS, stage
from shuttle_marl.game.court import AREA_WORDS, Hands
from shuttle_marl.game.layout import LONGEST_DUEL
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve_recorded
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.reports import LogPlayers
from shuttle_marl.reports.rally import Resolve

_TOP: Final = 5  # number of strokes of a policy that are listed
_PATH, _TARGET = colour(1.0, 1.0, 1.0, 0.35), colour(1.0, 0.80, 0.10, 0.30)
_WAITED: Final = colour(1.0, 1.0, 1.0, 0.45)
_FAULT, _WON = colour(0.95, 0.25, 0.20, 0.9), colour(0.20, 0.90, 0.35, 0.9)


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
    """Values and the policy's probabilities at a stroke, as far as they are known."""
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


EPOCH: Final = 1_735_689_600 * SECOND  # start of every scene, 2025-01-01: recorded rallies have no date, and viewers need one
MOST_FPS: Final = 50
LAYOUTS: Final = tuple(
    Path(__file__).parent / "layouts" / f"{scope}.{viewer}.json"
    for scope in ("layout", "match")
    for viewer in ("lichtblick", "foxglove")
)
"""Layouts of the viewers' panels, for a rally (``layout``) and for a match; attached to every scene."""
CUT: Final = SECOND // 1000  # time between two rallies [ns]: too short for a visible interpolation


def select(
    log: RallyLog, *, rally: int | None = None, match: int | None = None, pairing: int = 0, best: int | None = None
) -> list[int]:
    """Numbers of the rallies of a scene, in their order.

    Args:
        match: number of a match: all its rallies.
        pairing: number of the pairing of the match.
        best: number of rallies: the longest of the log, the longest last.

    Raises:
        SceneError: not exactly one of rally, match and best; or the log has no such match.
        RecordingError: the log is damaged.
    """
    if sum(choice is not None for choice in (rally, match, best)) != 1:
        raise SceneError("expected one of --rally NUMBER, --match NUMBER, --best COUNT")
    if rally is not None:
        return [rally]
    if match is not None:
        numbers = log.numbers_of_match(pairing, match)
        if not len(numbers):
            raise SceneError(f"{log.path}: no match {match} of pairing {pairing}; see `info` for how many pairings there are")
        return [int(number) for number in numbers]
    if best is None or best < 1:
        raise SceneError(f"--best {best}: expected 1 or more")
    found: list[tuple[int, int]] = []
    for first, rallies in log.batches():
        longest = np.argsort(-rallies.length, kind="stable")[:best]
        found += [(int(rallies.length[row]), first + int(row)) for row in longest]
        found = sorted(found, key=lambda entry: (-entry[0], entry[1]))[:best]
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
        messages = [*motion_messages(staged), *commentary(staged)]
        looks = report.names, motion.hands, motion.skeletons
        if shown != looks:
            shown = looks
            messages.insert(0, entities_on(topics.PLAYERS, start, topics.players(start, motion, report.names)))
        if not i:
            messages.insert(0, entities_on(topics.COURT, start, topics.court(start)))
        for time, topic, message in sorted(messages, key=lambda timed: timed[0]):
            channels[topic].log(message, log_time=time)
        start = staged.end + CUT
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
