"""Scene files: which rallies they show, MCAP with the messages that Foxglove and Lichtblick show, and layouts of their panels."""

import io
import json
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

import foxglove.layouts as fox
import numpy as np
import pyarrow as pa
from foxglove import Context, open_mcap
from foxglove.mcap import MCAPCompression, MCAPWriteOptions

from shuttle_marl import __version__
from shuttle_marl.errors import printable
from shuttle_marl.game.rally import Game
from shuttle_marl.policy.registry import resolve_recorded
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.tables import rally_rows
from shuttle_marl.scene import SceneError, models, topics
from shuttle_marl.scene.commentary import commentary
from shuttle_marl.scene.moving import WORLD, motion_messages
from shuttle_marl.scene.report import SECOND, Annotator, Resolve, StagedRally
from shuttle_marl.scene.topics import update
from shuttle_marl.staging import stage

EPOCH: Final = 1_735_689_600 * SECOND
"""Start of every scene: rallies are played at no date, and viewers want one (2025-01-01)."""
MOST_FPS: Final = 50
METADATA: Final = "shuttle_marl.scene"
_CHUNK: Final = 1 << 20


def select(
    log: RallyLog, *, rally: int | None = None, match: int | None = None, pairing: int = 0, best: int | None = None
) -> list[int]:
    """Numbers of the rallies, in the order in which they are shown.

    Args:
        log: the log.
        rally: number of one rally.
        match: number of a match of the pairing: all its rallies.
        pairing: number of the pairing.
        best: that many of the longest rallies, the longest last.

    Raises:
        SceneError: not exactly one of rally, match and best; or the log has no such match.
        RecordingError: the log is damaged.
    """
    if sum(choice is not None for choice in (rally, match, best)) != 1:
        raise SceneError("say which rallies: one of --rally NUMBER, --match NUMBER, --best COUNT")
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
    athletes: tuple[str, str] = ("male", "male"),
    handedness: tuple[str, str] = ("right", "right"),
    fps: int = 50,
    resolve: Resolve = resolve_recorded,
    progress: Callable[[Sequence[int]], Iterable[int]] = iter,
) -> tuple[bytes, dict[str, str]]:
    """Rallies of a log, one after the other, as the bytes of an MCAP file.

    Args:
        log: whose rallies they are.
        numbers: of the rallies in the log, at least one.
        game: the game that was played on.
        athletes: ``male`` or ``female``, of seats 0 and 1.
        handedness: ``right`` or ``left``, of seats 0 and 1.
        fps: frames a second, 25 to 50; viewers warn about more.
        resolve: finds the policies that the log names; by default neither modules nor files, because a log may come from others.
        progress: wraps the numbers while they are worked through.

    Returns:
        The file, and why a policy is not known, by its name: then the scene says nothing of its choices.

    Raises:
        RecordingError: the log has no such rally, is damaged, or was played on another game.
        SceneError: a rally of it cannot have been played, or too few or too many frames a second.
        StagingError: an unknown option of the staging.
    """
    if not 25 <= fps <= MOST_FPS:
        raise SceneError(f"{fps} frames a second: expected 25 to {MOST_FPS}; viewers warn about more")
    annotator = Annotator(log, game, resolve)
    context, buffer = Context(), io.BytesIO()
    options = MCAPWriteOptions(profile="", compression=MCAPCompression.Zstd, chunk_size=_CHUNK, compression_threads=0)
    writer = open_mcap(buffer, context=context, writer_options=options)
    to, start = topics.Topics(context), EPOCH
    names: tuple[str, str] | None = None
    for i, number in enumerate(progress(numbers)):
        report = annotator.report(int(number))
        motion = stage(report.played, seed=report.key, athletes=athletes, handedness=handedness, fps=fps)
        staged = StagedRally(report=report, motion=motion, start=start)
        if not i:
            to.scenes[topics.COURT].log(update(start, models.court(start)), log_time=start)
        if not i or names != report.names:
            names = report.names
            to.scenes[topics.PLAYERS].log(update(start, models.players(start, motion, names)), log_time=start)
        for time, send in sorted([*motion_messages(staged), *commentary(staged)], key=lambda timed: timed[0]):
            send(to, time)
        # The next rally begins a frame later: a cut, as in a broadcast.
        start = staged.end + round(SECOND / fps)
    for name, content in LAYOUTS.items():
        writer.attach(log_time=EPOCH, create_time=EPOCH, name=name, media_type="application/json", data=content())
    rows = _rows(log, numbers)
    writer.attach(
        log_time=EPOCH, create_time=EPOCH, name="rallies.arrow", media_type="application/vnd.apache.arrow.file", data=rows
    )
    writer.write_metadata(METADATA, _facts(log, numbers, game))
    writer.close()
    return buffer.getvalue(), annotator.unknown


