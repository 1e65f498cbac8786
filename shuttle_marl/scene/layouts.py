"""Layouts of the panels of Foxglove and Lichtblick: one for a rally, one for a match, each with its cameras as tabs."""

import json
from collections.abc import Callable
from typing import Any, Final

import foxglove.layouts as fox

from shuttle_marl.scene import topics
from shuttle_marl.scene.board import CAMERAS, Camera
from shuttle_marl.scene.topics import BOARDS, WORLD

_BACKGROUND: Final = "#10141c"
_RED, _BLUE, _YELLOW, _GREEN = "#e8594f", "#4e98e2", "#f7df71", "#5cd6a9"
Plot = tuple[str, tuple[tuple[str, str, str], ...], tuple[float, float] | None]
_PLOTS: Final[tuple[Plot, ...]] = (
    (
        "Seat 0 wins: the rally (red), the match (yellow)",
        (
            (f"{topics.VALUE}.rally_win_0", _RED, "the rally"),
            (f"{topics.VALUE}.match_win_0", _YELLOW, "the match"),
        ),
        (0.0, 1.0),
    ),
    (
        "Stroke: good (green), returned (blue), chosen (yellow)",
        (
            (f"{topics.STROKE}.p_succ", _GREEN, "good"),
            (f"{topics.STROKE}.p_ret", _BLUE, "returned if good"),
            (f"{topics.STROKE}.probability", _YELLOW, "chosen by the policy"),
        ),
        (0.0, 1.0),
    ),
    (
        "Shuttle: height [m] (blue), speed [m/s] (yellow)",
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

_MATCH_PLOTS: Final[tuple[Plot, ...]] = (
    ("Probability that seat 0 wins the match", ((f"{topics.VALUE}.match_win_0", _YELLOW, "the match"),), (0.0, 1.0)),
    (
        "Points: seat 0 (red), seat 1 (blue)",
        ((f"{topics.SCORE}.points_0", _RED, "seat 0"), (f"{topics.SCORE}.points_1", _BLUE, "seat 1")),
        None,
    ),
)
_MATCH_ROWS: Final = (
    (f"{topics.SCORE}.games_0", "games of seat 0"),
    (f"{topics.SCORE}.games_1", "games of seat 1"),
    (f"{topics.SCORE}.server", "serves"),
    (f"{topics.SCORE}.reason", "ended by"),
)


def lichtblick(*, match: bool = False) -> bytes:
    """The layout of a rally or of a match as JSON for Lichtblick: import it from its layout menu."""
    plots, rows = (_MATCH_PLOTS, _MATCH_ROWS) if match else (_PLOTS, _ROWS)
    panels: dict[str, Any] = {}
    for camera in CAMERAS:
        panels[f"3D!{camera.title.lower()}"] = {
            "cameraState": {
                "perspective": True,
                "distance": camera.distance,
                "phi": camera.phi,
                "thetaOffset": camera.theta,
                "targetOffset": list(camera.target),
                "target": [0, 0, 0],
                "targetOrientation": [0, 0, 0, 1],
                "fovy": camera.fovy,
                "near": 0.1,
                "far": 500,
            },
            "followMode": "follow-none" if camera.frame == WORLD else "follow-pose",
            "followTf": camera.frame,
            "scene": {
                "backgroundColor": _BACKGROUND,
                "enableStats": False,
                "meshUpAxis": "y_up",
                "transforms": {"showLabel": False, "editable": False, "axisScale": 0, "lineWidth": 0, "enablePreloading": False},
            },
            "transforms": {},
            "layers": {},
            "topics": {topic: {"visible": topic in _shown(camera), "showOutlines": False} for topic in topics.SCENES},
            "publish": {},
            "imageMode": {},
        }
    panels["Tab!cameras"] = {
        "activeTabIdx": 0,
        "tabs": [{"title": camera.title, "layout": f"3D!{camera.title.lower()}"} for camera in CAMERAS],
    }
    panels["StateTransitions!rally"] = {
        "isSynced": True,
        "paths": [{"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime"} for path, label in rows],
    }
    panels["Table!top"] = {"topicPath": f"{topics.SUMMARY}.strokes" if match else f"{topics.POLICY}.top"}
    panels["RosOut!log"] = {"searchTerms": [], "minLogLevel": 1, "topicToRender": topics.LOG, "nameFilter": {}}
    for i, (title, series, bounds) in enumerate(plots):
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
            "showLegend": False,
            "isSynced": True,
            "xAxisVal": "timestamp",
            **({"minYValue": bounds[0], "maxYValue": bounds[1]} if bounds else {}),
        }
    right: Any = "RosOut!log"
    shares = ((50, "Table!top"), *zip((33, 27, 24), (f"Plot!{i}" for i in reversed(range(len(plots)))), strict=False))
    for share, name in shares:
        right = {"direction": "column", "splitPercentage": share, "first": name, "second": right}
    left = {
        "direction": "column",
        "splitPercentage": 70 if match else 62,
        "first": "Tab!cameras",
        "second": "StateTransitions!rally",
    }
    document = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": {"direction": "row", "splitPercentage": 64, "first": left, "second": right},
    }
    return (json.dumps(document, indent=1) + "\n").encode()


