"""Base class of everything that users can fix, and errors and checks that several packages share."""

import operator
from typing import Any


class ShuttleError(Exception):
    """An error whose message says what is wrong and what to do; command lines print it without a traceback."""


class OptionError(ShuttleError):
    """An option of an environment that it cannot take."""


class ActionError(ShuttleError):
    """An action that is not in the action space."""


def whole_number(name: str, value: Any, least: int | None = None) -> int:
    """An option that is a whole number.

    Raises:
        OptionError: it is not, or it is below ``least``; a fraction is never cut off.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or (least is not None and number < least):
        wanted = "a whole number" if least is None else f"a whole number, {least} or more"
        raise OptionError(f"{name} {value!r}: expected {wanted}")
    return number
