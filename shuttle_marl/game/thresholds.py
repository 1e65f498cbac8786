"""Thresholds in 16-bit fixed point: the probabilities of the game, the same on every machine."""

import decimal
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import I64, U16, U64, UInts

ONE: Final = 1 << 16
"""Probability 1 in fixed point."""
Odds = tuple[U64, U64]
"""What odds are multiplied and divided by, in units of 1/65536."""


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


def odds_of_steps(steps: I64, *, step: float) -> Odds:
    """Multipliers and divisors of odds, exact by definition.

    Args:
        steps: whole numbers of any shape, at most 8 in log-odds.
        step: difference of log-odds of one step; a power of two.
    """
    sizes, place = np.unique(np.abs(steps), return_inverse=True)
    with decimal.localcontext(decimal.Context(prec=40)):
        odds = [(decimal.Decimal(step) * k).exp() * ONE for k in sizes.tolist()]
        whole = np.array([int(x.to_integral_value(decimal.ROUND_HALF_EVEN)) for x in odds], dtype=np.uint64)
    rising, none = whole[place.reshape(steps.shape)], np.uint64(ONE)
    return np.where(steps > 0, rising, none), np.where(steps < 0, rising, none)