def foxglove(*, match: bool = False) -> bytes:
    """The layout of a rally or of a match as JSON for Foxglove."""
    lines, rows = (_MATCH_PLOTS, _MATCH_ROWS) if match else (_PLOTS, _ROWS)
    cameras = fox.TabContainer(tabs=[fox.TabItem(title=camera.title, content=_view(camera)) for camera in CAMERAS])
    rally = fox.StateTransitionsPanel(
        title="Rally",
        config=fox.StateTransitionsConfig(paths=[fox.StateTransitionsSeries(value=path, label=label) for path, label in rows]),
    )
    plots = [
        fox.PlotPanel(
            title=title,
            config=fox.PlotConfig(
                paths=[fox.PlotSeries(value=path, color=colour, label=label) for path, colour, label in series],
                min_y_value=bounds[0] if bounds else None,
                max_y_value=bounds[1] if bounds else None,
                show_legend=False,
            ),
        )
        for title, series, bounds in lines
    ]
    path = f"{topics.SUMMARY}.strokes" if match else f"{topics.POLICY}.top"
    top = fox.TablePanel(title="Strokes of the rally" if match else "Likeliest strokes", config=fox.TableConfig(topic_path=path))
    log = fox.LogPanel(title="Log", config=fox.LogConfig(topic_to_render=topics.LOG))
    left = fox.SplitContainer(
        direction="column",
        items=[fox.SplitItem(content=cameras, proportion=0.66), fox.SplitItem(content=rally, proportion=0.34)],
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


def _shown(camera: Camera) -> set[str]:
    """Topics that the 3D panel of a camera shows: of the scoreboards its own alone."""
    return {*topics.SCENES} - {*BOARDS} | {camera.board}


def _view(camera: Camera) -> fox.ThreeDeePanel:
    """The 3D panel of a tab."""
    state = fox.ThreeDeeCameraState(
        perspective=True,
        distance=camera.distance,
        phi=camera.phi,
        theta_offset=camera.theta,
        target_offset=camera.target,
        target=(0.0, 0.0, 0.0),
        target_orientation=(0.0, 0.0, 0.0, 1.0),
        fovy=camera.fovy,
        near=0.1,
        far=500.0,
    )
    return fox.ThreeDeePanel(
        title=camera.title,
        config=fox.ThreeDeeConfig(
            camera_state=state,
            follow_tf=camera.frame,
            fixed_frame=WORLD,
            follow_mode="follow-none" if camera.frame == WORLD else "follow-pose",
            scene=fox.BaseRendererSceneSettings(
                background_color=_BACKGROUND,
                mesh_up_axis="y_up",
                transforms=fox.BaseRendererTransforms(
                    visible=False, show_label=False, axis_size=0.0, line_width=0.0, enable_preloading=False
                ),
            ),
            topics={
                topic: fox.BaseRendererSceneUpdateTopicSettings(visible=topic in _shown(camera), show_outlines=False)
                for topic in topics.SCENES
            },
        ),
    )


LAYOUTS: Final[dict[str, Callable[[], bytes]]] = {
    "layout.lichtblick.json": lichtblick,
    "layout.foxglove.json": foxglove,
    "match.lichtblick.json": lambda: lichtblick(match=True),
    "match.foxglove.json": lambda: foxglove(match=True),
}
"""Names of the attachments, and what makes them: layouts of a rally and of a match."""
