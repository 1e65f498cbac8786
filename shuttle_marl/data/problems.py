"""Problems of files, each with file, line and value."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from shuttle_marl.base.errors import ShuttleError, command

_LONGEST: Final = 100
"""Characters of a value that a message shows."""


@dataclasses.dataclass(frozen=True)
class Problem:
    """A problem of a file.

    Attributes:
        line: line in the file, from 1; None for the whole file.
        unit: what ``line`` counts: ``line``, or ``entry`` in files where a line tells nothing.
    """

    path: Path
    message: str
    line: int | None = None
    unit: str = "line"

    def __str__(self) -> str:
        where = f"{self.path}" if self.line is None else f"{self.path}, {self.unit} {self.line}"
        return f"{where}: {self.message}"


class DataError(ShuttleError):
    """Match data that cannot be read; the message names file, line and value.

    Attributes:
        problems: all problems, at least one; the message is the first.
        rows: number of rows of the file, as far as they could be read.
    """

    rows = 0

    def __init__(self, path: Path, message: str, *, line: int | None = None) -> None:
        self.problems: tuple[Problem, ...] = (Problem(path, message, line),)
        super().__init__(str(self.problems[0]))

    @classmethod
    def of(cls, problems: Iterable[Problem], advice: tuple[str, ...] = ()) -> "DataError":
        """One error for several problems; ``advice``: arguments with which ``validate`` lists them."""
        problems = grouped(problems)
        error = cls(problems[0].path, problems[0].message, line=problems[0].line)
        error.problems, error.args = tuple(problems), (str(problems[0]),)
        if len(problems) > 1:
            listed = command("data", "validate", *advice)
            error.args = (f"{problems[0]} (and {len(problems) - 1} more; `{listed}` lists them all)",)
        return error


def grouped(problems: Iterable[Problem]) -> list[Problem]:
    """Problems with equal messages as one, with their number, at the line of the first."""
    groups: dict[tuple[Path, str], list[Problem]] = {}
    for found in problems:
        groups.setdefault((found.path, found.message), []).append(found)
    return [
        first if not others else dataclasses.replace(first, message=f"{first.message} ({len(others) + 1:,} times, first here)")
        for first, *others in groups.values()
    ]


def shown(value: str) -> str:
    """A value in a message, quoted and cut."""
    return repr(value if len(value) <= _LONGEST else f"{value[:_LONGEST]}…")