def _rows(log: RallyLog, numbers: Sequence[int]) -> bytes:
    """The rallies as they stand in the log, as an Arrow IPC file."""
    table = pa.concat_tables([rally_rows(log, int(number), log.rally(int(number))) for number in numbers])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_file(sink, table.schema) as file:
        file.write_table(table.unify_dictionaries())
    return sink.getvalue().to_pybytes()


def _facts(log: RallyLog, numbers: Sequence[int], game: Game) -> dict[str, str]:
    """Origin of the rallies, so that they can be found and played again."""
    headers = [file.header for file in log.files]
    seated = sorted({int(policy) for number in numbers for policy in log.rally(int(number)).policy[0]})
    players = [log.policies[i] for i in seated]
    return {
        "software": f"shuttle_marl {__version__}",
        "log": printable(log.path.name),
        "rallies": " ".join(str(int(number)) for number in numbers),
        "game": game.hash,
        "seeds": " ".join(dict.fromkeys(str(header.seed) for header in headers)),
        "policies": json.dumps({player.name: player.hash for player in players}),
    }


_BACKGROUND: Final = "#10141c"
_RED, _BLUE, _YELLOW, _GREEN = "#e8594f", "#4e98e2", "#f7df71", "#5cd6a9"
_DISTANCE, _PHI, _THETA, _FOVY = 15.5, 64.0, 298.0, 42.0
_TARGET: Final = (-0.2, 0.1, 0.8)

_PLOTS: Final = (
    (
        "Probability of a win, seat 0",
        (
            (f"{topics.VALUE}.rally_win_0", _RED, "the rally"),
            (f"{topics.VALUE}.match_win_0", _YELLOW, "the match"),
        ),
        (0.0, 1.0),
    ),
    (
        "Stroke: good, returned, chosen",
        (
            (f"{topics.STROKE}.p_succ", _GREEN, "good"),
            (f"{topics.STROKE}.p_ret", _BLUE, "returned if good"),
            (f"{topics.STROKE}.probability", _YELLOW, "chosen by the policy"),
        ),
        (0.0, 1.0),
    ),
    (
        "Shuttle: height [m], speed [m/s]",
        (
            (f"{topics.STATE}.shuttle.z", _BLUE, "height"),
            (f"{topics.STATE}.shuttle.speed", _YELLOW, "speed"),
        ),
        None,
    ),
)
"""Title, (path, colour, label) of every series, and the range of the axis."""
_ROWS: Final = (
    (f"{topics.STATE}.phase", "who struck"),
    (f"{topics.STROKE}.shot", "shot"),
    (f"{topics.STROKE}.area", "target"),
    (f"{topics.SCORE}.points_0", "points of seat 0"),
    (f"{topics.SCORE}.points_1", "points of seat 1"),
)


