"""Numbers that are the same on every device of PyTorch: the draws of the game, and sums whose order does not matter."""

import math

import torch

from shuttle_marl.game.draws import GOLDEN, MIX_1, MIX_2


def signed(number: int) -> int:
    """A number of 64 bits without a sign as PyTorch's integers hold it; sums and products of them wrap around."""
    return number - (1 << 64) if number >> 63 else number


_GOLDEN, _MIX_1, _MIX_2 = (signed(int(number)) for number in (GOLDEN, MIX_1, MIX_2))


def shifted(x: torch.Tensor, bits: int) -> torch.Tensor:
    """Shifted to the right, with zeros from the left."""
    return (x >> bits) & ((1 << (64 - bits)) - 1)


def mix(x: torch.Tensor) -> torch.Tensor:
    """:func:`shuttle_marl.game.draws.mix` of int64 numbers; any shape."""
    x = (x ^ shifted(x, 30)) * _MIX_1
    x = (x ^ shifted(x, 27)) * _MIX_2
    return x ^ shifted(x, 31)


def extend(key: int, number: torch.Tensor) -> torch.Tensor:
    """:func:`shuttle_marl.game.draws.extend` of one key."""
    return mix((number ^ key) + _GOLDEN)


def draw(key: torch.Tensor, counter: torch.Tensor | int) -> torch.Tensor:
    """:func:`shuttle_marl.game.draws.draw` of int64 keys."""
    return mix(mix(torch.as_tensor(counter, device=key.device) * _GOLDEN + key) + _GOLDEN)


def whole(amounts: torch.Tensor) -> tuple[torch.Tensor, float]:
    """Amounts as whole numbers of a unit that is small enough for them and large enough for their sum.

    Args:
        amounts: ``[N]`` float64, finite.

    Returns:
        ``[N]`` int64, and the unit, a power of two.
    """
    if not len(amounts):
        return amounts.long(), 1.0
    highest = math.frexp(float(amounts.abs().max()))[1]
    unit = 2.0 ** max(highest + len(amounts).bit_length() - 62, -1000)
    return (amounts / unit).round().long(), unit


def sums(group: torch.Tensor, amounts: torch.Tensor, groups: int) -> torch.Tensor:
    """``[groups]`` float64 sums of ``[N]`` amounts by group, the same whatever the order in which they are added."""
    numbers, unit = whole(amounts)
    return numbers.new_zeros(groups).index_add_(0, group, numbers).double() * unit
