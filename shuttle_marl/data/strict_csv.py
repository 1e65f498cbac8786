"""Strict reading of CSV files: every value is checked, and every problem is recorded with file, line and value."""

import csv
import dataclasses
import functools
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.arrays import F64, I8, I64
from shuttle_marl.errors import ShuttleError, command
from shuttle_marl.files import open_file, problem


@dataclasses.dataclass(frozen=True)
class Problem:
    """A problem of a file.

    Attributes:
        path: the file or folder.
        message: description with the value and the expectation.
        line: line in the file, from 1; None for the whole file.
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
        problems: all problems, at least one; the message is the first.
    """

    def __init__(self, path: Path, message: str, *, line: int | None = None) -> None:
        self.problems: tuple[Problem, ...] = (Problem(path, message, line),)
        super().__init__(str(self.problems[0]))

    @classmethod
    def of(cls, problems: Sequence[Problem], advice: tuple[str, ...] = ()) -> "DataError":
        """One error for several problems; ``advice``: options with which ``validate`` lists them."""
        problems = grouped(problems)
        error = cls(problems[0].path, problems[0].message, line=problems[0].line)
        error.problems = tuple(problems)
        if len(problems) > 1:
            files = (str(problems[0].path), *advice) if advice else ()
            listed = command("data", "validate", *files)
            error.args = (f"{problems[0]} (and {len(problems) - 1} more; `{listed}` lists them all)",)
        return error


def grouped(problems: Sequence[Problem]) -> list[Problem]:
    """Problems with equal messages as one, with their number, at the line of the first."""
    groups: dict[tuple[Path, str], list[Problem]] = {}
    for found in problems:
        groups.setdefault((found.path, found.message), []).append(found)
    return [
        first if not others else dataclasses.replace(first, message=f"{first.message} ({len(others) + 1:,} times, first here)")
        for first, *others in groups.values()
    ]


_CLOCK: Final = re.compile(r"(\d{1,4}):([0-5]\d):([0-5]\d)", re.ASCII)
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


