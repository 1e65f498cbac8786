"""Writes a skinned athlete as binary glTF 2.0: quantised normals and weights, bones aligned with the world at rest."""

import json
import struct
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.staging.athletes.clothes import SOLE, Part
from shuttle_marl.staging.athletes.source import Body

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
_FLOAT, _BYTE, _UBYTE, _USHORT = 5126, 5120, 5121, 5123
_ARRAY, _ELEMENTS = 34962, 34963


class _Buffer:
    """The binary chunk and what describes it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, array: npt.NDArray[Any], component: int, kind: str, *, target: int | None = None, **extra: Any) -> int:
        """Append an array; returns its accessor. Rows are padded to four bytes, as vertex attributes must be."""
        rows = array if array.ndim > 1 else array[:, None]
        width = rows.shape[1] * rows.itemsize
        padded = -(-width // 4) * 4 if target == _ARRAY else width
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data)}
        if padded != width:
            raw = np.zeros((len(rows), padded), dtype=np.uint8)
            raw[:, :width] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), width)
            content = raw.tobytes()
            view["byteStride"] = padded
        else:
            content = np.ascontiguousarray(rows).tobytes()
        view["byteLength"] = len(content)
        if target is not None:
            view["target"] = target
        self.data += content + bytes(-len(content) % 4)
        self.views.append(view)
        self.accessors.append(
            {"bufferView": len(self.views) - 1, "componentType": component, "count": len(rows), "type": kind, **extra}
        )
        return len(self.accessors) - 1


def write_glb(body: Body, parts: list[Part], copyright_note: str) -> bytes:
    """The bytes of a ``.glb`` file: y up, facing +z, the soles on y = 0."""
    buffer = _Buffer()
    names = list(dict.fromkeys(part.material for part in parts))
    primitives = [_primitive(buffer, part, names.index(part.material)) for part in parts]
    heads = body.heads + np.array([0, SOLE, 0])
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(heads), 1, 1))
    inverse[:, 3, :3] = -heads  # matrices of glTF are stored by columns
    bind = buffer.add(inverse.reshape(len(heads), 16), _FLOAT, "MAT4")
    document = {
        "asset": {"version": "2.0", "generator": "shuttle_marl.staging", "copyright": copyright_note},
        "extensionsUsed": ["KHR_mesh_quantization"],
        "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0,
        "scenes": [{"nodes": [len(heads) + 1]}],
        "nodes": _nodes(body, heads),
        "meshes": [{"name": "athlete", "primitives": primitives}],
        "skins": [{"joints": list(range(len(heads))), "inverseBindMatrices": bind, "skeleton": 0}],
        "materials": [_material(name) for name in names],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(buffer.data), 0x004E4942) + bytes(buffer.data)
    )
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def _primitive(buffer: _Buffer, part: Part, material: int) -> dict[str, Any]:
    strongest = np.argsort(-part.weights, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(part.weights, strongest, axis=1)
    weights = np.rint(255 * weights / weights.sum(axis=1, keepdims=True)).astype(np.int64)
    weights[:, 0] += 255 - weights.sum(axis=1)
    strongest[weights == 0] = 0
    vertices = part.vertices.astype(np.float32)
    attributes = {
        "POSITION": buffer.add(
            vertices, _FLOAT, "VEC3", target=_ARRAY, min=vertices.min(axis=0).tolist(), max=vertices.max(axis=0).tolist()
        ),
        "NORMAL": buffer.add(np.rint(127 * part.normals).astype(np.int8), _BYTE, "VEC3", target=_ARRAY, normalized=True),
        "JOINTS_0": buffer.add(strongest.astype(np.uint8), _UBYTE, "VEC4", target=_ARRAY),
        "WEIGHTS_0": buffer.add(weights.astype(np.uint8), _UBYTE, "VEC4", target=_ARRAY, normalized=True),
    }
    indices = buffer.add(part.triangles.astype(np.uint16).ravel(), _USHORT, "SCALAR", target=_ELEMENTS)
    return {"attributes": attributes, "indices": indices, "material": material}


def _material(name: str) -> dict[str, Any]:
    colour, roughness = MATERIALS[name]
    look = {"baseColorFactor": [*colour, 1], "metallicFactor": 0, "roughnessFactor": roughness}
    return {"name": name, "pbrMetallicRoughness": look, "doubleSided": name in _TWO_SIDED}


def _nodes(body: Body, heads: npt.NDArray[np.float64]) -> list[dict[str, Any]]:
    nodes: list[dict[str, Any]] = []
    for i, name in enumerate(body.bones):
        parent = body.parents[i]
        offset = heads[i] - (heads[parent] if parent >= 0 else 0)
        nodes.append({"name": name, "translation": offset.round(6).tolist()})
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(i)
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    nodes.append({"name": "athlete", "children": [0, len(nodes) - 1]})
    return nodes
