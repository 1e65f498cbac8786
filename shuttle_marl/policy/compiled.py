"""Compiled loops behind :mod:`shuttle_marl.policy.network`.

They do what numpy would do, operation by operation, without its passes over memory: numbers keep the bits that IEEE 754
prescribes. The module is imported where a network is tabulated, because numba takes a while to import.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.kernel.compiling import cached

Floats = npt.NDArray[np.float64]

_LOG2E: Final = 1.4426950408889634
_LN2_HIGH: Final = 0.693147180369123816490
_LN2_LOW: Final = 1.90821492927058770002e-10
"""ln 2 as a number of 33 bits, of which small multiples are exact, and the rest."""
_TERMS: Final = 14
_SMALLEST: Final = -700.0
"""Logits so far below the highest one count as this: a probability of 10^-304."""
_BIAS: Final = 1023
_FRACTION_BITS: Final = 52
"""Of a float64: what its exponent is stored with, and the bits below it."""


def _rectify(x: Floats) -> float:
    """Set negative numbers of ``[N, W]`` to 0 in place; returns the largest number."""
    highest = 0.0
    for row in range(len(x)):
        values = x[row]
        for i in range(values.size):
            values[i] = max(values[i], 0.0)
            highest = max(highest, values[i])
    return highest


# No value is NaN and the sign of zero is of no account, so maxima are taken side by side.
rectify = cached(_rectify, nogil=True, fastmath={"nnan", "nsz"})


def _shift(x: Floats, bias: Floats) -> float:
    """Add ``[W]`` to each row of ``[N, W]`` in place; returns the largest absolute value."""
    highest = 0.0
    for row in range(len(x)):
        values = x[row]
        for i in range(values.size):
            values[i] += bias[i]
            highest = max(highest, abs(values[i]))
    return highest


shift = cached(_shift, nogil=True, fastmath={"nnan", "nsz"})


def _limits(logits: Floats, cumulative: npt.NDArray[np.uint16]) -> None:
    """``[N, K]`` logits to the cumulative probabilities of their softmax, in units of 1/65535."""
    length = logits.shape[1]
    rest, total = np.empty(length), np.empty(length)
    power = np.empty(length, np.int64)
    scale = power.view(np.float64)
    for row in range(len(logits)):
        top = logits[row].max()
        for i in range(length):
            x = max(logits[row, i] - top, _SMALLEST)
            whole = np.rint(x * _LOG2E)
            rest[i] = x - whole * _LN2_HIGH - whole * _LN2_LOW
            power[i] = (np.int64(whole) + _BIAS) << _FRACTION_BITS
            total[i] = 1.0
        for n in range(_TERMS, 0, -1):
            for i in range(length):
                total[i] = total[i] * rest[i] / n + 1.0
        so_far = 0.0
        for i in range(length):
            so_far += total[i] * scale[i]
            total[i] = so_far
        for i in range(length):
            cumulative[row, i] = np.uint16(np.rint(total[i] / so_far * CHOICE_ONE))


limits = cached(_limits, nogil=True, error_model="numpy")