class StrictCsv:
    """The n rows of a CSV file in UTF-8 with a header.

    An invalid value becomes a missing one, its row is marked, and the problem is recorded. The caller decides whether problems
    are fatal.

    Attributes:
        path: the file.
        content: its bytes.
        line: ``[n]`` (last) line of each row in the file, from 1.
        problems: problems so far.
        unreadable: ``[n]`` rows with an invalid value.
    """

    def __init__(self, path: Path, required: Sequence[str], *, delimiter: str = ",", decimal: str = ".") -> None:
        """Read a file.

        Args:
            path: the file.
            required: headers of the columns to read.
            delimiter: of values.
            decimal: decimal mark.

        Raises:
            DataError: the file cannot be opened or decoded, a required column is missing, or there are no rows.
        """
        self.path = path
        self._decimal = decimal
        try:
            with open_file(path) as file:
                self.content = file.read()
        except (OSError, ValueError) as error:
            raise DataError(path, f"cannot be read ({problem(error)})") from error
        reader = csv.reader(io.StringIO(_decode(path, self.content), newline=""), delimiter=delimiter)
        header = next(reader, [])
        if not header:
            raise DataError(path, "the file is empty")
        missing = [column for column in required if column not in header]
        if missing:
            raise DataError(path, f"missing column {', '.join(missing)}; the header is {','.join(header)!r}", line=1)
        self.problems: list[Problem] = []
        rows, lines = [], []
        try:
            for row in reader:
                if not any(cell.strip() for cell in row):
                    continue
                if len(row) == len(header):
                    rows.append(row)
                    lines.append(reader.line_num)
                else:
                    self.add(
                        reader.line_num,
                        f"{len(row)} fields instead of {len(header)}, ending in {row[-1]!r}: is the file truncated?",
                    )
        except csv.Error as error:
            raise DataError(path, str(error), line=reader.line_num) from error
        if not rows:
            raise DataError.of(self.problems) if self.problems else DataError(path, "no rows below the header")
        self.line = np.array(lines)
        self.unreadable = np.zeros(len(rows), dtype=bool)
        for found in self.problems:  # a row is missing between these two
            after = int(np.searchsorted(self.line, found.line or 0))
            self.unreadable[max(0, after - 1) : after + 1] = True
        columns = zip(*rows, strict=True)
        self._columns = {name: column for name, column in zip(header, columns, strict=True) if name in required}

    def __len__(self) -> int:
        return len(self.line)

    def add(self, line: int, message: str) -> None:
        """Record a problem of a line."""
        self.problems.append(Problem(self.path, message, line))

    def mark(self, row: int | np.integer, message: str) -> None:
        """Record a problem of a row."""
        self.add(int(self.line[row]), message)
        self.unreadable[row] = True

    def text(self, column: str) -> tuple[str, ...]:
        """``[n]`` values as text."""
        return self._columns[column]

    def numbers(self, column: str) -> F64:
        """``[n]`` numbers, NaN for empty values and, with a problem, for values that are not finite numbers."""
        text = self._columns[column]
        plain = text if self._decimal == "." else tuple(t.replace(self._decimal, ".") for t in text)
        values = np.array([_float(t) for t in plain]) if any(text) else np.full(len(text), np.nan)
        for row in np.flatnonzero(~np.isfinite(values)):
            if text[row]:
                self.mark(row, f"{column} {text[row]!r} is not a number")
                values[row] = np.nan
        return values

    def integers(self, column: str, low: int, high: int, *, missing: int) -> I64:
        """``[n]`` integers from low to high; any other value, also an empty one, is a problem and becomes ``missing``."""
        values = self.numbers(column)
        fine = (values >= low) & (values <= high) & (values == np.floor(values))
        text = self._columns[column]
        for row in np.flatnonzero(~fine):
            if np.isfinite(values[row]) or not text[row]:
                self.mark(row, f"{column} {text[row]!r} is not an integer from {low} to {high}")
        return np.where(fine, np.nan_to_num(values), missing).astype(np.int64)

    def codes(self, column: str, high: int) -> I8:
        """``[n]`` integers from 1 to high, 0 for empty values."""
        values = self.numbers(column)
        fine = np.isnan(values) | ((values >= 1) & (values <= high) & (values == np.floor(values)))
        for row in np.flatnonzero(~fine):
            self.mark(row, f"{column} {self._columns[column][row]!r}; expected nothing or 1 to {high}")
        return np.where(fine, np.nan_to_num(values), 0).astype(np.int8)

    def choices(self, column: str, codes: Mapping[str, int]) -> I8:
        """``[n]`` codes of the values; unknown values are a problem and become -1."""
        text = self._columns[column]
        if unknown := set(text) - codes.keys():
            known = ", ".join(key or "nothing" for key in codes)
            for row, value in enumerate(text):
                if value in unknown:
                    self.mark(row, f"unknown {column} {value!r}; expected one of {known}")
        return np.array([codes.get(value, -1) for value in text], dtype=np.int8)

    def seconds(self, column: str) -> I64:
        """``[n]`` times h:mm:ss in seconds; other values are a problem and become -1."""
        text = self._columns[column]
        known = {value: _seconds(value) for value in set(text)}
        values = np.array([known[value] for value in text])
        for row in np.flatnonzero(values < 0):
            self.mark(row, f"{column} {text[row]!r}; expected h:mm:ss")
        return values


def _decode(path: Path, content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise DataError(path, f"byte 0x{content[error.start]:02x} is not UTF-8; save the file as UTF-8", line=line) from None


@functools.lru_cache(maxsize=1 << 16)
def _float(text: str) -> float:
    # `float` also accepts 1_000, Arabic digits and infinity.
    return float(text) if _NUMBER.fullmatch(text) else np.nan


def _seconds(text: str) -> int:
    clock = _CLOCK.fullmatch(text)
    if clock is None:
        return -1
    hours, minutes, seconds = map(int, clock.groups())
    return 3600 * hours + 60 * minutes + seconds
