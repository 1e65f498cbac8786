"""Arrays that no one can write to, because players share them."""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

A = TypeVar("A", bound=np.generic)


def frozen(array: npt.NDArray[A]) -> npt.NDArray[A]:
    """The numbers of an array in memory that can never be made writable; a frozen array is not copied again."""
    if isinstance(array.base, bytes) and array.flags.c_contiguous and not array.flags.writeable:
        return array
    return np.ndarray(array.shape, array.dtype, array.tobytes())
