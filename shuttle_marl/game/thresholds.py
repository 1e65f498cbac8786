"""Thresholds in 16-bit fixed point: the probabilities of the game, the same on every machine."""

from typing import Final

import numpy as np

from shuttle_marl.base.arrays import U16, U64, UInts

ONE: Final = 1 << 16
"""Probability 1 in fixed point."""


def moved_share(part: UInts, whole: UInts | int, up: UInts | int, down: UInts | int, of: UInts | int) -> U64:
    """The share part / whole with its odds multiplied by up / down, of another whole, to the nearest unit (halves up).

    Whole numbers, so the same on every machine: at most 2^16 * 2^28 * 2^17, which 64 bits hold. The whole may not be 0.
    """
    part, whole, up, down, of = (np.asarray(number, dtype=np.uint64) for number in (part, whole, up, down, of))
    inside, two = part * up, np.uint64(2)
    total = inside + (whole - part) * down
    return np.asarray((two * inside * of + total) // (two * total), dtype=np.uint64)


def with_fault_odds(threshold: U16, odds: int) -> U16:
    """Thresholds ``[..., 3]`` in which the odds of a fault are multiplied; what happens to a good stroke stays as it was."""
    if odds == ONE:
        return threshold
    old, one = threshold.astype(np.uint64), np.uint64(ONE)
    fault = np.minimum(moved_share(old[..., :1], ONE, odds, ONE, ONE), one - np.uint64(1))
    rest = moved_share(old[..., 1:] - old[..., :1], one - old[..., :1], 1, 1, one - fault)
    return np.minimum(np.concatenate([fault, fault + rest], axis=-1), one - np.uint64(1)).astype(np.uint16)
