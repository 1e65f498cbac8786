"""Layouts: which panels show what, for Lichtblick (and older Foxglove) and for Foxglove."""

import json
from collections.abc import Callable
from typing import Any, Final

import foxglove.layouts as fox

from shuttle_marl.scene import topics
from shuttle_marl.scene.moving import WORLD

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


FILES: Final[dict[str, Callable[[], bytes]]] = {"layout.lichtblick.json": lichtblick, "layout.foxglove.json": foxglove}
"""Names of the attachments, and what makes them."""
