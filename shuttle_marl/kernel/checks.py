"""Checks of the arrays that compiled code reads and writes, without a compiler.

Compiled code accesses memory unchecked, so every array from outside is checked first.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.errors import OptionError, ShuttleError, whole_number


class KernelError(ShuttleError):
    """An argument that the kernel cannot take."""


def checked_number(name: str, value: Any, least: int) -> int:
    """Return a whole number that is at least ``least``.

    Raises:
        KernelError: the value is something else.
    """
    try:
        return whole_number(name, value, least)
    except OptionError as error:
        raise KernelError(str(error)) from None


def checked_array(
    name: str, array: Any, type_: npt.DTypeLike, shape: tuple[int, ...], low: int | None = None, high: int | None = None
) -> npt.NDArray[Any]:
    """Return an array as a C-contiguous array of one dtype.

    Integers of any width are converted to integers; nothing else is converted, so no fraction is truncated.

    Args:
        low, high: least and greatest value of integers; None: those of the dtype.

    Raises:
        KernelError: wrong kind of numbers, wrong shape, or a number out of range.
    """
    wanted = np.dtype(type_)
    found = np.asarray(array)
    alike = found.dtype == wanted or (wanted.kind in "iu" and found.dtype.kind in "iu")
    if not alike or found.shape != shape:
        raise KernelError(f"{name}: {found.dtype} of shape {found.shape}; expected {wanted} of shape {shape}")
    if wanted.kind in "iu" and found.size and (found.dtype != wanted or (low, high) != (None, None)):
        least = np.iinfo(wanted).min if low is None else low
        largest = np.iinfo(wanted).max if high is None else high
        smallest, greatest = int(found.min()), int(found.max())
        if smallest < least or greatest > largest:
            raise KernelError(f"{name}: {smallest} to {greatest}; expected {least} to {largest}")
    return np.ascontiguousarray(found, dtype=wanted)


def check_room(name: str, array: Any, type_: npt.DTypeLike, shape: tuple[int, ...]) -> None:
    """Check that compiled code can write its results to an array.

    Raises:
        KernelError: wrong dtype or shape, or an array that is not C-contiguous, aligned and writeable.
    """
    wanted = np.dtype(type_)
    fits = isinstance(array, np.ndarray) and array.dtype == wanted and array.shape == shape
    if not fits or not (array.flags.c_contiguous and array.flags.writeable and array.flags.aligned):
        found = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise KernelError(f"output array for {name}, {found}: expected {wanted} of shape {shape}, writeable and C-contiguous")
