"""Base class of everything that users can fix, errors and checks that several packages share, and the words they are told in."""

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


def described(error: BaseException) -> str:
    """The type and the message of an error that code of others raised; never fails itself."""
    try:
        message = str(error)
    except Exception:
        message = "(its message cannot be read)"
    return f"{type(error).__name__}: {message}"


def printable(text: str, *, keep: str = "") -> str:
    r"""Replace every character that a terminal does not print by its escape, such as ``\x1b`` or ``\u202e``.

    Names in files come from others: control characters in them move the cursor, change colours and titles, or reverse the
    order of the line; halves of a surrogate pair (undecodable bytes of a path) cannot be written at all.

    Args:
        text: any text.
        keep: characters that stay although they are not printable, such as a newline.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode("ascii") for c in text)
