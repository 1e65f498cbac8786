"""Checks of what enters compiled code, which reads and writes memory without looking. Needs no compiler."""

from typing import Any

import numpy as np
import numpy.typing as npt

from shuttle_marl.errors import OptionError, ShuttleError, whole_number


class KernelError(ShuttleError):
    """An argument that the kernel cannot take."""


def checked_number(name: str, value: Any, least: int) -> int:
    """A whole number that is not below ``least``.

    Raises:
        KernelError: it is something else.
    """
    try:
        return whole_number(name, value, least)
    except OptionError as error:
        raise KernelError(str(error)) from None


def checked_array(
    name: str, array: Any, type_: npt.DTypeLike, shape: tuple[int, ...], low: int | None = None, high: int | None = None
) -> npt.NDArray[Any]:
    """An array as compiled code takes it: of one type, its numbers one behind the other.

    Integers of any width may stand for integers; nothing else is converted, so no fraction is ever cut off.

    Args:
        name: for the message.
        array: what was given.
        type_: type that is needed.
        shape: shape that is needed.
        low, high: least and largest value that is allowed, where integers have limits.

    Raises:
        KernelError: another kind of numbers, another shape, or a number outside the limits.
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
    """Refuse an array that compiled code cannot write its results to as it stands.

    Raises:
        KernelError: another type or shape, numbers that do not lie one behind the other, or a read-only array.
    """
    wanted = np.dtype(type_)
    fits = isinstance(array, np.ndarray) and array.dtype == wanted and array.shape == shape
    if not fits or not (array.flags.c_contiguous and array.flags.writeable and array.flags.aligned):
        found = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise KernelError(f"room for {name}, {found}: expected {wanted} of shape {shape}, writeable, one row behind the other")
