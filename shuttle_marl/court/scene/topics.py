"""Topics (``docs/foxglove.md``), frames and JSON schemas of a scene, constructors of messages, and all shapes."""

import itertools
import math
import textwrap
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from foxglove import Channel, Context, channels
from foxglove import messages as fox

from shuttle_marl.base.arrays import F64, Floats
from shuttle_marl.court.staging import Motion
from shuttle_marl.court.staging import skeleton as body
from shuttle_marl.court.staging.flight import net_height
from shuttle_marl.court.staging.geometry import frame, quaternion
from shuttle_marl.game import court as laws
from shuttle_marl.game.stroke import SHOTS

SECOND: Final = 1_000_000_000  # [ns]

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

WORLD: Final = "court"  # frame of reference of the court, on which all others are placed
BOARDS: Final = {  # one scoreboard a camera: frame of reference, and centre [m] at the upper left
    "/scene/board_broadcast": (WORLD, (-4.878, -0.036, 4.041)),
    "/scene/board_side": (WORLD, (-2.389, -5.321, 4.67)),
    "/scene/board_follow": ("player_0", (-2.203, -0.925, 2.666)),
}
SCENES: Final = (COURT, PLAYERS, SHUTTLE, STROKE_MARKS, *BOARDS)  # topics of the 3D panel
SHUTTLE_FRAME: Final = "shuttle"  # moves and turns with the shuttle; the cork points along z
SHUTTLE_FLOOR: Final = "shuttle_floor"  # on the floor below the shuttle


def bone_frame(seat: int, bone: str) -> str:
    """Name of the frame of reference of a bone."""
    return f"{seat}/{bone}"


def place_frame(seat: int) -> str:
    """Name of the frame of reference on the floor below the hips of a player, which looks over the net and does not turn."""
    return f"player_{seat}"


Vector = Floats | tuple[float, float, float]
_UPRIGHT: Final = fox.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)


def _object(title: str, *fields: str, **nested: dict[str, Any]) -> dict[str, Any]:
    """JSON schema of an object; each of ``fields`` is a type and the names that have it."""
    properties = {name: {"type": kind} for kind, *names in map(str.split, fields) for name in names}
    return {"title": title, "type": "object", "properties": properties | nested}


_POINT: Final = _object("point", "number x y z speed")
_OPTION: Final = _object("shuttle_marl.Option", "string stroke", "number probability win_probability")
_SHOTS: Final = _object("shuttle_marl.Shots", " ".join(["number", *(shot.replace("-", "_") for shot in SHOTS)]))
_STROKE: Final = _object(
    "shuttle_marl.Stroke",
    "integer number seat",
    "string player stroke shot area height technique",
    "number p_succ p_ret probability estimate win_probability",
    "boolean hurried",
    "integer effort opponent_effort duel",
    "number contact_height speed_kmh flight_time",
    "string end waited",
)
SCHEMAS: Final[dict[str, dict[str, Any]]] = {  # of the topics that plots and tables read
    SCORE: _object(
        "shuttle_marl.Score",
        "integer rally match",
        "string name_0 name_1",
        "integer points_0 points_1 games_0 games_1 server winner",
        "string reason",
    ),
    STROKE: _STROKE,
    POLICY: _object(
        "shuttle_marl.Policy", "integer seat", "string player", top={"type": "array", "items": _OPTION}, shots=_SHOTS
    ),
    VALUE: _object("shuttle_marl.Value", "number rally_win_0 match_win_0 striker chosen"),
    STATE: _object("shuttle_marl.State", "string phase", shuttle=_POINT, player_0=_POINT, player_1=_POINT),
    SUMMARY: _object(
        "shuttle_marl.Summary", "integer rally", "string winner reason", strokes={"type": "array", "items": _STROKE}
    ),
}


Message = fox.SceneUpdate | fox.FrameTransforms | fox.Log | dict[str, Any]
Timed = tuple[int, str, Message]  # time [ns], topic and content of a message


def channels_of(context: Context) -> dict[str, Any]:
    """The channels of one scene, one for each topic."""
    scenes = {topic: channels.SceneUpdateChannel(topic, context=context) for topic in SCENES}
    others = {TF: channels.FrameTransformsChannel(TF, context=context), LOG: channels.LogChannel(LOG, context=context)}
    return {**scenes, **others, **{topic: Channel(topic, schema=schema, context=context) for topic, schema in SCHEMAS.items()}}


