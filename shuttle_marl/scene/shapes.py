"""Court, net, players and shuttle as boxes, cylinders and ellipsoids, each fixed to a frame of reference."""

import itertools
from typing import Any, Final

import numpy as np
from foxglove.messages import (
    Color,
    CylinderPrimitive,
    LinePrimitive,
    LinePrimitiveLineType,
    Pose,
    Quaternion,
    SceneEntity,
    SpherePrimitive,
)

from shuttle_marl.base.arrays import F64
from shuttle_marl.game.court import (
    HALF_LENGTH,
    HALF_WIDTH,
    LENGTH,
    LINE,
    LONG_SERVICE,
    NET_DEPTH,
    NET_HEIGHT,
    SHORT_SERVICE,
    TAPE,
    WIDTH,
)
from shuttle_marl.scene.board import name_lines
from shuttle_marl.scene.topics import (
    SHUTTLE_FLOOR,
    SHUTTLE_FRAME,
    WORLD,
    Vector,
    at,
    bone_frame,
    box,
    colour,
    label,
    place_frame,
    point,
    stamp,
    vector,
)
from shuttle_marl.staging import CORK, FEATHER, RACKET_BUTT, RACKET_HEAD, SHUTTLE_SCALE, SWEET_SPOT, Motion
from shuttle_marl.staging.flight import net_height
from shuttle_marl.staging.rotation import frame, quaternion
from shuttle_marl.staging.skeleton import BONE

_WHITE: Final = colour(0.96, 0.96, 0.94)
_BODY: Final = {"skin": colour(0.85, 0.65, 0.51), "hair": colour(0.16, 0.11, 0.08), "shoe": _WHITE}
_KITS: Final = (
    _BODY | {"shirt": colour(0.19, 0.44, 0.81), "shorts": colour(0.90, 0.90, 0.91)},
    _BODY | {"shirt": colour(0.85, 0.22, 0.25), "shorts": colour(0.19, 0.19, 0.25)},
)
"""Colours of seats 0 and 1: blue and red, as in the live court."""
_NAME_COLOURS: Final = (colour(0.55, 0.75, 1.0), colour(1.0, 0.55, 0.50))
_SIDES: Final = (("Left", -1.0), ("Right", 1.0))
_LIMBS: Final = (
    ("Arm", "ForeArm", 1.0, 0.044, 0.040, "skin"),
    ("Arm", "ForeArm", 0.6, 0.064, 0.060, "shirt"),
    ("ForeArm", "Hand", 1.0, 0.040, 0.029, "skin"),
    ("UpLeg", "Leg", 1.0, 0.075, 0.056, "skin"),
    ("UpLeg", "Leg", 0.6, 0.098, 0.092, "shorts"),
    ("Leg", "Foot", 1.0, 0.054, 0.036, "skin"),
)
"""Limbs of each side: bone, next bone, share of the way to it, radius at both ends [m], colour."""
_TRUNK: Final = (
    ("Hips", (0.0, 0.0, -0.02), (0.35, 0.23, 0.26), "shorts"),
    ("Spine1", (0.0, 0.01, -0.02), (0.31, 0.21, 0.36), "shirt"),
    ("Spine2", (0.0, 0.05, 0.05), (0.40, 0.25, 0.36), "shirt"),
    ("Neck", (0.0, 0.01, 0.02), (0.11, 0.12, 0.16), "skin"),
    ("Head", (0.0, 0.025, 0.09), (0.155, 0.20, 0.235), "skin"),
    ("Head", (0.0, 0.0, 0.115), (0.165, 0.20, 0.21), "hair"),
)
_ENDS: Final = (
    ("Hand", (0.03, 0.03, -0.03), (0.085, 0.085, 0.10), "skin"),
    ("Foot", (0, 0.075, -0.04), (0.10, 0.29, 0.094), "shoe"),
)
"""Ellipsoids of the trunk, and of the right hand and foot: bone, centre from the bone's start at rest, diameters [m], colour."""

