"""Court and net, and models of athletes, rackets and shuttle that follow frames of reference.

Athletes consist of rigid parts, one per bone, because viewers of scenes do not support skinning. A triangle belongs to the bone
with the largest weight and to every other bone with a noticeable one, so parts overlap at joints and no gap opens when they bend.
"""

import dataclasses
import functools
import itertools
from typing import Any, Final

import numpy as np
import pygltflib as gltf
from foxglove.messages import CylinderPrimitive, LinePrimitive, LinePrimitiveLineType, SceneEntity

from shuttle_marl.base.arrays import F64, I64
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
from shuttle_marl.scene.mesh import Mesh, joined, lathe, moved, normals_of, read_array, read_file, tube
from shuttle_marl.scene.topics import (
    SHADOWS,
    SHUTTLE_FRAME,
    WORLD,
    at,
    bone_frame,
    box,
    colour,
    label,
    model,
    name_frame,
    point,
    stamp,
    vector,
)
from shuttle_marl.staging import (
    CORK,
    FEATHER,
    FEATHERS,
    RACKET_BUTT,
    RACKET_HEAD,
    SHUTTLE_SCALE,
    SWEET_SPOT,
    Motion,
    finger_pose,
    load_skeleton,
    model_file,
)
from shuttle_marl.staging.flight import net_height
from shuttle_marl.staging.rotation import frame, matrix, unit
from shuttle_marl.staging.skeleton import BONE

Colour = tuple[float, float, float]

_FROM_GLTF: Final = np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
"""Rotation from the axes of athletes' files (y up, facing +z) to those of the staging (z up, facing +y)."""
_SHARED: Final = 0.12
"""Smallest mean weight for which a triangle also belongs to a bone that is not its main one."""

_THICK: Final = 0.008
"""Radius of the shaft [m], twice the real one, to be visible across the court."""
_GRIP: Final = (0.62, 0.62, 0.58)
_SHAFT: Final = (0.70, 0.72, 0.75)
_FRAME: Final = (0.55, 0.02, 0.02)
_STRING: Final = (0.85, 0.85, 0.80)
_CORK: Final = (0.90, 0.88, 0.80)
_BAND: Final = (0.02, 0.25, 0.08)
_FEATHER: Final = (0.95, 0.95, 0.95)

KITS: Final[tuple[tuple[Colour, Colour], ...]] = (
    ((0.03, 0.16, 0.62), (0.80, 0.80, 0.82)),
    ((0.70, 0.04, 0.05), (0.03, 0.03, 0.05)),
)
"""Linear colours of shirt and shorts of seats 0 and 1: blue and red, as in the live court."""
NAME_COLOURS: Final = (colour(0.55, 0.75, 1.0), colour(1.0, 0.55, 0.50))

_FLOOR, _MAT = colour(0.10, 0.16, 0.24), colour(0.06, 0.42, 0.30)
_SHADOW: Final = colour(0.0, 0.04, 0.02, 0.55)
_SHADOW_SIZES: Final = (0.62, 0.62, 0.16)
"""Diameters of the shadows of seats 0 and 1 and of the shuttle [m]."""
_WHITE: Final = colour(0.96, 0.96, 0.94)


@functools.cache
def athlete(name: str, *, right_handed: bool, shirt: Colour, shorts: Colour) -> dict[str, list[Mesh]]:
    """Meshes of an athlete by bone, with the origin at the joint of the bone.

    Raises:
        StagingError: unknown athlete.
    """
    document = read_file(model_file(name))
    rest = load_skeleton(name).rest_pose(right_handed=right_handed)
    bones, turn, offset = _fingers(document, name, right_handed, rest)
    out: dict[str, list[Mesh]] = {}
    for primitive in document.meshes[0].primitives:
        material, attributes = document.materials[primitive.material], primitive.attributes
        colour = {"shirt": shirt, "shorts": shorts}.get(material.name)
        position, normal = read_array(document, attributes.POSITION), read_array(document, attributes.NORMAL)
        joint, weight = read_array(document, attributes.JOINTS_0), read_array(document, attributes.WEIGHTS_0)
        position, normal = position @ _FROM_GLTF, normal @ _FROM_GLTF
        position = (weight[..., None] * (np.einsum("vkij,vj->vki", turn[joint], position) + offset[joint])).sum(axis=1)
        normal = unit((weight[..., None] * np.einsum("vkij,vj->vki", turn[joint], normal)).sum(axis=1))
        pull = np.zeros((len(position), len(BONE)))
        np.add.at(pull, (np.arange(len(position))[:, None], bones[joint]), weight)
        triangles = read_array(document, primitive.indices).reshape(-1, 3).astype(np.int64)
        mean = pull[triangles].mean(axis=1)
        mine = (mean >= _SHARED) | (mean == mean.max(axis=1, keepdims=True))
        for bone, index in BONE.items():
            chosen = triangles[mine[:, index]]
            if not len(chosen):
                continue
            used, renumbered = np.unique(chosen, return_inverse=True)
            red, green, blue = colour or material.pbrMetallicRoughness.baseColorFactor[:3]
            mesh = Mesh(
                vertices=position[used] - rest[index],
                normals=normal[used],
                triangles=renumbered.reshape(-1, 3),
                colour=(red, green, blue),
                two_sided=material.doubleSided,
            )
            out.setdefault(bone, []).append(mesh)
    return {bone: joined(meshes) for bone, meshes in out.items()}