def lichtblick() -> bytes:
    """The layout as JSON for Lichtblick: import it from its layout menu."""
    panels: dict[str, Any] = {
        "3D!court": {
            "cameraState": {
                "perspective": True,
                "distance": _DISTANCE,
                "phi": _PHI,
                "thetaOffset": _THETA,
                "targetOffset": list(_TARGET),
                "target": [0, 0, 0],
                "targetOrientation": [0, 0, 0, 1],
                "fovy": _FOVY,
                "near": 0.1,
                "far": 500,
            },
            "followMode": "follow-none",
            "followTf": WORLD,
            "scene": {
                "backgroundColor": _BACKGROUND,
                "enableStats": False,
                "meshUpAxis": "y_up",
                "transforms": {"showLabel": False, "editable": False, "axisScale": 0, "lineWidth": 0, "enablePreloading": False},
            },
            "transforms": {},
            "layers": {},
            "topics": {topic: {"visible": True, "showOutlines": False} for topic in topics.SCENES},
            "publish": {},
            "imageMode": {},
        },
        "StateTransitions!rally": {
            "isSynced": True,
            "paths": [
                {"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime"} for path, label in _ROWS
            ],
        },
        "Table!top": {"topicPath": f"{topics.POLICY}.top"},
        "RosOut!log": {"searchTerms": [], "minLogLevel": 1, "topicToRender": topics.LOG, "nameFilter": {}},
    }
    for i, (title, series, bounds) in enumerate(_PLOTS):
        panels[f"Plot!{i}"] = {
            "lichtblickPanelTitle": title,
            "foxglovePanelTitle": title,
            "paths": [
                {
                    "value": path,
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                    "color": colour,
                    "label": label,
                    "showLine": True,
                }
                for path, colour, label in series
            ],
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "showLegend": True,
            "legendDisplay": "left",
            "sidebarDimension": 150,
            "showPlotValuesInLegend": False,
            "isSynced": True,
            "xAxisVal": "timestamp",
            **({"minYValue": bounds[0], "maxYValue": bounds[1]} if bounds else {}),
        }
    right: Any = "RosOut!log"
    for name, share in (("Table!top", 50), ("Plot!2", 33), ("Plot!1", 27), ("Plot!0", 24)):
        right = {"direction": "column", "splitPercentage": share, "first": name, "second": right}
    left = {"direction": "column", "splitPercentage": 62, "first": "3D!court", "second": "StateTransitions!rally"}
    document = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": {"direction": "row", "splitPercentage": 64, "first": left, "second": right},
    }
    return (json.dumps(document, indent=1) + "\n").encode()


def foxglove() -> bytes:
    """The layout as JSON for Foxglove."""
    camera = fox.ThreeDeeCameraState(
        perspective=True,
        distance=_DISTANCE,
        phi=_PHI,
        theta_offset=_THETA,
        target_offset=_TARGET,
        target=(0.0, 0.0, 0.0),
        target_orientation=(0.0, 0.0, 0.0, 1.0),
        fovy=_FOVY,
        near=0.1,
        far=500.0,
    )
    court = fox.ThreeDeePanel(
        title="Court",
        config=fox.ThreeDeeConfig(
            camera_state=camera,
            follow_tf=WORLD,
            fixed_frame=WORLD,
            follow_mode="follow-none",
            scene=fox.BaseRendererSceneSettings(
                background_color=_BACKGROUND,
                mesh_up_axis="y_up",
                transforms=fox.BaseRendererTransforms(
                    visible=False, show_label=False, axis_size=0.0, line_width=0.0, enable_preloading=False
                ),
            ),
            topics={
                topic: fox.BaseRendererSceneUpdateTopicSettings(visible=True, show_outlines=False) for topic in topics.SCENES
            },
        ),
    )
    rally = fox.StateTransitionsPanel(
        title="Rally",
        config=fox.StateTransitionsConfig(paths=[fox.StateTransitionsSeries(value=path, label=label) for path, label in _ROWS]),
    )
    plots = [
        fox.PlotPanel(
            title=title,
            config=fox.PlotConfig(
                paths=[fox.PlotSeries(value=path, color=colour, label=label) for path, colour, label in series],
                min_y_value=bounds[0] if bounds else None,
                max_y_value=bounds[1] if bounds else None,
            ),
        )
        for title, series, bounds in _PLOTS
    ]
    top = fox.TablePanel(title="Likeliest strokes", config=fox.TableConfig(topic_path=f"{topics.POLICY}.top"))
    log = fox.LogPanel(title="Log", config=fox.LogConfig(topic_to_render=topics.LOG))
    left = fox.SplitContainer(
        direction="column",
        items=[fox.SplitItem(content=court, proportion=0.62), fox.SplitItem(content=rally, proportion=0.38)],
    )
    right = fox.SplitContainer(
        direction="column",
        items=[fox.SplitItem(content=panel, proportion=0.2) for panel in (*plots, top, log)],
    )
    whole = fox.SplitContainer(
        direction="row",
        items=[fox.SplitItem(content=left, proportion=0.64), fox.SplitItem(content=right, proportion=0.36)],
    )
    return (json.dumps(json.loads(fox.Layout(content=whole).to_json()), indent=1) + "\n").encode()


LAYOUTS: Final[dict[str, Callable[[], bytes]]] = {"layout.lichtblick.json": lichtblick, "layout.foxglove.json": foxglove}
"""Names of the attachments, and what makes them."""
