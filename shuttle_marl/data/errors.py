"""Errors of reading match data: what is wrong, in which file, on which line, with which value."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from shuttle_marl.errors import ShuttleError


@dataclasses.dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a file.

    Attributes:
        path: the file or folder.
        message: what is wrong, with the value and what was expected.
        line: line in the file, from 1; None where it concerns the file as a whole.
    """

    path: Path
    message: str
    line: int | None = None

    def __str__(self) -> str:
        where = f"{self.path}" if self.line is None else f"{self.path}, line {self.line}"
        return f"{where}: {self.message}"


class DataError(ShuttleError):
    """Match data that cannot be read; the message names file, line and value.

    Attributes:
        problems: everything that was found, at least one; the message tells the first.
    """

    def __init__(self, path: Path, message: str, *, line: int | None = None) -> None:
        self.problems: tuple[Problem, ...] = (Problem(path, message, line),)
        super().__init__(str(self.problems[0]))

    @classmethod
    def of(cls, problems: Sequence[Problem]) -> "DataError":
        """One error that carries several problems."""
        error = cls(problems[0].path, problems[0].message, line=problems[0].line)
        error.problems = tuple(problems)
        if len(problems) > 1:
            error.args = (f"{problems[0]} (and {len(problems) - 1} more; `python -m shuttle_marl.data validate` lists them all)",)
        return error