def stamp(nanoseconds: int) -> fox.Timestamp:
    """Time as a message field."""
    return fox.Timestamp(sec=nanoseconds // SECOND, nsec=nanoseconds % SECOND)


def colour(red: float, green: float, blue: float, alpha: float = 1.0) -> fox.Color:
    """An sRGB colour, each component from 0 to 1."""
    return fox.Color(r=red, g=green, b=blue, a=alpha)


def point(v: Vector) -> fox.Point3:
    """A point [m]."""
    return fox.Point3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def vector(v: Vector) -> fox.Vector3:
    """A vector [m]."""
    return fox.Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def at(v: Vector) -> fox.Pose:
    """Pose at a place, without rotation."""
    return fox.Pose(position=vector(v), orientation=_UPRIGHT)


def box(centre: Vector, size: Vector, shade: fox.Color) -> fox.CubePrimitive:
    """An axis-aligned box [m]."""
    return fox.CubePrimitive(pose=at(centre), size=vector(size), color=shade)


def line(kind: str, path: Iterable[Vector], thickness: float, shade: fox.Color, **options: Any) -> fox.LinePrimitive:
    """A line of a kind of ``LinePrimitiveLineType``; ``scale_invariant``: its thickness is in pixels at any distance."""
    points, options = [point(p) for p in path], {"pose": at((0, 0, 0)), **options}
    return fox.LinePrimitive(
        type=getattr(fox.LinePrimitiveLineType, kind), thickness=thickness, points=points, color=shade, **options
    )


def strip(path: F64, colours: list[fox.Color], thickness: float) -> fox.LinePrimitive:
    """A line with one colour, or one for each point."""
    many = colours if len(colours) > 1 else []
    return line("LineStrip", np.round(path, 3), thickness, colours[-1], scale_invariant=True, colors=many)


def disc(width: float, length: float, height: float, pose: fox.Pose, shade: fox.Color) -> fox.CylinderPrimitive:
    """An elliptic cylinder [m]."""
    return fox.CylinderPrimitive(pose=pose, size=vector((width, length, height)), bottom_scale=1.0, top_scale=1.0, color=shade)


def entity(name: str, time: int, frame_id: str = WORLD, *, fixed: bool = False, **shapes: Any) -> fox.SceneEntity:
    """Shapes on a frame of reference; ``fixed``: they move with it."""
    return fox.SceneEntity(id=name, timestamp=stamp(time), frame_id=frame_id, frame_locked=fixed, **shapes)


def label(text: str, place: Vector, pixels: float, shade: fox.Color) -> fox.TextPrimitive:
    """Text that faces the viewer, ``pixels`` high on the screen at any distance."""
    return fox.TextPrimitive(pose=at(place), billboard=True, font_size=pixels, scale_invariant=True, color=shade, text=text)


def entities_on(topic: str, time: int, entities: list[fox.SceneEntity]) -> Timed:
    """All entities of a topic of the 3D panel from a time on; earlier ones are deleted, so a seek finds all."""
    everything = fox.SceneEntityDeletion(timestamp=stamp(time), type=fox.SceneEntityDeletionType.All, id="")
    return time, topic, fox.SceneUpdate(deletions=[everything], entities=entities)


def known(content: dict[str, Any]) -> dict[str, Any]:
    """Entries that are neither None nor NaN."""
    unknown = {name for name, value in content.items() if value is None or (isinstance(value, float) and math.isnan(value))}
    return {name: value for name, value in content.items() if name not in unknown}


def numbers_on(topic: str, time: int, content: dict[str, Any]) -> Timed:
    """Numbers and text on a topic of the plots, without entries that are None or NaN."""
    return time, topic, known(content)


def log_line(time: int, text: str, name: str) -> Timed:
    """A line of the log."""
    return time, LOG, fox.Log(timestamp=stamp(time), level=fox.LogLevel.Info, message=text, name=name)


def name_lines(name: str, width: int = 22) -> list[str]:
    """A name in at most three lines; longer ones are truncated."""
    return textwrap.wrap(name, width, max_lines=3, placeholder="…") or [""]


_WHITE: Final = colour(0.96, 0.96, 0.94)
_BODY: Final = {"skin": colour(0.85, 0.65, 0.51), "hair": colour(0.16, 0.11, 0.08), "shoe": _WHITE}
_KITS: Final = (  # blue and red, as in the live court
    _BODY | {"shirt": colour(0.19, 0.44, 0.81), "shorts": colour(0.90, 0.90, 0.91)},
    _BODY | {"shirt": colour(0.85, 0.22, 0.25), "shorts": colour(0.19, 0.19, 0.25)},
)
_NAME_COLOURS: Final = (colour(0.55, 0.75, 1.0), colour(1.0, 0.55, 0.50))
_SIDES: Final = (("Left", -1.0), ("Right", 1.0))
_LIMBS: Final = (  # bone, next bone, share of the way to it, radius at both ends [m], colour
    ("Arm", "ForeArm", 1.0, 0.044, 0.040, "skin"),
    ("Arm", "ForeArm", 0.6, 0.064, 0.060, "shirt"),
    ("ForeArm", "Hand", 1.0, 0.040, 0.029, "skin"),
    ("UpLeg", "Leg", 1.0, 0.075, 0.056, "skin"),
    ("UpLeg", "Leg", 0.6, 0.098, 0.092, "shorts"),
    ("Leg", "Foot", 1.0, 0.054, 0.036, "skin"),
)
_TRUNK: Final = (
    ("Hips", (0.0, 0.0, -0.02), (0.35, 0.23, 0.26), "shorts"),
    ("Spine1", (0.0, 0.01, -0.02), (0.31, 0.21, 0.36), "shirt"),
    ("Spine2", (0.0, 0.05, 0.05), (0.40, 0.25, 0.36), "shirt"),
    ("Neck", (0.0, 0.01, 0.02), (0.11, 0.12, 0.16), "skin"),
    ("Head", (0.0, 0.025, 0.09), (0.155, 0.20, 0.235), "skin"),
    ("Head", (0.0, 0.0, 0.115), (0.165, 0.20, 0.21), "hair"),
)
_ENDS: Final = (  # of the right side; as in _TRUNK: bone, centre from its start at rest, diameters [m], colour
    ("Hand", (0.03, 0.03, -0.03), (0.085, 0.085, 0.10), "skin"),
    ("Foot", (0, 0.075, -0.04), (0.10, 0.29, 0.094), "shoe"),
)

_GRIP, _SHAFT = colour(0.35, 0.35, 0.33), colour(0.80, 0.82, 0.84)
_RIM, _STRINGS = colour(0.80, 0.10, 0.10), colour(0.95, 0.95, 0.90, 0.35)
_CORK, _FEATHERS = colour(0.93, 0.91, 0.86), colour(0.98, 0.98, 0.98)
_FLOOR, _MAT = colour(0.10, 0.16, 0.24), colour(0.06, 0.42, 0.30)
_SHADOW: Final = colour(0.0, 0.04, 0.02, 0.55)
_NAME_HEIGHT: Final = 2.3


def _rod(a: F64, b: F64, radius: float, until: float, shade: fox.Color) -> fox.CylinderPrimitive:
    along, wide = b - a, max(radius, until)
    turn = frame(along, np.array([1.0, 0.2, 0.1]))[:, [1, 2, 0]]  # whose third column is the line
    return fox.CylinderPrimitive(
        pose=_pose((a + b) / 2, turn),
        size=vector((2 * wide, 2 * wide, float(np.linalg.norm(along)))),
        bottom_scale=radius / wide,
        top_scale=until / wide,
        color=shade,
    )


def _pose(place: F64, turn: F64) -> fox.Pose:
    x, y, z, w = quaternion(turn).tolist()
    return fox.Pose(position=vector(place), orientation=fox.Quaternion(x=x, y=y, z=z, w=w))


def _ellipsoid(centre: Vector, size: Vector, shade: fox.Color) -> fox.SpherePrimitive:
    return fox.SpherePrimitive(pose=at(centre), size=vector(size), color=shade)


def players(time: int, motion: Motion, names: tuple[str, str]) -> list[fox.SceneEntity]:
    """Both players with rackets, names and shadows, and the shuttle."""
    shapes: dict[str, dict[str, Any]] = {SHUTTLE_FRAME: _shuttle(), SHUTTLE_FLOOR: {"cylinders": [_shadow(0.16)]}}
    for seat, kit in enumerate(_KITS):
        shapes |= {bone_frame(seat, bone): shape for bone, shape in _body(motion, seat, kit).items()}
        shapes[bone_frame(seat, "Racket")] = _racket(*motion.racket(seat))
        name = label("\n".join(name_lines(names[seat])), (0, 0, _NAME_HEIGHT), 16, _NAME_COLOURS[seat])
        shapes[place_frame(seat)] = {"texts": [name], "cylinders": [_shadow(0.62)]}
    return [entity(frame_id, time, frame_id, fixed=True, **shape) for frame_id, shape in shapes.items()]


def _shadow(width: float) -> fox.CylinderPrimitive:
    return disc(width, width, 0.002, at((0, 0, 0.012)), _SHADOW)


DRAWN: Final = (  # bones that have a shape
    *dict.fromkeys(bone for bone, *_ in _TRUNK),
    *dict.fromkeys(f"{side}{bone}" for side, _ in _SIDES for bone, *_ in (*_LIMBS, *_ENDS)),
    "Racket",
)


def _body(motion: Motion, seat: int, kit: dict[str, fox.Color]) -> dict[str, dict[str, list[Any]]]:
    out: dict[str, dict[str, list[Any]]] = {bone: {"cylinders": [], "spheres": []} for bone in DRAWN[:-1]}
    scale, rest = motion.skeletons[seat].scale, motion.rest(seat)

    def ellipsoid(bone: str, centre: Vector, size: Vector, shade: str) -> None:
        out[bone]["spheres"].append(_ellipsoid(scale * np.array(centre), scale * np.array(size), kit[shade]))

    for shape in _TRUNK:
        ellipsoid(*shape)
    for side, sign in _SIDES:
        for name, (x, y, z), size, shade in _ENDS:
            ellipsoid(side + name, (sign * x, y, z), size, shade)
        for name, following, share, near, far, shade in _LIMBS:
            bone, way = side + name, share * (rest[body.BONE[side + following]] - rest[body.BONE[side + name]])
            out[bone]["cylinders"].append(_rod(np.zeros(3), way, scale * near, scale * far, kit[shade]))
            ellipsoid(bone, (0, 0, 0), (2 * near, 2 * near, 2 * near), shade)
    return out


def _racket(shaft: F64, normal: F64) -> dict[str, list[Any]]:
    half, width = body.RACKET_HEAD
    pose = _pose(body.SWEET_SPOT * shaft, np.stack([np.cross(shaft, normal), shaft, normal], axis=-1))
    ring = [(width * np.cos(a), half * np.sin(a), 0.0) for a in np.linspace(0, 2 * np.pi, 24, endpoint=False)]
    rods = [
        _rod(body.RACKET_BUTT * shaft, 0.10 * shaft, 0.016, 0.012, _GRIP),
        _rod(0.10 * shaft, (body.SWEET_SPOT - half) * shaft, 0.008, 0.008, _SHAFT),
        disc(2 * width, 2 * half, 0.004, pose, _STRINGS),
    ]
    return {"cylinders": rods, "lines": [line("LineLoop", ring, 0.012, _RIM, pose=pose)]}


def _shuttle() -> dict[str, list[Any]]:
    """A shuttle that flies along z, with the origin in the cork; :data:`SHUTTLE_SCALE` times the real size."""
    (near, _, ahead), (far, _, behind) = body.SHUTTLE_SCALE * np.array(body.FEATHER)
    skirt = _rod(np.array([0.0, 0, -ahead]), np.array([0.0, 0, -behind]), near, far, _FEATHERS)
    diameter = 2 * body.SHUTTLE_SCALE * body.CORK
    return {"cylinders": [skirt], "spheres": [_ellipsoid((0, 0, 0), (diameter, diameter, diameter), _CORK)]}


def court(time: int) -> list[fox.SceneEntity]:
    """Court and net (BWF Laws of Badminton, Laws 1.1 to 1.10)."""
    edge_x, edge_y, half = laws.WIDTH / 2, laws.HALF_LENGTH, laws.LINE / 2
    boxes = [
        box((0, 0, -0.065), (laws.WIDTH + 4, laws.LENGTH + 4, 0.1), _FLOOR),
        box((0, 0, -0.0075), (laws.WIDTH + 1, laws.LENGTH + 1.2, 0.015), _MAT),
    ]

    def mark(x0: float, y0: float, x1: float, y1: float) -> None:
        size = (max(abs(x1 - x0), laws.LINE), max(abs(y1 - y0), laws.LINE), 0.003)
        boxes.append(box(((x0 + x1) / 2, (y0 + y1) / 2, 0.0015), size, _WHITE))

    for side in (-1, 1):
        for x in (edge_x, laws.HALF_WIDTH):
            mark(side * (x - half), -edge_y, side * (x - half), edge_y)
        for y in (edge_y - half, edge_y - laws.LONG_SERVICE, laws.SHORT_SERVICE + half):
            mark(-edge_x, side * y, edge_x, side * y)
        mark(0, side * laws.SHORT_SERVICE, 0, side * edge_y)
    return [entity("court", time, fixed=True, cubes=boxes), entity("net", time, fixed=True, **_net())]


def _net() -> dict[str, Any]:
    x = np.linspace(-laws.WIDTH / 2, laws.WIDTH / 2, 82)
    top = net_height(x)
    spans = list(itertools.pairwise(range(0, 82, 9)))
    strands = [p for i in range(82) for p in ((x[i], 0, top[i]), (x[i], 0, top[i] - laws.NET_DEPTH))]
    for drop in np.linspace(0, laws.NET_DEPTH, 11):
        strands += [(x[i], 0, top[i] - drop) for span in spans for i in span]
    mesh = line("LineList", strands, 1.0, colour(0.75, 0.78, 0.80, 0.55), scale_invariant=True)
    tape = [
        box(((x[a] + x[b]) / 2, 0, (top[a] + top[b] - laws.TAPE) / 2), (x[b] - x[a] + 0.002, 0.02, laws.TAPE), _WHITE)
        for a, b in spans
    ]
    high, grey = laws.NET_HEIGHT, colour(0.8, 0.8, 0.82)
    posts = [box((side * laws.WIDTH / 2, 0, high / 2), (0.04, 0.04, high), grey) for side in (-1, 1)]
    return {"lines": [mesh], "cubes": tape + posts}
