"""The topics of a scene and what their messages hold; ``docs/foxglove.md`` lists them for readers."""

from typing import Any, Final

from foxglove import Channel, Context
from foxglove.channels import FrameTransformsChannel, LogChannel, SceneUpdateChannel

from shuttle_marl.game.stroke import SHOTS

COURT: Final = "/scene/court"
PLAYERS: Final = "/scene/players"
SHUTTLE: Final = "/scene/shuttle"
STROKE_MARKS: Final = "/scene/stroke"
BOARD: Final = "/scene/board"
TF: Final = "/tf"
LOG: Final = "/log"
SCORE: Final = "/rally/score"
STROKE: Final = "/rally/stroke"
POLICY: Final = "/rally/policy"
VALUE: Final = "/rally/value"
STATE: Final = "/rally/state"
SUMMARY: Final = "/rally/summary"

SCENES: Final = (COURT, PLAYERS, SHUTTLE, STROKE_MARKS, BOARD)
"""Topics that the 3D panel shows."""

_NUMBER: Final = {"type": "number"}
_INTEGER: Final = {"type": "integer"}
_TEXT: Final = {"type": "string"}


def _object(title: str, **properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


_POINT: Final = _object("point", x=_NUMBER, y=_NUMBER, z=_NUMBER, speed=_NUMBER)
_STROKE: Final = _object(
    "shuttle_marl.Stroke",
    number=_INTEGER,
    seat=_INTEGER,
    player=_TEXT,
    stroke=_TEXT,
    shot=_TEXT,
    area=_TEXT,
    height=_TEXT,
    technique=_TEXT,
    p_succ=_NUMBER,
    p_ret=_NUMBER,
    probability=_NUMBER,
    win_probability=_NUMBER,
    contact_height=_NUMBER,
    speed_kmh=_NUMBER,
    flight_time=_NUMBER,
    end=_TEXT,
)
SCHEMAS: Final[dict[str, dict[str, Any]]] = {
    SCORE: _object(
        "shuttle_marl.Score",
        rally=_INTEGER,
        match=_INTEGER,
        name_0=_TEXT,
        name_1=_TEXT,
        points_0=_INTEGER,
        points_1=_INTEGER,
        games_0=_INTEGER,
        games_1=_INTEGER,
        server=_INTEGER,
        winner=_INTEGER,
        reason=_TEXT,
    ),
    STROKE: _STROKE,
    POLICY: _object(
        "shuttle_marl.Policy",
        seat=_INTEGER,
        player=_TEXT,
        top={
            "type": "array",
            "items": _object("shuttle_marl.Option", stroke=_TEXT, probability=_NUMBER, win_probability=_NUMBER),
        },
        shots=_object("shuttle_marl.Shots", **{shot.replace("-", "_"): _NUMBER for shot in SHOTS}),
    ),
    VALUE: _object(
        "shuttle_marl.Value",
        rally_win_0=_NUMBER,
        match_win_0=_NUMBER,
        striker=_NUMBER,
        chosen=_NUMBER,
    ),
    STATE: _object("shuttle_marl.State", phase=_TEXT, shuttle=_POINT, player_0=_POINT, player_1=_POINT),
    SUMMARY: _object(
        "shuttle_marl.Summary", rally=_INTEGER, winner=_TEXT, reason=_TEXT, strokes={"type": "array", "items": _STROKE}
    ),
}
"""JSON schemas of the topics that plots and tables read."""


class Topics:
    """The channels of one scene."""

    def __init__(self, context: Context) -> None:
        self.scenes = {topic: SceneUpdateChannel(topic, context=context) for topic in SCENES}
        self.tf = FrameTransformsChannel(TF, context=context)
        self.log = LogChannel(LOG, context=context)
        self.json = {topic: Channel(topic, schema=schema, context=context) for topic, schema in SCHEMAS.items()}
