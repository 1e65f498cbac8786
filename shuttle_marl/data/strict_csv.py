"""Tables of text, and strict reading of CSV files: every problem of a value is recorded with file, line and value."""

import csv
import dataclasses
import functools
import io
import itertools
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F64, I8, I64, Bools, Ints
from shuttle_marl.base.errors import ShuttleError, command
from shuttle_marl.base.files import MAX_LINES, problem, read_file


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
    def of(cls, problems: Sequence[Problem], advice: tuple[str, ...] = ()) -> "DataError":
        """One error for several problems; ``advice``: arguments with which ``validate`` lists them."""
        problems = grouped(problems)
        error = cls(problems[0].path, problems[0].message, line=problems[0].line)
        error.problems, error.args = tuple(problems), (str(problems[0]),)
        if len(problems) > 1:
            listed = command("data", "validate", *advice)
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


_LARGEST: Final = 1e15
"""Bound of numbers; float32 takes them and their squares."""
_MOST_ROWS: Final = 500_000
_MOST_PROBLEMS: Final = 10_000
_LONGEST: Final = 100
"""Characters of a value that a message shows."""
DELIMITERS: Final = (",", ";", "\t", "|")
"""Delimiters that are recognised, the usual one first."""
_SEPARATOR: Final = re.compile(r'"?sep=(.)"?[\r\n]+')
"""First line with which spreadsheets state the delimiter."""
_CLOCK: Final = re.compile(r"(\d{1,4}):([0-5]\d):([0-5]\d)", re.ASCII)
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


class Sheet:
    """The n rows of a table of text with a header; text is in Unicode normal form C.

    An invalid value becomes a missing one, its row is marked, and the problem is recorded. The caller decides whether problems
    are fatal.

    Attributes:
        unit: what ``line`` counts (:class:`Problem`).
        line: ``[n]`` (last) line of each row in the file, from 1.
        columns: ``[n]`` values of each column.
        empty: number of further rows, without any value.
        others: number of further rows that cannot be read, or entries that are no strokes.
        problems: problems so far.
        warnings: what is strange and not wrong.
        unreadable: ``[n]`` rows with an invalid value.
    """

    def __init__(self, path: Path, content: bytes, *, unit: str = "line", decimal: str = ".") -> None:
        """A table without rows; :meth:`fill` follows."""
        self.path, self.content, self.unit, self._decimal = path, content, unit, decimal
        self.header: tuple[str, ...] = ()
        self.columns: dict[str, tuple[str, ...]] = {}
        self.problems: list[Problem] = []
        self._seen: set[Problem] = set()
        self.warnings: list[Problem] = []
        self.empty = self.others = 0

    def fill(self, header: Sequence[str], rows: Sequence[Sequence[str]], lines: Sequence[int]) -> None:
        """Set the rows.

        Raises:
            DataError: there are none, or too many.
        """
        if not rows:
            raise DataError(self.path, "no strokes")
        if len(rows) > _MOST_ROWS:
            raise DataError(self.path, f"more than {_MOST_ROWS:,} rows; divide the file")
        self.header = tuple(unicodedata.normalize("NFC", name) for name in header)
        self.line = np.array(lines)
        self.unreadable = np.zeros(len(rows), dtype=bool)
        self.columns = dict(zip(self.header, zip(*rows, strict=True), strict=True))

    def require(self, names: Iterable[str], line: int | None = None) -> None:
        """Check that columns stand there once, in a header on that line.

        Raises:
            DataError: one does not.
        """
        names = list(names)
        if twice := sorted({name for name in names if self.header.count(name) > 1}):
            raise DataError(self.path, f"several columns {', '.join(twice)}; rename or remove all but one", line=line)
        if missing := [name for name in names if name not in self.header]:
            header = shown(",".join(self.header))
            raise DataError(self.path, f"missing column {', '.join(missing)}; the header is {header}", line=line)

    def without(self, rows: Bools) -> "Sheet":
        """The same without some rows, problems and warnings."""
        kept = ~rows
        columns = (itertools.compress(self.columns[name], kept) for name in self.header)
        other = Sheet(self.path, self.content, unit=self.unit, decimal=self._decimal)
        other.fill(self.header, list(zip(*columns, strict=True)), self.line[kept].tolist())
        other.empty, other.others = self.empty, self.others
        return other

    def add_column(self, name: str, values: Ints) -> None:
        """Add a column of numbers."""
        self.header += (name,)
        self.columns[name] = tuple(map(str, values.tolist()))

    def __len__(self) -> int:
        return len(self.line)

    @property
    def total(self) -> int:
        """Number of all rows of the file, read or not."""
        return len(self) + self.empty + self.others

    def add(self, line: int, message: str) -> None:
        """Record a problem of a line, once.

        Raises:
            DataError: there are too many to continue.
        """
        found = Problem(self.path, message, line, self.unit)
        if found in self._seen:
            return
        self._seen.add(found)
        self.problems.append(found)
        if len(self.problems) == _MOST_PROBLEMS:
            raise DataError.of([*self.problems, Problem(self.path, "too many problems; the rest is not listed")])

    def mark(self, rows: int | np.integer | Ints, message: str) -> None:
        """Record a problem of rows."""
        for row in np.atleast_1d(rows).tolist():
            self.add(int(self.line[row]), message)
            self.unreadable[row] = True

    def warn(self, rows: Iterable[int | np.integer], message: str) -> None:
        """Record what is strange about rows; nothing without rows."""
        self.warnings.extend(Problem(self.path, message, int(self.line[row]), self.unit) for row in rows)

    def text(self, column: str) -> tuple[str, ...]:
        """``[n]`` values as text."""
        return self.columns[column]

    def numbers(self, column: str) -> F64:
        """``[n]`` numbers, NaN for empty values and, with a problem, for values that are not finite numbers."""
        text = self.text(column)
        plain = text if self._decimal == "." else tuple(t.replace(self._decimal, ".") for t in text)
        values = np.array([_float(t) for t in plain]) if any(text) else np.full(len(text), np.nan)
        for row in np.flatnonzero(~(np.abs(values) < _LARGEST)):
            if text[row]:
                self.mark(row, f"{column} {shown(text[row])} is {'too large' if np.isfinite(values[row]) else 'not a number'}")
                values[row] = np.nan
        return values

    def integers(self, column: str, low: int, high: int, *, missing: int, empty: bool = False) -> I64:
        """``[n]`` integers from low to high; any other value is a problem and becomes ``missing``.

        Args:
            empty: whether an empty value is no problem.
        """
        values, text = self.numbers(column), self.text(column)
        fine = (values >= low) & (values <= high) & (values == np.floor(values))
        expected = f"; expected nothing or {low} to {high}" if empty else f" is not an integer from {low} to {high}"
        for row in np.flatnonzero(~fine):
            if np.isfinite(values[row]) or not (text[row] or empty):
                self.mark(row, f"{column} {shown(text[row])}{expected}")
        return np.where(fine, np.nan_to_num(values), missing).astype(np.int64)

    def codes(self, column: str, high: int) -> I8:
        """``[n]`` integers from 1 to high, 0 for empty values."""
        return self.integers(column, 1, high, missing=0, empty=True).astype(np.int8)

    def choices(self, column: str, codes: Mapping[str, int]) -> I8:
        """``[n]`` codes of the values; unknown values are a problem and become -1."""
        text = self.text(column)
        if unknown := set(text) - codes.keys():
            known = ", ".join(key or "nothing" for key in codes)
            for row, value in enumerate(text):
                if value in unknown:
                    self.mark(row, f"unknown {column} {shown(value)}; expected one of {known}")
        return np.array([codes.get(value, -1) for value in text], dtype=np.int8)

    def seconds(self, column: str) -> I64:
        """``[n]`` times h:mm:ss in seconds; other values are a problem and become -1."""
        text = self.text(column)
        values = np.array([_seconds(value) for value in text])
        for row in np.flatnonzero(values < 0):
            self.mark(row, f"{column} {shown(text[row])}; expected h:mm:ss")
        return values


