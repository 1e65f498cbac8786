"""Arrays in and out of binary glTF 2.0, on top of :mod:`pygltflib`, which knows the container and the document."""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt
import pygltflib as gltf

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


class GlbWriter:
    """Collects the arrays of a file, then writes it."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._views: list[gltf.BufferView] = []
        self._accessors: list[gltf.Accessor] = []

    def add(self, array: Array, target: int | None = None, *, bounds: bool = False, normalized: bool = False) -> int:
        """Append an array; returns the number of its accessor.

        Args:
            array: ``[N]`` or ``[N, k]``, k of 3, 4 or 16; 32-bit floats, 8-bit integers, or unsigned integers up to 32 bits.
            target: ``pygltflib.ARRAY_BUFFER`` for attributes of vertices, whose rows are padded to four bytes,
                ``ELEMENT_ARRAY_BUFFER`` for indices.
            bounds: write least and greatest values, as positions must have them.
            normalized: whether integers stand for numbers of at most 1.
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
        """The bytes of the file: a document that names accessors by number, and the arrays."""
        document.accessors, document.bufferViews = self._accessors, self._views
        document.buffers = [gltf.Buffer(byteLength=len(self._data))]
        document.set_binary_blob(bytes(self._data))
        return b"".join(cast(Sequence[bytes], document.save_to_bytes()))


@functools.cache
def read_file(path: Path) -> gltf.GLTF2:
    """The document of a file, with its arrays; to be looked at, not changed."""
    return gltf.GLTF2().load_binary(str(path))


def read_array(document: gltf.GLTF2, number: int) -> Array:
    """``[N]`` or ``[N, k]`` what an accessor stands for; normalized integers as 64-bit floats of at most 1."""
    accessor = document.accessors[number]
    view = document.bufferViews[accessor.bufferView]
    dtype, width = _DTYPES[accessor.componentType], _WIDTHS[accessor.type]
    stride = view.byteStride or width * dtype.itemsize
    raw = np.frombuffer(document.binary_blob(), np.uint8, accessor.count * stride, view.byteOffset).reshape(-1, stride)
    values = np.ascontiguousarray(raw[:, : width * dtype.itemsize]).view(dtype)
    if accessor.normalized:
        values = values / np.iinfo(dtype).max
    return values[:, 0] if width == 1 else values
