"""The athletes in rigid parts, one a bone: viewers of scenes cannot bend a skin.

A triangle belongs to the bone that moves it most, and to every other one that moves it noticeably, so that parts overlap
around a joint and no gap opens when it bends.
"""

import functools
from typing import Final

import numpy as np
import numpy.typing as npt
import pygltflib as gltf

from shuttle_marl.scene.glb import read_array, read_file
from shuttle_marl.scene.mesh import Mesh, joined
from shuttle_marl.staging import finger_pose, load_skeleton, model_file
from shuttle_marl.staging.rotation import matrix, unit
from shuttle_marl.staging.skeleton import BONE

Floats = npt.NDArray[np.float64]
Colour = tuple[float, float, float]

_FROM_GLTF: Final = np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
"""From the axes of the athletes' files (y up, facing +z) to those of the staging (z up, facing +y)."""
_SHARED: Final = 0.12
"""Mean weight from which a bone has a triangle too that another one moves more."""


@functools.cache
def parts(name: str, *, right_handed: bool, shirt: Colour, shorts: Colour) -> dict[str, list[Mesh]]:
    """Meshes of each bone that moves skin or clothes, with the origin where the bone begins.

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
