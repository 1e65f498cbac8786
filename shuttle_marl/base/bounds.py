"""Bounds of numbers, as annotations of the fields of a configuration."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final, get_args, get_type_hints

from shuttle_marl.base.errors import ShuttleError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Within:
    """Bounds of a number, as annotation of a field. NaN is out of all bounds.

    Attributes:
        above: exclusive lower bound.
        text: the bounds in words, for errors.
    """

    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    text: str


Count = Annotated[int, Within(low=1, high=10**15, text="a whole number from 1 to 10^15")]
CountOrZero = Annotated[int, Within(low=0, high=10**15, text="a whole number from 0 to 10^15")]
# PyTorch rounds smaller numbers to 0 and larger ones to infinity.
Positive = Annotated[float, Within(low=1e-30, high=1e30, text="a number from 1e-30 to 1e30")]
Fraction = Annotated[float, Within(low=1e-30, high=1, text="a number from 1e-30 to 1")]
FractionOrZero = Annotated[float, Within(low=0, high=1, text="a number from 0 to 1")]
Weight = Annotated[float, Within(low=0, high=10, text="a number from 0 to 10")]
Growth = Annotated[float, Within(low=0, high=1000, text="a number from 0 to 1,000")]
Seed = Annotated[int, Within(low=0, high=(1 << 63) - 1, text="a whole number from 0 up to 2^63")]


_FROM_TEXT: Final[dict[Any, Callable[[str], Any]]] = {Path: Path, tuple[str, ...]: lambda text: (text,)}


def check_bounds(config: Any, error: type[ShuttleError]) -> None:
    """Check the fields of a dataclass that are annotated with :class:`Within`; None is always allowed.

    A string becomes a path where a path is expected, and the only item where a tuple of strings is.

    Raises:
        error: a field is out of its bounds, or not a whole number.
    """
    for name, hint in get_type_hints(type(config), include_extras=True).items():
        value: Any = getattr(config, name, None)
        if isinstance(value, str) and (alike := [_FROM_TEXT[part] for part in (hint, *get_args(hint)) if part in _FROM_TEXT]):
            object.__setattr__(config, name, alike[0](value))
        for part in (hint, *get_args(hint)) if value is not None else ():  # of `Annotated[…] | None` the first argument
            for bounds in get_args(part):
                if not isinstance(bounds, Within):
                    continue
                whole = get_args(part)[0] is not int or isinstance(value, int)
                if not (whole and bounds.low <= value <= bounds.high and bounds.above < value < math.inf):
                    raise error(f"--{name.replace('_', '-')} {value}: expected {bounds.text}")
