"""Topics of a scene and the messages on them; ``docs/foxglove.md`` lists them for readers.

Here is what the messages of each topic hold, short ways to make them, and what sends them later.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

from foxglove import Channel, Context
from foxglove.channels import FrameTransformsChannel, LogChannel, SceneUpdateChannel
from foxglove.messages import (
    Color,
    CubePrimitive,
    FrameTransform,
    Log,
    LogLevel,
    ModelPrimitive,
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

from shuttle_marl.arrays import Floats
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.scene.cameras import BOARDS
from shuttle_marl.scene.mesh import Mesh, glb
from shuttle_marl.scene.report import SECOND

COURT: Final = "/scene/court"
PLAYERS: Final = "/scene/players"
SHUTTLE: Final = "/scene/shuttle"
STROKE_MARKS: Final = "/scene/stroke"
TF: Final = "/tf"
TF_STATIC: Final = "/tf_static"
LOG: Final = "/log"
SCORE: Final = "/rally/score"
STROKE: Final = "/rally/stroke"
POLICY: Final = "/rally/policy"
VALUE: Final = "/rally/value"
STATE: Final = "/rally/state"
SUMMARY: Final = "/rally/summary"

SCENES: Final = (COURT, PLAYERS, SHUTTLE, STROKE_MARKS, *BOARDS)
"""Topics that the 3D panel shows."""

_NUMBER: Final = {"type": "number"}
_INTEGER: Final = {"type": "integer"}
_TEXT: Final = {"type": "string"}
Vector = Floats | tuple[float, float, float]
_UPRIGHT: Final = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
_HERE: Final = Vector3(x=0.0, y=0.0, z=0.0)


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
    effort=_INTEGER,
    opponent_effort=_INTEGER,
    duel=_INTEGER,
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
        self.tf_static = FrameTransformsChannel(TF_STATIC, context=context)
        self.log = LogChannel(LOG, context=context)
        self.json = {topic: Channel(topic, schema=schema, context=context) for topic, schema in SCHEMAS.items()}


Send = Callable[[Topics, int], None]
Timed = tuple[int, Send]
"""A message: when [ns], and what sends it then."""


def stamp(nanoseconds: int) -> Timestamp:
    """An instant."""
    return Timestamp(sec=nanoseconds // SECOND, nsec=nanoseconds % SECOND)


def colour(red: float, green: float, blue: float, alpha: float = 1.0) -> Color:
    """A colour, as it is seen on a screen, 0 to 1."""
    return Color(r=red, g=green, b=blue, a=alpha)


def point(v: Vector) -> Point3:
    """A point [m]."""
    return Point3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def vector(v: Vector) -> Vector3:
    """A vector [m]."""
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def at(v: Vector) -> Pose:
    """A place, not turned."""
    return Pose(position=vector(v), orientation=_UPRIGHT)


def transform(when: Timestamp, child: str, parent: str, value: Sequence[float]) -> FrameTransform:
    """A frame of reference in another: moved if the value is a place [m], turned if it is a quaternion (x, y, z, w)."""
    if len(value) == 3:
        place, turn = vector((value[0], value[1], value[2])), _UPRIGHT
    else:
        place, turn = _HERE, Quaternion(x=value[0], y=value[1], z=value[2], w=value[3])
    return FrameTransform(timestamp=when, parent_frame_id=parent, child_frame_id=child, translation=place, rotation=turn)


def box(centre: Vector, size: Vector, shade: Color) -> CubePrimitive:
    """A box along the axes [m]."""
    return CubePrimitive(pose=at(centre), size=vector(size), color=shade)


def label(words: str, place: Vector, pixels: float, shade: Color) -> TextPrimitive:
    """Words that always face the viewer and are as large on the screen from anywhere, ``pixels`` high."""
    return TextPrimitive(pose=at(place), billboard=True, font_size=pixels, scale_invariant=True, color=shade, text=words)


def model(meshes: list[Mesh]) -> ModelPrimitive:
    """Meshes as a model."""
    return ModelPrimitive(
        pose=at((0, 0, 0)),
        scale=vector((1, 1, 1)),
        color=colour(1, 1, 1),
        override_color=False,
        media_type="model/gltf-binary",
        data=glb(meshes),
    )


def update(nanoseconds: int, entities: list[SceneEntity]) -> SceneUpdate:
    """All that a topic shows from this time: earlier entities are deleted, so that the message stands for itself after a seek."""
    everything = SceneEntityDeletion(timestamp=stamp(nanoseconds), type=SceneEntityDeletionType.All, id="")
    return SceneUpdate(deletions=[everything], entities=entities)


def entities_on(topic: str, entities: Callable[[int], list[SceneEntity]]) -> Send:
    """Send all that a topic of the 3D panel shows."""

    def send(to: Topics, time: int) -> None:
        message: SceneUpdate = update(time, entities(time))
        to.scenes[topic].log(message, log_time=time)

    return send


def numbers_on(topic: str, content: dict[str, Any]) -> Send:
    """Send numbers and words on a topic of the plots, without what is None."""
    kept = {name: value for name, value in content.items() if value is not None}

    def send(to: Topics, time: int) -> None:
        to.json[topic].log(kept, log_time=time)

    return send


def log_line(words: str, name: str) -> Send:
    """Send a line of the log."""

    def send(to: Topics, time: int) -> None:
        to.log.log(Log(timestamp=stamp(time), level=LogLevel.Info, message=words, name=name), log_time=time)

    return send
