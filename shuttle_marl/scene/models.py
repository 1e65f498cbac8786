"""Models of a scene: athletes, racket and shuttle, as meshes.

Athletes come in rigid parts, one a bone, because viewers of scenes cannot bend a skin. A triangle belongs to the bone that
moves it most, and to every other one that moves it noticeably, so that parts overlap around a joint and no gap opens when it
bends.
"""

import dataclasses
import functools
from typing import Final

import numpy as np
import numpy.typing as npt
import pygltflib as gltf

from shuttle_marl.scene.mesh import Mesh, joined, lathe, moved, normals_of, read_array, read_file, tube
from shuttle_marl.staging import RACKET_LENGTH, SWEET_SPOT, finger_pose, load_skeleton, model_file
from shuttle_marl.staging.rotation import frame, matrix, unit
from shuttle_marl.staging.skeleton import BONE

Floats = npt.NDArray[np.float64]
Colour = tuple[float, float, float]

_FROM_GLTF: Final = np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
"""From the axes of the athletes' files (y up, facing +z) to those of the staging (z up, facing +y)."""
_SHARED: Final = 0.12
"""Mean weight from which a bone has a triangle too that another one moves more."""


SHUTTLE_SCALE: Final = 1.9
"""Scale at which a shuttle is drawn: at its true size it cannot be seen across the court."""

_BUTT: Final = -0.10
_HEAD: Final = (RACKET_LENGTH + _BUTT - SWEET_SPOT, 0.105)
"""Half the length and half the width of the strung head [m]."""
_GRIP: Final = (0.03, 0.03, 0.035)
_FRAME: Final = (0.55, 0.02, 0.02)
_STRING: Final = (0.85, 0.85, 0.80)
_CORK: Final = (0.90, 0.88, 0.80)
_BAND: Final = (0.02, 0.25, 0.08)
_FEATHER: Final = (0.95, 0.95, 0.95)


@functools.cache
def athlete(name: str, *, right_handed: bool, shirt: Colour, shorts: Colour) -> dict[str, list[Mesh]]:
    """Meshes of an athlete, for each bone that moves skin or clothes, with the origin where the bone begins.

    Args:
        name: of the athlete.
        right_handed: which hand holds the racket.
        shirt: colour, linear.
        shorts: colour, linear.

    Raises:
        StagingError: there is no such athlete.
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


def _fingers(document: gltf.GLTF2, name: str, right_handed: bool, rest: Floats) -> tuple[npt.NDArray[np.int64], Floats, Floats]:
    """Of each joint of the file: the bone of the staging that carries it, and the rotation and shift of bent fingers."""
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


def racket(shaft: Floats, normal: Floats) -> list[Mesh]:
    """A racket, its origin in the middle of the grip.

    Args:
        shaft: ``[3]`` unit direction of the shaft.
        normal: ``[3]`` unit normal of the strings.
    """
    meshes = [
        lathe([(0.0, _BUTT), (0.016, _BUTT), (0.013, -0.02), (0.012, 0.09), (0.006, 0.11), (0.0, 0.11)], _GRIP, 10),
        lathe([(0.0, 0.10), (0.0042, 0.10), (0.0042, SWEET_SPOT - _HEAD[0]), (0.0, SWEET_SPOT - _HEAD[0])], _GRIP, 8),
    ]
    angle = np.linspace(0, 2 * np.pi, 41)
    ring = np.stack([_HEAD[1] * np.sin(angle), np.zeros(41), SWEET_SPOT - _HEAD[0] * np.cos(angle)], axis=-1)
    meshes.append(tube(ring, 0.006, _FRAME))
    for along, (reach, width) in enumerate((_HEAD, _HEAD[::-1])):
        for at in np.linspace(-0.86, 0.86, 11) * width:
            half = reach * np.sqrt(1 - (at / width) ** 2)
            ends = np.array([[at, 0.0, -half], [at, 0.0, half]]) if along == 0 else np.array([[-half, 0.0, at], [half, 0.0, at]])
            meshes.append(tube(ends + np.array([0, 0, SWEET_SPOT]), 0.0009, _STRING, 4))
    # Here the shaft is z and the normal y.
    axes = frame(shaft, normal)
    turn = np.stack([np.cross(axes[:, 1], axes[:, 0]), axes[:, 1], axes[:, 0]], axis=1)
    return [moved(mesh, turn, np.zeros(3)) for mesh in joined(meshes)]


def shuttle() -> list[Mesh]:
    """A feather shuttle (BWF Law 2: cork of 25 to 28 mm, feathers of 62 to 70 mm, 58 to 68 mm wide) flying along +z.

    The origin lies in the cork; it is :data:`SHUTTLE_SCALE` times as large as a real one.
    """
    bow = [(0.0131 * np.sin(a), 0.012 - 0.0131 * (1 - np.cos(a))) for a in np.linspace(np.pi / 2, 0, 6)]
    meshes = [lathe([(0.0131, -0.013), *bow], _CORK, 14), lathe([(0.0134, -0.014), (0.0134, -0.010)], _BAND, 14)]
    for angle in np.arange(16) * 2 * np.pi / 16:
        vane = np.array([[0.012, -0.0015, -0.013], [0.012, 0.0015, -0.013], [0.032, 0.0075, -0.076], [0.032, -0.0075, -0.076]])
        c, s = np.cos(angle), np.sin(angle)
        vertices = vane @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        triangles = np.array([[0, 2, 1], [0, 3, 2]])
        normals = normals_of(vertices, triangles)
        meshes.append(Mesh(vertices=vertices, normals=normals, triangles=triangles, colour=_FEATHER, two_sided=True))
    return [dataclasses.replace(mesh, vertices=SHUTTLE_SCALE * mesh.vertices) for mesh in joined(meshes)]
