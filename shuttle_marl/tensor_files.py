"""Arrays in safetensors files: read whole from regular files alone, and verified where it is known what was written."""

import hashlib
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load

from shuttle_marl.files import open_file


class Tensors(NamedTuple):
    """Content of a safetensors file."""

    metadata: dict[str, str]
    """Texts by name."""
    arrays: dict[str, npt.NDArray[Any]]
    """Arrays by name."""


def read_tensors(path: Path, sha256: str | None = None) -> Tensors:
    """Read a safetensors file.

    Args:
        path: the file.
        sha256: hash of its bytes, hexadecimal; None: it is not known.

    Raises:
        OSError: the file cannot be opened, or is no regular file.
        ValueError: it is no safetensors file, its arrays have a type that numpy does not know, or it does not fit the hash.
    """
    with open_file(path) as file:
        content = file.read()
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise ValueError("it was changed after it was written: its checksum does not fit")
    try:
        arrays = load(content)
    except (SafetensorError, KeyError) as error:
        raise ValueError(f"no safetensors file: {error}") from error
    # `load` leaves the metadata out. It has checked the header, whose length stands in the first eight bytes.
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    return Tensors(header.get("__metadata__", {}), arrays)


def parsed(text: str) -> Any:
    """A value from JSON text, such as the metadata of a file holds it.

    Raises:
        ValueError: the text is no JSON, or is nested too deeply.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def checked(array: npt.NDArray[Any], dtype: npt.DTypeLike, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """The array, if it has a dtype and a shape and only finite numbers.

    Raises:
        ValueError: it has not.
    """
    if array.dtype != dtype or array.shape != shape:
        raise ValueError(f"{array.dtype} numbers of shape {array.shape}, expected {np.dtype(dtype)} and {shape}")
    if not np.isfinite(array).all():
        raise ValueError("a number that is not finite")
    return array
