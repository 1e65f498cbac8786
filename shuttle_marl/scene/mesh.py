"""Triangle meshes, and binary glTF 2.0 files of them.

Meshes have the axes of the staging, z up. glTF has y up, and viewers rotate models by a quarter turn about x. :mod:`pygltflib`
reads and writes the document; this module converts arrays.
"""

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt
import pygltflib as gltf

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.staging.rotation import cross, frame, unit

Array = npt.NDArray[Any]

_COMPONENTS: Final[dict[np.dtype[Any], int]] = {
    np.dtype("<f4"): gltf.FLOAT,
    np.dtype("i1"): gltf.BYTE,
    np.dtype("u1"): gltf.UNSIGNED_BYTE,
    np.dtype("<u2"): gltf.UNSIGNED_SHORT,
    np.dtype("<u4"): gltf.UNSIGNED_INT,
}
_DTYPES: Final = {component: dtype for dtype, component in _COMPONENTS.items()}
_KINDS: Final = {1: gltf.SCALAR, 3: gltf.VEC3, 4: gltf.VEC4, 16: gltf.MAT4}
_WIDTHS: Final = {kind: width for width, kind in _KINDS.items()}

_ROUGHNESS: Final = 0.8


class GlbWriter:
    """Collects the arrays of a glTF file and writes it."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._views: list[gltf.BufferView] = []
        self._accessors: list[gltf.Accessor] = []

    def add(self, array: Array, target: int | None = None, *, bounds: bool = False, normalized: bool = False) -> int:
        """Append an array and return the index of its accessor.

        Args:
            array: ``[N]`` or ``[N, k]`` with k = 3, 4 or 16; float32, int8, or unsigned integers up to 32 bits.
            target: ``pygltflib.ARRAY_BUFFER`` for vertex attributes, whose rows are padded to four bytes,
                ``ELEMENT_ARRAY_BUFFER`` for indices.
            bounds: write minimum and maximum, which positions require.
            normalized: whether integers represent numbers of at most 1.
        """
        rows = array.reshape(len(array), -1)
        width = rows.shape[1] * rows.itemsize
        padding = -width % 4 if target == gltf.ARRAY_BUFFER else 0
        content = np.pad(np.ascontiguousarray(rows).view(np.uint8), ((0, 0), (0, padding))).tobytes()
        view = gltf.BufferView(buffer=0, byteOffset=len(self._data), byteLength=len(content), target=target)
        view.byteStride = width + padding if padding else None
        accessor = gltf.Accessor(
            bufferView=len(self._views),
            componentType=_COMPONENTS[rows.dtype],
            count=len(rows),
            type=_KINDS[rows.shape[1]],
            normalized=normalized or None,
            min=rows.min(axis=0).tolist() if bounds else None,
            max=rows.max(axis=0).tolist() if bounds else None,
        )
        self._data += content + bytes(-len(content) % 4)
        self._views.append(view)
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def content(self, document: gltf.GLTF2) -> bytes:
        """Bytes of the file: a document that refers to accessors by index, and the arrays."""
        document.accessors, document.bufferViews = self._accessors, self._views
        document.buffers = [gltf.Buffer(byteLength=len(self._data))]
        document.set_binary_blob(bytes(self._data))
        return b"".join(cast(Sequence[bytes], document.save_to_bytes()))


@functools.cache
def read_file(path: Path) -> gltf.GLTF2:
    """Document of a file with its arrays; shared, so do not modify it."""
    return gltf.GLTF2().load_binary(str(path))


def read_array(document: gltf.GLTF2, number: int) -> Array:
    """``[N]`` or ``[N, k]`` values of an accessor; normalized integers become float64."""
    accessor = document.accessors[number]
    view = document.bufferViews[accessor.bufferView]
    dtype, width = _DTYPES[accessor.componentType], _WIDTHS[accessor.type]
    stride = view.byteStride or width * dtype.itemsize
    raw = np.frombuffer(document.binary_blob(), np.uint8, accessor.count * stride, view.byteOffset).reshape(-1, stride)
    values = np.ascontiguousarray(raw[:, : width * dtype.itemsize]).view(dtype)
    if accessor.normalized:
        values = values / np.iinfo(dtype).max
    return values[:, 0] if width == 1 else values


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Mesh:
    """Triangles of one colour.

    Attributes:
        vertices: ``[V, 3]`` [m].
        normals: ``[V, 3]`` unit.
        triangles: ``[T, 3]`` vertex indices, counterclockwise seen from outside.
        colour: linear red, green, blue, 0 to 1.
    """

    vertices: F64
    normals: F64
    triangles: I64
    colour: tuple[float, float, float]
    two_sided: bool = False


def lathe(profile: Sequence[tuple[float, float]], colour: tuple[float, float, float], sides: int = 16) -> Mesh:
    """A body of revolution about z.

    Args:
        profile: radius and height from bottom to top [m].
        sides: number of sides of the polygon that approximates the circle.
    """
    radius, height = np.array(profile, dtype=np.float64).T
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    vertices = np.concatenate(
        [radius[:, None, None] * ring, np.broadcast_to(height[:, None, None], (len(radius), sides, 1))], axis=-1
    )
    slope = np.stack([np.gradient(height), -np.gradient(radius)], axis=-1)
    normals = np.concatenate([slope[:, None, :1] * ring, np.broadcast_to(slope[:, None, 1:], (len(radius), sides, 1))], axis=-1)
    return Mesh(
        vertices=vertices.reshape(-1, 3),
        normals=unit(normals.reshape(-1, 3)),
        triangles=_rings(len(radius), sides),
        colour=colour,
    )


def tube(path: F64, radius: float, colour: tuple[float, float, float], sides: int = 6) -> Mesh:
    """A tube of constant radius [m] along a smooth path ``[P, 3]`` [m]."""
    along = unit(np.gradient(path, axis=0))
    aside = np.array([0.0, 0.0, 1.0]) if abs(along[0, 2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    basis = frame(along, np.broadcast_to(aside, along.shape))
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    normals = np.cos(angle)[:, None] * basis[:, None, :, 1] + np.sin(angle)[:, None] * basis[:, None, :, 2]
    return Mesh(
        vertices=(path[:, None] + radius * normals).reshape(-1, 3),
        normals=normals.reshape(-1, 3),
        triangles=_rings(len(path), sides),
        colour=colour,
    )


def _rings(count: int, sides: int) -> I64:
    row, side = np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij")
    a, b = row * sides + side, row * sides + (side + 1) % sides
    return np.stack([a, b, b + sides, a, b + sides, a + sides], axis=-1).reshape(-1, 3)


def joined(meshes: Iterable[Mesh]) -> list[Mesh]:
    """The same triangles as one mesh per colour."""
    groups: dict[tuple[tuple[float, float, float], bool], list[Mesh]] = {}
    for mesh in meshes:
        groups.setdefault((mesh.colour, mesh.two_sided), []).append(mesh)
    out = []
    for (colour, two_sided), group in groups.items():
        first = np.cumsum([0, *(len(mesh.vertices) for mesh in group)])
        out.append(
            Mesh(
                vertices=np.concatenate([mesh.vertices for mesh in group]),
                normals=np.concatenate([mesh.normals for mesh in group]),
                triangles=np.concatenate([mesh.triangles + at for mesh, at in zip(group, first, strict=False)]),
                colour=colour,
                two_sided=two_sided,
            )
        )
    return out


def moved(mesh: Mesh, turn: F64, offset: F64) -> Mesh:
    """A mesh rotated by a matrix ``[3, 3]``, then translated by ``[3]`` [m]."""
    return dataclasses.replace(mesh, vertices=mesh.vertices @ turn.T + offset, normals=mesh.normals @ turn.T)


def normals_of(vertices: F64, triangles: I64) -> F64:
    """``[V, 3]`` area-weighted mean normal of the triangles around each vertex."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = cross(b - a, c - a)
    out = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, triangles[:, k], area)
    return unit(out)