class StrictCsv(Sheet):
    """The rows of a CSV file in UTF-8 with a header."""

    def __init__(self, path: Path, required: Sequence[str], *, delimiter: str | None = ",", decimal: str = ".") -> None:
        """Read a file.

        Args:
            required: headers of the columns to read.
            delimiter: of values; None: the most frequent one of the header.

        Raises:
            DataError: the file cannot be opened or decoded, or is too large; a required column is missing or there twice; there
                are no rows.
        """
        super().__init__(path, read_content(path), decimal=decimal)
        text = io.StringIO(unicodedata.normalize("NFC", _decode(path, self.content)), newline="")
        if stated := _SEPARATOR.match(text.getvalue()):
            text.readline()
            if delimiter is not None and stated[1] != delimiter:
                raise DataError(path, f"the delimiter is {stated[1]!r} here, and {delimiter!r} in the map of its columns", line=1)
        above = int(stated is not None)
        if delimiter is None:
            first = text.getvalue().splitlines()[above : above + 1] or [""]
            delimiter = stated[1] if stated else max(DELIMITERS, key=first[0].count)
            self._decimal = "." if delimiter == "," else ","
        reader = csv.reader(text, delimiter=delimiter, strict=True)
        rows, lines = [], []
        try:
            if not (header := next(reader, [])):
                raise DataError(path, "the file is empty")
            self.header = tuple(header)
            self.require(required, 1 + above)
            for row in reader:
                line = reader.line_num + above
                if not any(cell.strip() for cell in row):
                    self.empty += bool(row)
                elif len(row) != len(header):
                    self.others += 1
                    self.add(
                        line, f"{len(row)} fields instead of {len(header)}, ending in {shown(row[-1])}: is the file truncated?"
                    )
                elif any("\n" in cell and cell.count(delimiter) >= len(header) - 1 for cell in row):
                    self.others += 1
                    self.add(line, "a value contains lines that look like rows: is a quotation mark missing?")
                else:
                    rows.append(row)
                    lines.append(line)
                if len(rows) + self.empty > _MOST_ROWS:
                    raise DataError(path, f"more than {_MOST_ROWS:,} rows; divide the file")
        except csv.Error as error:
            raise DataError(path, f"{error}: is a quotation mark missing?", line=reader.line_num + above) from error
        if not rows:
            raise DataError.of(self.problems) if self.problems else DataError(path, "no rows below the header")
        self.fill(header, rows, lines)
        for found in self.problems:  # a row is missing between these two
            after = int(np.searchsorted(self.line, found.line or 0))
            self.unreadable[max(0, after - 1) : after + 1] = True


def read_content(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        DataError: it cannot be opened, or is too large.
    """
    try:
        return read_file(path, MAX_LINES)
    except (OSError, ValueError) as error:
        raise DataError(path, f"cannot be read ({problem(error)})") from error


def shown(value: str) -> str:
    """A value in a message, quoted and cut."""
    return repr(value if len(value) <= _LONGEST else f"{value[:_LONGEST]}…")


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


@functools.lru_cache(maxsize=1 << 16)
def _seconds(text: str) -> int:
    clock = _CLOCK.fullmatch(text)
    if clock is None:
        return -1
    hours, minutes, seconds = map(int, clock.groups())
    return 3600 * hours + 60 * minutes + seconds
