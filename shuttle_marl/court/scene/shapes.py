"""Shapes of a scene, of spheres, cylinders, boxes and lines: court and net, and players, rackets and shuttle on their bones."""

import itertools
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from foxglove import messages as fox

from shuttle_marl.base.arrays import F64, Floats
from shuttle_marl.court.staging import Motion
from shuttle_marl.court.staging import skeleton as body
from shuttle_marl.court.staging.flight import net_height
from shuttle_marl.court.staging.geometry import frame, quaternion
from shuttle_marl.game import court as laws

SECOND: Final = 1_000_000_000  # [ns]
WORLD: Final = "court"  # frame of reference of the court, on which all others are placed
SHUTTLE_FRAME: Final = "shuttle"  # moves and turns with the shuttle; the cork points along z
SHUTTLE_FLOOR: Final = "shuttle_floor"  # on the floor below the shuttle

Vector = Floats | tuple[float, float, float]
Shapes = dict[str, Any]  # by the name of the field of an entity


def bone_frame(seat: int, bone: str) -> str:
    """Name of the frame of reference of a bone."""
    return f"{seat}/{bone}"


def place_frame(seat: int) -> str:
    """Name of the frame of reference on the floor below the hips of a player, which does not turn."""
    return f"player_{seat}"


def stamp(nanoseconds: int) -> fox.Timestamp:
    """Time as a message field."""
    return fox.Timestamp(sec=nanoseconds // SECOND, nsec=nanoseconds % SECOND)


def colour(red: float, green: float, blue: float, alpha: float = 1.0) -> fox.Color:
    """An sRGB colour, each component from 0 to 1."""
    return fox.Color(r=red, g=green, b=blue, a=alpha)


def vector(v: Vector) -> fox.Vector3:
    """A vector [m]."""
    return fox.Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def rotation(q: Floats) -> fox.Quaternion:
    """A rotation from x, y, z, w."""
    return fox.Quaternion(x=float(q[0]), y=float(q[1]), z=float(q[2]), w=float(q[3]))


def pose(place: Vector, turn: F64 | None = None) -> fox.Pose:
    """A place, and a rotation matrix."""
    q = np.array([0.0, 0.0, 0.0, 1.0]) if turn is None else quaternion(turn)
    return fox.Pose(position=vector(place), orientation=rotation(q))


def box(centre: Vector, size: Vector, shade: fox.Color) -> fox.CubePrimitive:
    """An axis-aligned box [m]."""
    return fox.CubePrimitive(pose=pose(centre), size=vector(size), color=shade)


def disc(where: fox.Pose, size: Vector, shade: fox.Color) -> fox.CylinderPrimitive:
    """An elliptic cylinder [m]."""
    return fox.CylinderPrimitive(pose=where, size=vector(size), bottom_scale=1.0, top_scale=1.0, color=shade)


def line(kind: str, path: Iterable[Vector], thickness: float, shade: fox.Color, *, pixels: bool = True) -> fox.LinePrimitive:
    """A line of a kind of ``LinePrimitiveLineType``; ``pixels``: so thick on the screen at any distance, else in metres."""
    points = [fox.Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in path]
    return fox.LinePrimitive(
        type=getattr(fox.LinePrimitiveLineType, kind),
        pose=pose((0, 0, 0)),
        thickness=thickness,
        scale_invariant=pixels,
        points=points,
        color=shade,
    )


def label(text: str, place: Vector, shade: fox.Color) -> fox.TextPrimitive:
    """Text that faces the viewer, of one size on the screen at any distance."""
    return fox.TextPrimitive(pose=pose(place), billboard=True, font_size=16, scale_invariant=True, color=shade, text=text)


def entity(name: str, time: int, frame_id: str = WORLD, *, fixed: bool = False, **shapes: Any) -> fox.SceneEntity:
    """Shapes on a frame of reference; ``fixed``: they move with it."""
    return fox.SceneEntity(id=name, timestamp=stamp(time), frame_id=frame_id, frame_locked=fixed, **shapes)


WHITE: Final = colour(0.96, 0.96, 0.94)
_BODY: Final = {"skin": colour(0.85, 0.65, 0.51), "hair": colour(0.16, 0.11, 0.08), "shoe": WHITE}
_KITS: Final = (  # blue and red, as in the live court
    _BODY | {"shirt": colour(0.19, 0.44, 0.81), "shorts": colour(0.90, 0.90, 0.91), "name": colour(0.55, 0.75, 1.0)},
    _BODY | {"shirt": colour(0.85, 0.22, 0.25), "shorts": colour(0.19, 0.19, 0.25), "name": colour(1.0, 0.55, 0.50)},
)
_LIMBS: Final = (  # bone, next bone, share of the way to it, radius at both ends [m], colour
    ("Arm", "ForeArm", 1.0, 0.044, 0.040, "skin"),
    ("Arm", "ForeArm", 0.6, 0.064, 0.060, "shirt"),
    ("ForeArm", "Hand", 1.0, 0.040, 0.029, "skin"),
    ("UpLeg", "Leg", 1.0, 0.075, 0.056, "skin"),
    ("UpLeg", "Leg", 0.6, 0.098, 0.092, "shorts"),
    ("Leg", "Foot", 1.0, 0.054, 0.036, "skin"),
)
_BALLS: Final = (  # bone, centre from its start at rest, diameters [m], colour
    ("Hips", (0.0, 0.0, -0.02), (0.35, 0.23, 0.26), "shorts"),
    ("Spine1", (0.0, 0.01, -0.02), (0.31, 0.21, 0.36), "shirt"),
    ("Spine2", (0.0, 0.05, 0.05), (0.40, 0.25, 0.36), "shirt"),
    ("Neck", (0.0, 0.01, 0.02), (0.11, 0.12, 0.16), "skin"),
    ("Head", (0.0, 0.025, 0.09), (0.155, 0.20, 0.235), "skin"),
    ("Head", (0.0, 0.0, 0.115), (0.165, 0.20, 0.21), "hair"),
    ("LeftHand", (-0.03, 0.03, -0.03), (0.085, 0.085, 0.10), "skin"),
    ("RightHand", (0.03, 0.03, -0.03), (0.085, 0.085, 0.10), "skin"),
    ("LeftFoot", (0.0, 0.075, -0.04), (0.10, 0.29, 0.094), "shoe"),
    ("RightFoot", (0.0, 0.075, -0.04), (0.10, 0.29, 0.094), "shoe"),
)
_SIDES: Final = ("Left", "Right")
_SHAFT, _RIM, _STRINGS = colour(0.80, 0.82, 0.84), colour(0.80, 0.10, 0.10), colour(0.95, 0.95, 0.90, 0.35)
_CORK, _FEATHERS = colour(0.93, 0.91, 0.86), colour(0.98, 0.98, 0.98)
_FLOOR, _MAT, _POST, _MESH = (
    colour(0.10, 0.16, 0.24),
    colour(0.06, 0.42, 0.30),
    colour(0.8, 0.8, 0.82),
    colour(0.75, 0.78, 0.8, 0.35),
)
_SHADOW: Final = colour(0.0, 0.04, 0.02, 0.55)
DRAWN: Final = tuple(  # bones that have a shape
    dict.fromkeys([*(bone for bone, *_ in _BALLS), *(side + bone for side in _SIDES for bone, *_ in _LIMBS), "Racket"])
)


def _rod(a: F64, b: F64, radius: float, until: float, shade: fox.Color) -> fox.CylinderPrimitive:
    along, wide = b - a, max(radius, until)
    turn = frame(along, np.array([1.0, 0.2, 0.1]))[:, [1, 2, 0]]  # whose third column is the line
    return fox.CylinderPrimitive(
        pose=pose((a + b) / 2, turn),
        size=vector((2 * wide, 2 * wide, float(np.linalg.norm(along)))),
        bottom_scale=radius / wide,
        top_scale=until / wide,
        color=shade,
    )


def _ball(centre: Vector, size: Vector, shade: fox.Color) -> fox.SpherePrimitive:
    return fox.SpherePrimitive(pose=pose(centre), size=vector(size), color=shade)


def players(time: int, motion: Motion, names: tuple[str, str]) -> list[fox.SceneEntity]:
    """Both players with rackets, names and shadows, and the shuttle, each on its frame of reference."""
    shapes: dict[str, Shapes] = {SHUTTLE_FRAME: _shuttle(), SHUTTLE_FLOOR: _shadow(0.16)}
    for seat, kit in enumerate(_KITS):
        shapes |= {bone_frame(seat, bone): shape for bone, shape in _limbs(motion, seat, kit).items()}
        shapes[bone_frame(seat, "Racket")] = _racket(*motion.racket(seat))
        shapes[place_frame(seat)] = {"texts": [label(names[seat], (0, 0, 2.3), kit["name"])], **_shadow(0.62)}
    return [entity(frame_id, time, frame_id, fixed=True, **shape) for frame_id, shape in shapes.items()]


def _shadow(width: float) -> Shapes:
    return {"cylinders": [disc(pose((0, 0, 0.012)), (width, width, 0.002), _SHADOW)]}


def _limbs(motion: Motion, seat: int, kit: dict[str, fox.Color]) -> dict[str, Shapes]:
    out: dict[str, Shapes] = {bone: {"cylinders": [], "spheres": []} for bone in DRAWN[:-1]}
    scale, rest = motion.skeletons[seat].scale, motion.rest(seat)
    for bone, centre, size, shade in _BALLS:
        out[bone]["spheres"].append(_ball(scale * np.array(centre), scale * np.array(size), kit[shade]))
    for side, (name, following, share, near, far, shade) in itertools.product(_SIDES, _LIMBS):
        bone, way = side + name, share * (rest[body.BONE[side + following]] - rest[body.BONE[side + name]])
        out[bone]["cylinders"].append(_rod(np.zeros(3), way, scale * near, scale * far, kit[shade]))
        out[bone]["spheres"].append(_ball((0, 0, 0), np.full(3, 2 * scale * near), kit[shade]))
    return out


def _racket(shaft: F64, normal: F64) -> Shapes:
    half, width = body.RACKET_HEAD
    across, middle = np.cross(shaft, normal), body.SWEET_SPOT * shaft
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None]
    ring = middle + width * np.cos(angles) * across + half * np.sin(angles) * shaft
    strings = disc(pose(middle, np.stack([across, shaft, normal], axis=-1)), (2 * width, 2 * half, 0.004), _STRINGS)
    handle = _rod(body.RACKET_BUTT * shaft, (body.SWEET_SPOT - half) * shaft, 0.014, 0.008, _SHAFT)
    return {"cylinders": [handle, strings], "lines": [line("LineLoop", ring, 0.012, _RIM, pixels=False)]}


