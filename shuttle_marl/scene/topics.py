"""Topics and frames of reference of a scene, schemas of its JSON messages, and constructors of messages.

``docs/foxglove.md`` describes every topic.
"""

import math
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from foxglove import Channel, Context
from foxglove.channels import FrameTransformsChannel, LogChannel, SceneUpdateChannel
from foxglove.messages import (
    Color,
    CubePrimitive,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Log,
    LogLevel,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneEntityDeletion,
    SceneEntityDeletionType,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector3,
)

from shuttle_marl.base.arrays import F64, Floats
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.scene.rally_report import SECOND

COURT: Final = "/scene/court"
PLAYERS: Final = "/scene/players"
SHUTTLE: Final = "/scene/shuttle"
STROKE_MARKS: Final = "/scene/stroke"
TF: Final = "/tf"
LOG: Final = "/log"
SCORE: Final = "/rally/score"
STROKE: Final = "/rally/stroke"
POLICY: Final = "/rally/policy"
VALUE: Final = "/rally/value"
STATE: Final = "/rally/state"
SUMMARY: Final = "/rally/summary"

BOARDS: Final = tuple(f"/scene/board_{camera}" for camera in ("broadcast", "side", "follow"))
"""Scoreboards, one for each camera."""
SCENES: Final = (COURT, PLAYERS, SHUTTLE, STROKE_MARKS, *BOARDS)
"""Topics of the 3D panel."""

WORLD: Final = "court"
"""Frame of reference of the court, on which all others are placed."""
SHUTTLE_FRAME: Final = "shuttle"
"""Moves and turns with the shuttle; the cork points along z."""
SHUTTLE_FLOOR: Final = "shuttle_floor"
"""On the floor below the shuttle."""


def bone_frame(seat: int, bone: str) -> str:
    """Name of the frame of reference of a bone."""
    return f"{seat}/{bone}"


def place_frame(seat: int) -> str:
    """Name of the frame of reference on the floor below the hips of a player, which looks over the net and does not turn."""
    return f"player_{seat}"


Vector = Floats | tuple[float, float, float]
_UPRIGHT: Final = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)


def _object(title: str, **properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties}


def _fields(kind: str, *names: str) -> dict[str, dict[str, Any]]:
    return {name: {"type": kind} for name in names}


