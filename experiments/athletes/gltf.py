"""Writes a skinned athlete as binary glTF 2.0: quantised normals and weights, bones aligned with the world at rest."""

from typing import Final

import numpy as np
import pygltflib as gltf

from experiments.athletes.base_mesh import Body
from experiments.athletes.clothes import SOLE, Part
from shuttle_marl.base.arrays import F64
from shuttle_marl.scene.mesh import GlbWriter

MATERIALS: Final[dict[str, tuple[tuple[float, float, float], float]]] = {
    "skin": ((0.80, 0.56, 0.43), 0.55),
    "shirt": ((0.80, 0.05, 0.07), 0.85),
    "shorts": ((0.06, 0.07, 0.10), 0.85),
    "sock": ((0.92, 0.92, 0.92), 0.90),
    "shoe": ((0.93, 0.93, 0.95), 0.50),
    "sole": ((0.55, 0.20, 0.08), 0.70),
    "hair": ((0.02, 0.015, 0.012), 0.60),
    "eye": ((0.92, 0.92, 0.92), 0.20),
    "iris": ((0.05, 0.03, 0.02), 0.20),
}
"""Colour (linear RGB) and roughness of each material; renderers give shirt and shorts the colours of the kit."""
_TWO_SIDED: Final = ("shirt", "shorts")


def write_glb(body: Body, parts: list[Part], copyright_note: str) -> bytes:
    """The bytes of a ``.glb`` file: y up, facing +z, the soles on y = 0."""
    writer = GlbWriter()
    names = list(dict.fromkeys(part.material for part in parts))
    primitives = [_primitive(writer, part, names.index(part.material)) for part in parts]
    heads = body.heads + np.array([0, SOLE, 0])
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(heads), 1, 1))
    inverse[:, 3, :3] = -heads  # matrices of glTF are stored by columns
    bind = writer.add(inverse)
    document = gltf.GLTF2(
        asset=gltf.Asset(version="2.0", generator="shuttle_marl.staging", copyright=copyright_note),
        extensionsUsed=["KHR_mesh_quantization"],
        extensionsRequired=["KHR_mesh_quantization"],
        scene=0,
        scenes=[gltf.Scene(nodes=[len(heads) + 1])],
        nodes=_nodes(body, heads),
        meshes=[gltf.Mesh(name="athlete", primitives=primitives)],
        skins=[gltf.Skin(joints=list(range(len(heads))), inverseBindMatrices=bind, skeleton=0)],
        materials=[_material(name) for name in names],
    )
    return writer.content(document)


def _primitive(writer: GlbWriter, part: Part, material: int) -> gltf.Primitive:
    strongest = np.argsort(-part.weights, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(part.weights, strongest, axis=1)
    weights = np.rint(255 * weights / weights.sum(axis=1, keepdims=True)).astype(np.int64)
    weights[:, 0] += 255 - weights.sum(axis=1)
    strongest[weights == 0] = 0
    attributes = gltf.Attributes(
        POSITION=writer.add(part.vertices.astype("<f4"), gltf.ARRAY_BUFFER, bounds=True),
        NORMAL=writer.add(np.rint(127 * part.normals).astype(np.int8), gltf.ARRAY_BUFFER, normalized=True),
        JOINTS_0=writer.add(strongest.astype(np.uint8), gltf.ARRAY_BUFFER),
        WEIGHTS_0=writer.add(weights.astype(np.uint8), gltf.ARRAY_BUFFER, normalized=True),
    )
    indices = writer.add(part.triangles.astype("<u2").ravel(), gltf.ELEMENT_ARRAY_BUFFER)
    return gltf.Primitive(attributes=attributes, indices=indices, material=material)


def _material(name: str) -> gltf.Material:
    colour, roughness = MATERIALS[name]
    look = gltf.PbrMetallicRoughness(baseColorFactor=[*colour, 1], metallicFactor=0, roughnessFactor=roughness)
    return gltf.Material(name=name, pbrMetallicRoughness=look, doubleSided=name in _TWO_SIDED, alphaCutoff=None)


def _nodes(body: Body, heads: F64) -> list[gltf.Node]:
    nodes: list[gltf.Node] = []
    for i, name in enumerate(body.bones):
        parent = body.parents[i]
        offset = heads[i] - (heads[parent] if parent >= 0 else 0)
        nodes.append(gltf.Node(name=name, translation=offset.round(6).tolist()))
        if parent >= 0:
            nodes[parent].children.append(i)
    nodes.append(gltf.Node(name="body", mesh=0, skin=0))
    nodes.append(gltf.Node(name="athlete", children=[0, len(nodes) - 1]))
    return nodes
