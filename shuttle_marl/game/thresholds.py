"""Thresholds in 16-bit fixed point: the probabilities of the game, the same on every machine."""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import I64, U16, Ints

ONE: Final = 1 << 16
"""Probability 1 in fixed point."""


def multiplied(probability: Ints, odds: Ints | int) -> I64:
    """Probabilities whose odds are multiplied, all in units of 1/65536: whole numbers, so the same on every machine.

    Args:
        probability: 0 to 65536, any shape.
        odds: 1 to 2^20; broadcasts.
    """
    p = np.asarray(probability, dtype=np.int64)
    for_it = p * odds
    total = for_it + (ONE - p) * ONE
    return np.asarray((2 * for_it * ONE + total) // (2 * total))


def with_fault_odds(threshold: U16, odds: Ints | int) -> U16:
    """Thresholds ``[..., 3]`` in which the odds of a fault are multiplied; what happens to a good stroke stays as it was."""
    if np.ndim(odds) == 0 and odds == ONE:
        return threshold
    old = threshold.astype(np.int64)
    fault = np.minimum(multiplied(old[..., 0], odds), ONE - 1)
    good, before = ONE - fault, ONE - old[..., 0]
    rest = (2 * (old[..., 1:] - old[..., :1]) * good[..., None] + before[..., None]) // (2 * before[..., None])
    moved = np.concatenate([fault[..., None], fault[..., None] + rest], axis=-1)
    return np.minimum(moved, ONE - 1).astype(np.uint16)