def _array(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_POINT: Final = _object("point", **_fields("number", "x", "y", "z", "speed"))
_OPTION: Final = _object(
    "shuttle_marl.Option", **_fields("string", "stroke"), **_fields("number", "probability", "win_probability")
)
_STROKE: Final = _object(
    "shuttle_marl.Stroke",
    **_fields("integer", "number", "seat"),
    **_fields("string", "player", "stroke", "shot", "area", "height", "technique"),
    **_fields("number", "p_succ", "p_ret", "probability", "estimate", "win_probability"),
    hurried={"type": "boolean"},
    **_fields("integer", "effort", "opponent_effort", "duel"),
    **_fields("number", "contact_height", "speed_kmh", "flight_time"),
    **_fields("string", "end", "waited"),
)
SCHEMAS: Final[dict[str, dict[str, Any]]] = {
    SCORE: _object(
        "shuttle_marl.Score",
        **_fields("integer", "rally", "match"),
        **_fields("string", "name_0", "name_1"),
        **_fields("integer", "points_0", "points_1", "games_0", "games_1", "server", "winner"),
        **_fields("string", "reason"),
    ),
    STROKE: _STROKE,
    POLICY: _object(
        "shuttle_marl.Policy",
        **_fields("integer", "seat"),
        **_fields("string", "player"),
        top=_array(_OPTION),
        shots=_object("shuttle_marl.Shots", **_fields("number", *(shot.replace("-", "_") for shot in SHOTS))),
    ),
    VALUE: _object("shuttle_marl.Value", **_fields("number", "rally_win_0", "match_win_0", "striker", "chosen")),
    STATE: _object("shuttle_marl.State", **_fields("string", "phase"), shuttle=_POINT, player_0=_POINT, player_1=_POINT),
    SUMMARY: _object(
        "shuttle_marl.Summary", **_fields("integer", "rally"), **_fields("string", "winner", "reason"), strokes=_array(_STROKE)
    ),
}
"""JSON schemas of the topics that plots and tables read."""


Message = SceneUpdate | FrameTransforms | Log | dict[str, Any]
Timed = tuple[int, str, Message]
"""Time [ns], topic and content of a message."""


class Channels:
    """The channels of one scene, one for each topic."""

    def __init__(self, context: Context) -> None:
        self._channels: dict[str, Any] = {topic: SceneUpdateChannel(topic, context=context) for topic in SCENES}
        self._channels[TF] = FrameTransformsChannel(TF, context=context)
        self._channels[LOG] = LogChannel(LOG, context=context)
        self._channels |= {topic: Channel(topic, schema=schema, context=context) for topic, schema in SCHEMAS.items()}

    def write(self, messages: Iterable[Timed]) -> None:
        """Write messages in the order of their times."""
        for time, topic, message in sorted(messages, key=lambda timed: timed[0]):
            self._channels[topic].log(message, log_time=time)


def stamp(nanoseconds: int) -> Timestamp:
    """Time as a message field."""
    return Timestamp(sec=nanoseconds // SECOND, nsec=nanoseconds % SECOND)


def colour(red: float, green: float, blue: float, alpha: float = 1.0) -> Color:
    """An sRGB colour, each component from 0 to 1."""
    return Color(r=red, g=green, b=blue, a=alpha)


def point(v: Vector) -> Point3:
    """A point [m]."""
    return Point3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def vector(v: Vector) -> Vector3:
    """A vector [m]."""
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def at(v: Vector) -> Pose:
    """Pose at a place, without rotation."""
    return Pose(position=vector(v), orientation=_UPRIGHT)


def box(centre: Vector, size: Vector, shade: Color) -> CubePrimitive:
    """An axis-aligned box [m]."""
    return CubePrimitive(pose=at(centre), size=vector(size), color=shade)


def strip(path: F64, colours: list[Color], thickness: float) -> LinePrimitive:
    """A line with one colour, or one for each point; its thickness is in pixels at any distance."""
    return LinePrimitive(
        type=LinePrimitiveLineType.LineStrip,
        pose=at((0, 0, 0)),
        thickness=thickness,
        scale_invariant=True,
        points=[point(p) for p in np.round(path, 3)],
        color=colours[-1],
        colors=colours if len(colours) > 1 else [],
    )


def label(text: str, place: Vector, pixels: float, shade: Color) -> TextPrimitive:
    """Text that faces the viewer, ``pixels`` high on the screen at any distance."""
    return TextPrimitive(pose=at(place), billboard=True, font_size=pixels, scale_invariant=True, color=shade, text=text)


def entities_on(topic: str, time: int, entities: list[SceneEntity]) -> Timed:
    """All entities of a topic of the 3D panel from a time on.

    The message deletes earlier entities, so that it is complete after a seek.
    """
    everything = SceneEntityDeletion(timestamp=stamp(time), type=SceneEntityDeletionType.All, id="")
    return time, topic, SceneUpdate(deletions=[everything], entities=entities)


def known(content: dict[str, Any]) -> dict[str, Any]:
    """Entries that are neither None nor NaN."""
    unknown = {name for name, value in content.items() if value is None or (isinstance(value, float) and math.isnan(value))}
    return {name: value for name, value in content.items() if name not in unknown}


def numbers_on(topic: str, time: int, content: dict[str, Any]) -> Timed:
    """Numbers and text on a topic of the plots, without entries that are None or NaN."""
    return time, topic, known(content)


def log_line(time: int, text: str, name: str) -> Timed:
    """A line of the log."""
    return time, LOG, Log(timestamp=stamp(time), level=LogLevel.Info, message=text, name=name)
