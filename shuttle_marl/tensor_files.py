"""Arrays in safetensors files, read from regular files and verified against a known hash."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load, save

from shuttle_marl.files import read_file


class Tensors(NamedTuple):
    """Content of a safetensors file."""

    metadata: dict[str, str]
    """Text by name."""
    arrays: dict[str, npt.NDArray[Any]]
    """Arrays by name."""


def tensor_bytes(arrays: Mapping[str, npt.NDArray[Any]], metadata: Mapping[str, str]) -> bytes:
    """A safetensors file; the same arguments give the same bytes.

    The library writes metadata in random order, so it is sorted here.
    """
    content = save({name: np.ascontiguousarray(array) for name, array in arrays.items()}, metadata=dict(metadata))
    start = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:start])
    header["__metadata__"] = dict(sorted(metadata.items()))
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + content[start:]


def read_tensors(path: Path, sha256: str | None = None) -> Tensors:
    """Read a safetensors file.

    Args:
        path: the file.
        sha256: hexadecimal hash of its bytes; None: unknown.

    Raises:
        OSError: the file cannot be opened, or is not a regular file.
        ValueError: it is not a safetensors file, has arrays of a type unknown to numpy, or does not match the hash.
    """
    content = read_file(path)
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise ValueError("it was changed after it was written: its checksum does not match")
    try:
        arrays = load(content)
    except (SafetensorError, KeyError) as error:
        raise ValueError(f"not a safetensors file: {error}") from error
    # `load` omits the metadata. It has validated the header, whose length is in the first eight bytes.
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    return Tensors(header.get("__metadata__", {}), arrays)


def parsed(text: str) -> Any:
    """Parse JSON text, such as metadata of a file.

    Raises:
        ValueError: the text is not JSON, or is nested too deeply.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def checked(array: npt.NDArray[Any], dtype: npt.DTypeLike, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Check the dtype and shape of an array, and that its numbers are finite; returns the array.

    Raises:
        ValueError: a check failed.
    """
    if array.dtype != dtype or array.shape != shape:
        raise ValueError(f"{array.dtype} numbers of shape {array.shape}, expected {np.dtype(dtype)} and {shape}")
    if not np.isfinite(array).all():
        raise ValueError("a number that is not finite")
    return array