def _fingers(document: gltf.GLTF2, name: str, right_handed: bool, rest: F64) -> tuple[I64, F64, F64]:
    """For each joint of the file: bone of the staging, and rotation and translation of bent fingers."""
    nodes = document.nodes
    parent = {child: i for i, node in enumerate(nodes) for child in node.children}
    pose = finger_pose(name, right_handed=right_handed)
    joints = document.skins[0].joints
    head, bones = np.zeros((len(joints), 3)), np.zeros(len(joints), dtype=np.int64)
    turn, place = np.zeros((len(joints), 3, 3)), np.zeros((len(joints), 3))
    for i in joints:  # parents come before their children
        bone, up = nodes[i].name, parent.get(i, -1)
        head[i] = np.array(nodes[i].translation) @ _FROM_GLTF + (head[up] if up in joints else 0)
        if bone in BONE:
            bones[i], turn[i], place[i] = BONE[bone], np.eye(3), rest[BONE[bone]]
            continue
        bones[i] = bones[up]
        turn[i] = turn[up] @ matrix(pose[bone]) if bone in pose else turn[up]
        place[i] = place[up] + turn[up] @ (head[i] - head[up])
    return bones, turn, place - np.einsum("jab,jb->ja", turn, head)


def racket(shaft: F64, normal: F64) -> list[Mesh]:
    """A racket with the origin at the middle of the grip.

    Args:
        shaft: ``[3]`` direction of the shaft, a unit vector.
        normal: ``[3]`` normal of the strings, a unit vector.
    """
    neck = SWEET_SPOT - RACKET_HEAD[0]
    meshes = [
        lathe([(0.0, RACKET_BUTT), (0.016, RACKET_BUTT), (0.013, -0.02), (0.012, 0.09), (0.006, 0.11), (0.0, 0.11)], _GRIP, 10),
        lathe([(0.0, 0.10), (_THICK, 0.10), (_THICK, neck), (0.0, neck)], _SHAFT, 8),
    ]
    angle = np.linspace(0, 2 * np.pi, 41)
    ring = np.stack([RACKET_HEAD[1] * np.sin(angle), np.zeros(41), SWEET_SPOT - RACKET_HEAD[0] * np.cos(angle)], axis=-1)
    meshes.append(tube(ring, 0.006, _FRAME))
    for axes, (reach, width) in (([0, 2], RACKET_HEAD), ([2, 0], RACKET_HEAD[::-1])):
        for side in np.linspace(-0.86, 0.86, 11) * width:
            half = reach * np.sqrt(1 - (side / width) ** 2)
            string = np.zeros((2, 3))
            string[:, axes] = [[side, -half], [side, half]]
            meshes.append(tube(string + np.array([0, 0, SWEET_SPOT]), 0.0009, _STRING, 4))
    # The meshes above have the shaft along z and the normal along y.
    basis = frame(shaft, normal)
    turn = np.stack([np.cross(basis[:, 1], basis[:, 0]), basis[:, 1], basis[:, 0]], axis=1)
    return [moved(mesh, turn, np.zeros(3)) for mesh in joined(meshes)]


def shuttle() -> list[Mesh]:
    """A feather shuttle that flies along +z, with the origin in the cork; :data:`SHUTTLE_SCALE` times the real size."""
    bow = [(CORK * np.sin(a), 0.012 - CORK * (1 - np.cos(a))) for a in np.linspace(np.pi / 2, 0, 6)]
    meshes = [lathe([(CORK, -CORK), *bow], _CORK, 14), lathe([(1.02 * CORK, -0.014), (1.02 * CORK, -0.010)], _BAND, 14)]
    (near, narrow, ahead), (far, wide, behind) = FEATHER
    for angle in np.arange(FEATHERS) * 2 * np.pi / FEATHERS:
        vane = np.array([[near, -narrow, -ahead], [near, narrow, -ahead], [far, wide, -behind], [far, -wide, -behind]])
        c, s = np.cos(angle), np.sin(angle)
        vertices = vane @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        triangles = np.array([[0, 2, 1], [0, 3, 2]])
        normals = normals_of(vertices, triangles)
        meshes.append(Mesh(vertices=vertices, normals=normals, triangles=triangles, colour=_FEATHER, two_sided=True))
    return [dataclasses.replace(mesh, vertices=SHUTTLE_SCALE * mesh.vertices) for mesh in joined(meshes)]


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
    ground = SceneEntity(id="court", timestamp=stamp(time), frame_id=WORLD, frame_locked=True, cubes=boxes)
    return [ground, _net(time)]


def _net(time: int) -> SceneEntity:
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
    return SceneEntity(id="net", timestamp=stamp(time), frame_id=WORLD, frame_locked=True, lines=[mesh], cubes=tape + posts)


def players(time: int, motion: Motion, names: tuple[str, str]) -> list[SceneEntity]:
    """Models that follow the bones of both players and the shuttle, with names over the heads and shadows."""

    def attached(to: str, **content: Any) -> SceneEntity:
        return SceneEntity(id=to, timestamp=stamp(time), frame_id=to, frame_locked=True, **content)

    out = [attached(SHUTTLE_FRAME, models=[model(shuttle())])]
    for shadow, width in zip(SHADOWS, _SHADOW_SIZES, strict=True):
        size = vector((width, width, 0.002))
        disc = CylinderPrimitive(pose=at((0, 0, 0)), size=size, bottom_scale=1.0, top_scale=1.0, color=_SHADOW)
        out.append(attached(shadow, cylinders=[disc]))
    for seat in (0, 1):
        right = motion.hands[seat] == "right"
        shirt, shorts = KITS[seat]
        parts = athlete(motion.skeletons[seat].name, right_handed=right, shirt=shirt, shorts=shorts)
        parts = {**parts, "Racket": racket(*motion.racket(seat))}
        out += [attached(bone_frame(seat, bone), models=[model(meshes)]) for bone, meshes in parts.items()]
        name = label("\n".join(name_lines(names[seat])), (0, 0, 0), 16, NAME_COLOURS[seat])
        out.append(attached(name_frame(seat), texts=[name]))
    return out
