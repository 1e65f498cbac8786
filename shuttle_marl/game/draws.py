"""Random numbers by counter, and the probabilities in fixed point that they are compared with.

A draw depends on (seed, match, rally, stroke) alone, so batch size, order and number of threads never change a rally, and any
rally can be replayed from its numbers. The mixing function is the finaliser of SplitMix64 (Steele, Lea & Flood, OOPSLA 2014;
constants of Stafford's Mix13). Probabilities are whole numbers, the same on every machine.
"""

import decimal
import hashlib
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I32, I64, U16, U64, Intp, Ints, UInts
from shuttle_marl.base.errors import seed_number

CHOICE_ONE: Final = 65535  # draws that choose lie in [0, 65535), so that a 16-bit cumulative probability can say "certainly"

POSITION_SHIFT: Final = np.uint64(16)  # bits by which a draw is shifted to choose a position instead of a stroke

GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)
MIX_1: Final = np.uint64(0xBF58476D1CE4E5B9)
MIX_2: Final = np.uint64(0x94D049BB133111EB)


def mix(x: U64) -> U64:
    """A bijection of 64-bit integers that scrambles all bits; any shape."""
    x = (x ^ (x >> np.uint64(30))) * MIX_1
    x = (x ^ (x >> np.uint64(27))) * MIX_2
    return x ^ (x >> np.uint64(31))


def stream(seed: int | U64, *numbers: int | Ints) -> U64:
    """Key of a stream of draws, from a seed and the numbers that name it (pair, match, rally, …); broadcasts, also over seeds.

    Raises:
        OptionError: the seed is no whole number from 0 up to 2^64.
    """
    with np.errstate(over="ignore"):
        number = seed if isinstance(seed, np.ndarray) else np.array(seed_number(seed), dtype=np.uint64)
        key = mix(np.atleast_1d(number) + GOLDEN)
    for each in numbers:
        key = extend(key, each)
    return key


def extend(key: U64, number: int | Ints) -> U64:
    """Key of the stream named by the numbers of ``key`` and one more: ``stream(s, a, b) == extend(stream(s, a), b)``."""
    with np.errstate(over="ignore"):
        return mix((key ^ np.asarray(number).astype(np.uint64)) + GOLDEN)


def pairing_key(*names: str) -> int:
    """Seed key of the matches between two policies; it does not depend on the order of their names."""
    digest = hashlib.sha256("\n".join(sorted(names)).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


def draw(key: U64, counter: Ints | int) -> U64:
    """64 random bits for each key and counter."""
    with np.errstate(over="ignore"):
        return mix(mix(key + np.asarray(counter).astype(np.uint64) * GOLDEN) + GOLDEN)


def outcome_draw(bits: U64) -> I32:
    """The part of a draw that decides the outcome of a stroke: uniform in [0, 2^24).

    The lowest 16 bits decide between a fault, a winner and the contact of a return, the upper 8 whether the receiver is hurried.
    """
    return (bits & np.uint64(0xFFFFFF)).astype(np.int32)


def choice_draw(bits: U64) -> I32:
    """The part of a draw that chooses a stroke: uniform in [0, 65535)."""
    return (((bits >> np.uint64(32)) * np.uint64(CHOICE_ONE)) >> np.uint64(32)).astype(np.int32)


def position_draw(bits: U64) -> I32:
    """The part of a draw that chooses a position: uniform in [0, 65535).

    A choice leaves the lower 16 bits of its half uniform, and a position those of the outcome: each is an interval of 32 bits.
    """
    return choice_draw(bits << POSITION_SHIFT)


def first_server(bits: U64) -> U64:
    """Seat that serves first, 0 or 1, from the first draw of a rally, where it is random."""
    return (bits >> np.uint64(24)) & np.uint64(1)


def chosen(cumulative: U16 | F64, draw: Ints) -> Intp:
    """The one rule by which draws choose strokes: the first entry above the draw.

    The compiled kernel and environments of one rally at a time do the same.

    Args:
        cumulative: ``[B, K]`` cumulative probabilities of K strokes, whole numbers that rise to 65535.
        draw: ``[B]`` uniform integers in [0, 65535), see :func:`choice_draw`.
    """
    return np.greater(cumulative, draw.astype(cumulative.dtype)[:, None]).argmax(axis=1)


ONE: Final = 1 << 16  # probability 1 in fixed point
HURRY_ONE: Final = 1 << 8  # probability 1 of a hurried receiver in fixed point
Odds = tuple[U64, U64]  # what odds are multiplied and divided by, in units of 1/65536


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
    """Multipliers and divisors of odds, exact; ``steps``: whole numbers, at most 8 in log-odds; ``step``: a power of two."""
    sizes, place = np.unique(np.abs(steps), return_inverse=True)
    with decimal.localcontext(decimal.Context(prec=40)):
        odds = [(decimal.Decimal(step) * k).exp() * ONE for k in sizes.tolist()]
        whole = np.array([int(x.to_integral_value(decimal.ROUND_HALF_EVEN)) for x in odds], dtype=np.uint64)
    rising, none = whole[place.reshape(steps.shape)], np.uint64(ONE)
    return np.where(steps > 0, rising, none), np.where(steps < 0, rising, none)
