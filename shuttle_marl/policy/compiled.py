"""Compiled loops behind :mod:`shuttle_marl.policy.network`.

They do what numpy would do, operation by operation, without its passes over memory: numbers keep the bits that IEEE 754
prescribes. The module is imported where a network is tabulated, because numba takes a while to import.
"""

from collections.abc import Callable
from typing import Any, Final, TypeVar

import numpy as np

from shuttle_marl.arrays import F64, I64, U16
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.kernel.compiling import cached

F = TypeVar("F", bound=Callable[..., Any])

_LOG2E: Final = 1.4426950408889634
_LN2_HIGH: Final = 0.693147180369123816490
_LN2_LOW: Final = 1.90821492927058770002e-10
"""ln 2 as a number of 33 bits, of which small multiples are exact, and the rest."""
_TERMS: Final = 14
_INVERSE: Final = tuple(1.0 / n for n in range(1, _TERMS + 1))
_SMALLEST: Final = -700.0
"""Logits so far below the highest one count as this: a probability of 10^-304."""
_BIAS: Final = 1023
_FRACTION_BITS: Final = 52
"""Of a float64: what its exponent is stored with, and the bits below it."""


def _compiled(function: F) -> F:
    """Compile where no number is NaN and the sign of zero is of no account, so that maxima are taken side by side."""
    return cached(function, nogil=True, error_model="numpy", fastmath={"nnan", "nsz"})


@_compiled
def spread(base: F64, efforts: F64, out: F64) -> float:
    """``[B, W]`` added to each row of ``[G, W]``, negative numbers set to 0: ``[B G, W]``; returns the largest number."""
    highest = 0.0
    for block in range(len(efforts)):
        effort = efforts[block]
        for row in range(len(base)):
            first, values = base[row], out[block * len(base) + row]
            for i in range(values.size):
                values[i] = max(first[i] + effort[i], 0.0)
                highest = max(highest, values[i])
    return highest


@_compiled
def rectify(x: F64, unit: float, bias: F64) -> tuple[float, float]:
    """Multiply ``[N, W]`` by a unit, add ``[W]`` and set negative numbers to 0, in place.

    Returns:
        the largest absolute value before and the largest number after negative ones were set to 0.
    """
    farthest = highest = 0.0
    for row in range(len(x)):
        values = x[row]
        for i in range(values.size):
            value = values[i] * unit + bias[i]
            farthest = max(farthest, abs(value))
            values[i] = max(value, 0.0)
            highest = max(highest, value)
    return farthest, highest


@_compiled
def shift(x: F64, unit: float, bias: F64) -> float:
    """Multiply ``[N, W]`` by a unit and add ``[W]`` in place; returns the largest absolute value."""
    farthest = 0.0
    for row in range(len(x)):
        values = x[row]
        for i in range(values.size):
            values[i] = values[i] * unit + bias[i]
            farthest = max(farthest, abs(values[i]))
    return farthest


@_compiled
def round_to(x: F64, per_unit: float) -> None:
    """Make numbers whole ones of a unit, in place."""
    for row in range(len(x)):
        values = x[row]
        for i in range(values.size):
            values[i] = np.rint(values[i] * per_unit)


@_compiled
def limits(logits: F64, start: I64, cumulative: U16) -> None:
    """``[N, K]`` logits to the cumulative probabilities of their softmax, in units of 1/65535, each row from its start on."""
    length = logits.shape[1]
    total = np.empty(length)
    power = np.empty(length, np.int64)
    scale = power.view(np.float64)
    for row in range(len(logits)):
        top = logits[row, 0]
        for i in range(1, length):
            top = max(top, logits[row, i])
        for i in range(length):
            x = max(logits[row, i] - top, _SMALLEST)
            whole = np.rint(x * _LOG2E)
            rest = x - whole * _LN2_HIGH - whole * _LN2_LOW
            power[i] = (np.int64(whole) + _BIAS) << _FRACTION_BITS
            # The series of the exponential, from its last term on.
            y = 1.0
            for n in range(_TERMS - 1, -1, -1):
                y = y * rest * _INVERSE[n] + 1.0
            total[i] = y
        so_far = 0.0
        for i in range(length):
            so_far += total[i] * scale[i]
            total[i] = so_far
        found = cumulative[start[row] : start[row] + length]
        for i in range(length):
            found[i] = np.uint16(np.rint(total[i] / so_far * CHOICE_ONE))
