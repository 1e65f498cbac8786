"""Strict reading of CSV files: every value is checked, and every problem is kept with its file, line and value."""

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
from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import open_file, problem


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
    def of(cls, problems: Sequence[Problem], advice: str = "") -> "DataError":
        """One error that carries several problems; ``advice``: a flag with which ``validate`` has to be called."""
        error = cls(problems[0].path, problems[0].message, line=problems[0].line)
        error.problems = tuple(problems)
        if len(problems) > 1:
            command = " ".join(
                filter(None, ("python -m shuttle_marl.data validate", f"{problems[0].path}" if advice else "", advice))
            )
            error.args = (f"{problems[0]} (and {len(problems) - 1} more; `{command}` lists them all)",)
        return error


_CLOCK: Final = re.compile(r"(\d{1,4}):([0-5]\d):([0-5]\d)", re.ASCII)
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


class StrictCsv:
    """The n rows of a CSV file in UTF-8 with a header.

    Reading a column never stops at a bad value: the value becomes a missing one, the row is marked, and the problem is
    added to the list. The caller decides whether problems are fatal.

    Attributes:
        path: the file.
        content: its bytes.
        line: ``[n]`` line of each row in the file, from 1; where a quoted value spans lines, the last of them.
        problems: what is wrong so far.
        unreadable: ``[n]`` rows with a value that cannot be what it should be.
    """

    def __init__(self, path: Path, required: Sequence[str], *, delimiter: str = ",", decimal: str = ".") -> None:
        """Read a file.

        Args:
            path: the file.
            required: headers of the columns that are read.
            delimiter: between two values.
            decimal: mark of decimals.

        Raises:
            DataError: it cannot be opened or decoded, a required column is missing, or it holds no rows.
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
                if len(row) == len(header):
                    rows.append(row)
                    lines.append(reader.line_num)
                elif row:
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
        columns = zip(*rows, strict=True)
        self._columns = {name: column for name, column in zip(header, columns, strict=True) if name in required}

    def __len__(self) -> int:
        return len(self.line)

    def add(self, line: int, message: str) -> None:
        """Note a problem that belongs to no row that was read."""
        self.problems.append(Problem(self.path, message, line))

    def mark(self, row: int | np.integer, message: str) -> None:
        """Note a problem of a row."""
        self.add(int(self.line[row]), message)
        self.unreadable[row] = True

    def text(self, column: str) -> tuple[str, ...]:
        """``[n]`` the values as they stand."""
        return self._columns[column]

    def numbers(self, column: str) -> F64:
        """``[n]`` numbers, NaN where the value is empty or no finite number (the latter is a problem)."""
        text = self._columns[column]
        plain = text if self._decimal == "." else tuple(t.replace(self._decimal, ".") for t in text)
        values = np.array([_float(t) for t in plain]) if any(text) else np.full(len(text), np.nan)
        for row in np.flatnonzero(~np.isfinite(values)):
            if text[row]:
                self.mark(row, f"{column} {text[row]!r} is not a number")
                values[row] = np.nan
        return values

    def integers(self, column: str, low: int, high: int, *, missing: int) -> I64:
        """``[n]`` whole numbers from low to high; anything else, even nothing, is a problem and becomes ``missing``."""
        values = self.numbers(column)
        fine = (values >= low) & (values <= high) & (values == np.floor(values))
        text = self._columns[column]
        for row in np.flatnonzero(~fine):
            if np.isfinite(values[row]) or not text[row]:
                self.mark(row, f"{column} {text[row]!r} is no whole number from {low} to {high}")
        return np.where(fine, np.nan_to_num(values), missing).astype(np.int64)

    def codes(self, column: str, high: int) -> I8:
        """``[n]`` whole numbers from 1 to high, 0 where the value is empty."""
        values = self.numbers(column)
        fine = np.isnan(values) | ((values >= 1) & (values <= high) & (values == np.floor(values)))
        for row in np.flatnonzero(~fine):
            self.mark(row, f"{column} {self._columns[column][row]!r}; expected nothing or 1 to {high}")
        return np.where(fine, np.nan_to_num(values), 0).astype(np.int8)

    def choices(self, column: str, codes: Mapping[str, int]) -> I8:
        """``[n]`` codes of the values; a value that has none is a problem and becomes -1."""
        text = self._columns[column]
        if unknown := set(text) - codes.keys():
            known = ", ".join(key or "nothing" for key in codes)
            for row, value in enumerate(text):
                if value in unknown:
                    self.mark(row, f"unknown {column} {value!r}; expected one of {known}")
        return np.array([codes.get(value, -1) for value in text], dtype=np.int8)

    def seconds(self, column: str) -> I64:
        """``[n]`` times of the form h:mm:ss in seconds; anything else is a problem and becomes -1."""
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
    # `float` reads more than numbers as they are written in files: 1_000, Arabic digits, infinity.
    return float(text) if _NUMBER.fullmatch(text) else np.nan


def _seconds(text: str) -> int:
    clock = _CLOCK.fullmatch(text)
    if clock is None:
        return -1
    hours, minutes, seconds = map(int, clock.groups())
    return 3600 * hours + 60 * minutes + seconds
