"""Base class of errors that users can fix, and errors, checks and text functions that several packages share."""

import functools
import inspect
import operator
import re
import shlex
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, TypeVar

T = TypeVar("T")

_LONGEST_MESSAGE: Final = 1000


class ShuttleError(Exception):
    """An error whose message states the problem and the remedy; command lines print it without a traceback."""


class OptionError(ShuttleError):
    """An invalid option of an environment."""


class ActionError(ShuttleError):
    """An action that is not in the action space."""


def whole_number(name: str, value: Any, least: int | None = None) -> int:
    """Check an integer option. Raises OptionError: it is not an integer (fractions are not truncated), or is below ``least``."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or (least is not None and number < least):
        wanted = "a whole number" if least is None else f"a whole number, {least} or more"
        raise OptionError(f"{name} {value!r}: expected {wanted}")
    return number


def seed_number(value: Any) -> int:
    """Check a seed. Raises OptionError: no whole number from 0 up to 2^64; seeds with equal last 64 bits would be one."""
    if not 0 <= (number := whole_number("seed", value)) < 1 << 64:
        hint = "; of a longer one take the last 63 bits" if number > 0 else ""
        raise OptionError(f"seed {number}: expected a whole number from 0 up to 2^64{hint}")
    return number


def did_you_mean(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """A hint at the names that are most like a misspelt one, for the end of a message; empty if none is."""
    import difflib  # noqa: PLC0415  `import shuttle_marl` needs none

    close = difflib.get_close_matches(name, list(known), n=3, cutoff=cutoff)
    return f"; did you mean {', '.join(close[:-1])}{' or ' if close[1:] else ''}{close[-1]}?" if close else ""


_KNOWN: Final = {"autoreset_mode": '; rows are reset in the same step, and in another mode with vectorization_mode="sync"'}
_OF_RESET: Final = "; a seed is an argument of reset(seed=…)"


def suggesting(cls: type[T]) -> type[T]:
    """Class decorator: a keyword argument that the constructor lacks is a TypeError that says which one is like it."""
    init = cls.__init__
    names = list(inspect.signature(init).parameters)[1:]

    @functools.wraps(init)
    def checked(self: T, *args: Any, **options: Any) -> None:
        for name in options:
            if name not in names:
                known = _OF_RESET if name == "seed" and hasattr(cls, "reset") else _KNOWN.get(name)
                hint = known or did_you_mean(name, names) or f"; there are {', '.join(names)}"
                # In the words of Python, on which wrappers of other libraries rely.
                called = cls.__name__.removeprefix("raw_")  # `rally_v0.env` passes its options on
                raise TypeError(f"{called}() got an unexpected keyword argument {name!r}{hint}")
        init(self, *args, **options)

    cls.__init__ = checked  # type: ignore[method-assign, assignment]
    return cls


def described(error: BaseException) -> str:
    """Type and message of an error from foreign code, cut after :data:`_LONGEST_MESSAGE` characters; never raises."""
    try:
        message = str(error)
    except Exception:
        message = "(its message cannot be read)"
    cut = "…" if len(message) > _LONGEST_MESSAGE else ""
    return f"{type(error).__name__}: {message[:_LONGEST_MESSAGE]}{cut}"


def printable(text: str, *, keep: str = "") -> str:
    r"""Replace every unprintable character by its escape, such as ``\x1b`` or ``\u202e``.

    Names in files are untrusted: control characters move the cursor, change colours and titles, or reverse the order of a line;
    lone surrogates (undecodable bytes of a path) cannot be written at all.

    Args:
        keep: unprintable characters that are not replaced, such as a newline.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode("ascii") for c in text)


def counted(number: int, one: str, many: str | None = None) -> str:
    """A number of things, with the word for one or for several: ``1 rally``, ``2 rallies``."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def command(name: str, *arguments: str) -> str:
    """A command line of the package that works as printed: it names the interpreter in use, and is quoted."""
    here, found = Path(sys.executable).absolute(), shutil.which("python")
    if found is not None and Path(found).absolute().parent == here.parent:
        python = "python"
    else:
        python = str(here.relative_to(Path.cwd())) if here.is_relative_to(Path.cwd()) else str(here)
    return " ".join(shlex.quote(printable(word)) for word in (python, "-m", f"shuttle_marl.{name}", *arguments))


_FROM_RIGHT: Final = "\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufefe"
_RUN: Final = re.compile(f"[{_FROM_RIGHT}](?:[{_FROM_RIGHT}\\s.'-]*[{_FROM_RIGHT}])?")


def isolated(text: str) -> str:
    """Text in which words that are written from right to left are isolated, so that the scores beside them keep their order."""
    return _RUN.sub("\u2068\\g<0>\u2069", text)