_GRIP, _SHAFT = colour(0.35, 0.35, 0.33), colour(0.80, 0.82, 0.84)
_RIM, _STRINGS = colour(0.80, 0.10, 0.10), colour(0.95, 0.95, 0.90, 0.35)
_CORK, _FEATHERS = colour(0.93, 0.91, 0.86), colour(0.98, 0.98, 0.98)
_FLOOR, _MAT = colour(0.10, 0.16, 0.24), colour(0.06, 0.42, 0.30)
_SHADOW: Final = colour(0.0, 0.04, 0.02, 0.55)
_NAME_HEIGHT: Final = 2.3


def _rod(a: F64, b: F64, radius: float, until: float, shade: Color) -> CylinderPrimitive:
    """A cone along the line from a to b, with a radius at each end [m]."""
    along, wide = b - a, max(radius, until)
    turn = frame(along, np.array([1.0, 0.2, 0.1]))[:, [1, 2, 0]]  # whose third column is the line
    return CylinderPrimitive(
        pose=_pose((a + b) / 2, turn),
        size=vector((2 * wide, 2 * wide, float(np.linalg.norm(along)))),
        bottom_scale=radius / wide,
        top_scale=until / wide,
        color=shade,
    )


def _disc(width: float, length: float, height: float, pose: Pose, shade: Color) -> CylinderPrimitive:
    return CylinderPrimitive(pose=pose, size=vector((width, length, height)), bottom_scale=1.0, top_scale=1.0, color=shade)


def _pose(place: F64, turn: F64) -> Pose:
    x, y, z, w = quaternion(turn).tolist()
    return Pose(position=vector(place), orientation=Quaternion(x=x, y=y, z=z, w=w))


def _ellipsoid(centre: Vector, size: Vector, shade: Color) -> SpherePrimitive:
    return SpherePrimitive(pose=at(centre), size=vector(size), color=shade)


def players(time: int, motion: Motion, names: tuple[str, str]) -> list[SceneEntity]:
    """Both players with rackets, names and shadows, and the shuttle."""
    shapes: dict[str, dict[str, Any]] = {SHUTTLE_FRAME: _shuttle(), SHUTTLE_FLOOR: {"cylinders": [_shadow(0.16)]}}
    for seat, kit in enumerate(_KITS):
        shapes |= {bone_frame(seat, bone): shape for bone, shape in _body(motion, seat, kit).items()}
        shapes[bone_frame(seat, "Racket")] = _racket(*motion.racket(seat))
        name = label("\n".join(name_lines(names[seat])), (0, 0, _NAME_HEIGHT), 16, _NAME_COLOURS[seat])
        shapes[place_frame(seat)] = {"texts": [name], "cylinders": [_shadow(0.62)]}
    return [_fixed(frame_id, time, **shape) for frame_id, shape in shapes.items()]


def _fixed(frame_id: str, time: int, **shapes: Any) -> SceneEntity:
    return SceneEntity(id=frame_id, timestamp=stamp(time), frame_id=frame_id, frame_locked=True, **shapes)


def _shadow(width: float) -> CylinderPrimitive:
    return _disc(width, width, 0.002, at((0, 0, 0.012)), _SHADOW)


DRAWN: Final = (
    *dict.fromkeys(bone for bone, *_ in _TRUNK),
    *dict.fromkeys(f"{side}{bone}" for side, _ in _SIDES for bone, *_ in (*_LIMBS, *_ENDS)),
    "Racket",
)
"""Bones that have a shape."""


def _body(motion: Motion, seat: int, kit: dict[str, Color]) -> dict[str, dict[str, list[Any]]]:
    """Limbs, joints, trunk and head by bone."""
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
            bone, way = side + name, share * (rest[BONE[side + following]] - rest[BONE[side + name]])
            out[bone]["cylinders"].append(_rod(np.zeros(3), way, scale * near, scale * far, kit[shade]))
            ellipsoid(bone, (0, 0, 0), (2 * near, 2 * near, 2 * near), shade)
    return out


