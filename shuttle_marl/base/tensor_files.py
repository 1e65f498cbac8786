"""Arrays in safetensors files, read from regular files and verified against a known hash.

Large arrays may be stored **packed**: as one byte array that holds the first bytes of all numbers, then the second ones, and so
on, compressed with LZMA. The entry ``packed`` of the metadata is a JSON object with the dtype and the shape of each.
"""

import json
import lzma
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load, save

from shuttle_marl.base.files import parsed as parsed  # noqa: PLC0414  exported, as the readers of metadata need both
from shuttle_marl.base.files import read_file, read_hashed

_PACKED: Final = "packed"
_LARGE: Final = 1 << 16
_MOST: Final = 1 << 27  # maximum size of all unpacked arrays of a file together, and of the file [bytes]
_MOST_HEADER: Final = 1 << 20


class Tensors(NamedTuple):
    """Content of a safetensors file."""

    metadata: dict[str, str]  # text by name
    arrays: dict[str, npt.NDArray[Any]]  # arrays by name


def tensor_bytes(arrays: Mapping[str, npt.NDArray[Any]], metadata: Mapping[str, str], *, pack: bool = False) -> bytes:
    """A safetensors file; the same arguments give the same bytes.

    Args:
        metadata: text by name. The library writes it in random order, so it is sorted here.
        pack: whether large arrays are packed, which takes less space and more time.
    """
    stored, known = {name: np.ascontiguousarray(array) for name, array in arrays.items()}, dict(metadata)
    large = {name: array for name, array in stored.items() if pack and array.nbytes >= _LARGE}
    stored |= {name: packed_bytes(array) for name, array in large.items()}
    if large:
        known[_PACKED] = json.dumps({name: [array.dtype.str, array.shape] for name, array in large.items()}, sort_keys=True)
    content = save(stored, metadata=known)
    start = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:start])
    header["__metadata__"] = dict(sorted(known.items()))
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + content[start:]


def packed_bytes(array: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """An array as compressed bytes."""
    planes = np.frombuffer(array.tobytes(), np.uint8).reshape(-1, array.itemsize).T
    return np.frombuffer(lzma.compress(planes.tobytes()), np.uint8)


def unpacked_bytes(content: npt.NDArray[np.uint8], dtype: npt.DTypeLike, shape: Sequence[int]) -> npt.NDArray[Any]:
    """The array of compressed bytes. Raises ValueError: they are damaged, or of another size."""
    kind, size = np.dtype(dtype), _unpacked_size(dtype, shape)
    if size > _MOST:
        raise ValueError(f"a packed array of {size >> 20} MB, expected at most {_MOST >> 20}")
    unpacker = lzma.LZMADecompressor(memlimit=_MOST)
    try:
        # A byte more than the array has, so that what is too long is noticed and never unpacked.
        planes = unpacker.decompress(content.tobytes(), size + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(f"a packed array that cannot be unpacked: {error}") from error
    if len(planes) != size or not unpacker.eof:
        raise ValueError(f"a packed array of {len(planes)} bytes, expected {size}")
    numbers = np.frombuffer(planes, np.uint8).reshape(kind.itemsize, -1).T
    return np.array(numbers, order="C").view(kind).reshape(tuple(shape))


def _unpacked_size(dtype: npt.DTypeLike, shape: Sequence[int]) -> int:
    """Size of an array [bytes]."""
    kind = np.dtype(dtype)
    if kind.kind not in "biuf" or not all(isinstance(n, int) and n >= 0 for n in shape):
        raise ValueError(f"a packed array of {kind} numbers and shape {shape}")
    return kind.itemsize * math.prod(shape)


def read_tensors(path: Path, sha256: str | None = None) -> Tensors:
    """Read a safetensors file.

    Args:
        sha256: hexadecimal hash of its bytes; None: unknown.

    Raises:
        OSError: the file cannot be opened, is not a regular file, or is larger than 128 MB.
        ValueError: it is not a safetensors file, has arrays of a type unknown to numpy or of more than 128 MB together, or does
            not match the hash.
    """
    content = read_file(path, _MOST) if sha256 is None else read_hashed(path, sha256, _MOST)
    length = int.from_bytes(content[:8], "little")
    if length > _MOST_HEADER:
        raise ValueError(f"not a safetensors file: a header of {length} bytes, expected at most {_MOST_HEADER}")
    try:
        arrays = load(content)
    except (SafetensorError, KeyError) as error:
        raise ValueError(f"not a safetensors file: {error}") from error
    # `load` omits the metadata. It has validated the header, whose length is in the first eight bytes.
    metadata = parsed(content[8 : 8 + length].decode()).get("__metadata__", {})
    try:
        packed = parsed(metadata.pop(_PACKED, "{}")).items()
        # Before the first is unpacked: a small file may hold any number of arrays that each may be unpacked.
        if (size := sum(_unpacked_size(*described) for _, described in packed)) > _MOST:
            raise ValueError(f"packed arrays of {size >> 20} MB together, expected at most {_MOST >> 20}")
        for name, (dtype, shape) in packed:
            arrays[name] = unpacked_bytes(arrays[name], dtype, shape)
    except (AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"no description of its packed arrays: {error}") from error
    return Tensors(metadata, arrays)


def checked(array: npt.NDArray[Any], dtype: npt.DTypeLike, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """The array. Raises ValueError: another dtype or shape, or a number that is not finite."""
    if array.dtype != dtype or array.shape != shape:
        raise ValueError(f"{array.dtype} numbers of shape {array.shape}, expected {np.dtype(dtype)} and {shape}")
    if not np.isfinite(array).all():
        raise ValueError("a number that is not finite")
    return array