def glb(meshes: Sequence[Mesh]) -> bytes:
    """The meshes as one binary glTF 2.0 file."""
    writer = GlbWriter()
    primitives: list[gltf.Primitive] = []
    materials: list[gltf.Material] = []
    for mesh in meshes:
        vertices, normals = (_y_up(v).astype("<f4") for v in (mesh.vertices, mesh.normals))
        attributes = gltf.Attributes(
            POSITION=writer.add(vertices, gltf.ARRAY_BUFFER, bounds=True), NORMAL=writer.add(normals, gltf.ARRAY_BUFFER)
        )
        indices = writer.add(mesh.triangles.astype("<u4").ravel(), gltf.ELEMENT_ARRAY_BUFFER)
        primitives.append(gltf.Primitive(attributes=attributes, indices=indices, material=len(materials)))
        look = gltf.PbrMetallicRoughness(baseColorFactor=[*mesh.colour, 1], metallicFactor=0, roughnessFactor=_ROUGHNESS)
        materials.append(gltf.Material(pbrMetallicRoughness=look, doubleSided=mesh.two_sided, alphaCutoff=None))
    document = gltf.GLTF2(
        asset=gltf.Asset(version="2.0", generator="shuttle_marl.scene"),
        scene=0,
        scenes=[gltf.Scene(nodes=[0])],
        nodes=[gltf.Node(mesh=0)],
        meshes=[gltf.Mesh(primitives=primitives)],
        materials=materials,
    )
    return writer.content(document)


def _y_up(v: F64) -> F64:
    return np.stack([v[:, 0], v[:, 2], -v[:, 1]], axis=1)