def _racket(shaft: F64, normal: F64) -> dict[str, list[Any]]:
    half, width = RACKET_HEAD
    pose = _pose(SWEET_SPOT * shaft, np.stack([np.cross(shaft, normal), shaft, normal], axis=-1))
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = LinePrimitive(
        type=LinePrimitiveLineType.LineLoop,
        pose=pose,
        thickness=0.012,
        points=[point((width * np.cos(a), half * np.sin(a), 0.0)) for a in angle],
        color=_RIM,
    )
    rods = [
        _rod(RACKET_BUTT * shaft, 0.10 * shaft, 0.016, 0.012, _GRIP),
        _rod(0.10 * shaft, (SWEET_SPOT - half) * shaft, 0.008, 0.008, _SHAFT),
        _disc(2 * width, 2 * half, 0.004, pose, _STRINGS),
    ]
    return {"cylinders": rods, "lines": [rim]}


def _shuttle() -> dict[str, list[Any]]:
    """A shuttle that flies along z, with the origin in the cork; :data:`SHUTTLE_SCALE` times the real size."""
    (near, _, ahead), (far, _, behind) = SHUTTLE_SCALE * np.array(FEATHER)
    skirt = _rod(np.array([0.0, 0, -ahead]), np.array([0.0, 0, -behind]), near, far, _FEATHERS)
    diameter = 2 * SHUTTLE_SCALE * CORK
    return {"cylinders": [skirt], "spheres": [_ellipsoid((0, 0, 0), (diameter, diameter, diameter), _CORK)]}


def court(time: int) -> list[SceneEntity]:
    """Court and net (BWF Laws of Badminton, Laws 1.1 to 1.10)."""
    edge_x, edge_y = WIDTH / 2, HALF_LENGTH
    boxes = [
        box((0, 0, -0.065), (WIDTH + 4, LENGTH + 4, 0.1), _FLOOR),
        box((0, 0, -0.0075), (WIDTH + 1, LENGTH + 1.2, 0.015), _MAT),
    ]

    def line(x0: float, y0: float, x1: float, y1: float) -> None:
        size = (max(abs(x1 - x0), LINE), max(abs(y1 - y0), LINE), 0.003)
        boxes.append(box(((x0 + x1) / 2, (y0 + y1) / 2, 0.0015), size, _WHITE))

    half = LINE / 2
    for side in (-1, 1):
        for x in (edge_x, HALF_WIDTH):
            line(side * (x - half), -edge_y, side * (x - half), edge_y)
        for y in (edge_y - half, edge_y - LONG_SERVICE, SHORT_SERVICE + half):
            line(-edge_x, side * y, edge_x, side * y)
        line(0, side * SHORT_SERVICE, 0, side * edge_y)
    shapes: dict[str, Any] = {"court": {"cubes": boxes}, "net": _net()}
    return [
        SceneEntity(id=name, timestamp=stamp(time), frame_id=WORLD, frame_locked=True, **each) for name, each in shapes.items()
    ]


def _net() -> dict[str, list[Any]]:
    x = np.linspace(-WIDTH / 2, WIDTH / 2, 82)
    top = net_height(x)
    spans = list(itertools.pairwise(range(0, 82, 9)))
    strands = [p for i in range(82) for p in ((x[i], 0, top[i]), (x[i], 0, top[i] - NET_DEPTH))]
    for drop in np.linspace(0, NET_DEPTH, 11):
        strands += [(x[i], 0, top[i] - drop) for span in spans for i in span]
    mesh = LinePrimitive(
        type=LinePrimitiveLineType.LineList,
        pose=at((0, 0, 0)),
        thickness=1.0,
        scale_invariant=True,
        points=[point(p) for p in strands],
        color=colour(0.75, 0.78, 0.80, 0.55),
    )
    tape = [
        box(((x[a] + x[b]) / 2, 0, (top[a] + top[b] - TAPE) / 2), (x[b] - x[a] + 0.002, 0.02, TAPE), _WHITE) for a, b in spans
    ]
    posts = [box((side * WIDTH / 2, 0, NET_HEIGHT / 2), (0.04, 0.04, NET_HEIGHT), colour(0.8, 0.8, 0.82)) for side in (-1, 1)]
    return {"lines": [mesh], "cubes": tape + posts}