def _shuttle() -> Shapes:
    """A shuttle that flies along z, with the origin in the cork; ``SHUTTLE_SCALE`` times the real size."""
    (near, _, ahead), (far, _, behind) = body.SHUTTLE_SCALE * np.array(body.FEATHER)
    skirt = _rod(np.array([0.0, 0, -ahead]), np.array([0.0, 0, -behind]), near, far, _FEATHERS)
    return {"cylinders": [skirt], "spheres": [_ball((0, 0, 0), np.full(3, 2 * body.SHUTTLE_SCALE * body.CORK), _CORK)]}


def court(time: int) -> list[fox.SceneEntity]:
    """Court and net (BWF Laws of Badminton, Laws 1.1 to 1.10)."""
    edge_x, edge_y, half = laws.WIDTH / 2, laws.HALF_LENGTH, laws.LINE / 2
    boxes = [
        box((0, 0, -0.065), (laws.WIDTH + 4, laws.LENGTH + 4, 0.1), _FLOOR),
        box((0, 0, -0.0075), (laws.WIDTH + 1, laws.LENGTH + 1.2, 0.015), _MAT),
    ]
    for side in (-1, 1):
        marks = [(side * (x - half), 0.0, laws.LINE, laws.LENGTH) for x in (edge_x, laws.HALF_WIDTH)]
        across = (edge_y - half, edge_y - laws.LONG_SERVICE, laws.SHORT_SERVICE + half)
        marks += [(0.0, side * y, laws.WIDTH, laws.LINE) for y in across]
        marks.append((0.0, side * (laws.SHORT_SERVICE + edge_y) / 2, laws.LINE, edge_y - laws.SHORT_SERVICE))
        boxes += [box((x, y, 0.0015), (width, length, 0.003), WHITE) for x, y, width, length in marks]
    return [entity("court", time, fixed=True, cubes=boxes), entity("net", time, fixed=True, cubes=_net())]


def _net() -> list[fox.CubePrimitive]:
    high = laws.NET_HEIGHT
    boxes = [box((side * laws.WIDTH / 2, 0, high / 2), (0.04, 0.04, high), _POST) for side in (-1, 1)]
    width, mesh = laws.WIDTH / 9, laws.NET_DEPTH - laws.TAPE
    for x in width * np.arange(-4, 5):
        top = float(net_height(x))
        boxes.append(box((x, 0, top - laws.TAPE / 2), (width + 0.002, 0.02, laws.TAPE), WHITE))
        boxes.append(box((x, 0, top - laws.TAPE - mesh / 2), (width, 0.006, mesh), _MESH))
    return boxes
