"""Tables of text, which all readers give, and the parser of CSV in bounded time and memory.

Every problem of a value is recorded with file, line and value.
"""

import csv
import dataclasses
import functools
import io
import itertools
import re
import unicodedata
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.base.files import MAX_LINES, problem, read_file
from shuttle_marl.data.schema import DataError, Problem, shown
from shuttle_marl.data.words import WORDS, ColumnMap, Words, plain, whole

_LARGEST: Final = 1e15  # bound of numbers; float32 takes them and their squares
_MOST_ROWS: Final = 500_000
_MOST_PROBLEMS: Final = 10_000
_LONGEST: Final = 1000  # most characters of a value in a file of another program
DELIMITERS: Final = (",", ";", "\t", "|")
_SEPARATOR: Final = re.compile(r'"?sep=(.)"?[\r\n]+')  # first line with which spreadsheets state the delimiter
_MAY_BE_EMPTY: Final = ("area", "ending", "height", "technique", "forced", "hand", "rules")
_MOST_HINTS: Final = 50  # unknown words of a column for which a similar one is looked up
_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclasses.dataclass(eq=False, kw_only=True)
class Sheet:
    """The n rows of a table of text. An invalid value becomes a missing one, its row is marked, and the problem is recorded. The
    caller decides whether problems are fatal."""

    path: Path
    content: bytes
    format: str = "CSV"
    source: str = "own matches"  # of the matches, unless the map of the user names one
    strict: bool = False  # whether a problem stops the import; else its rally is dropped, as users cannot correct the file
    lost: Sequence[str] = ()  # sentences on what the format, or this file, does not have
    inferred: Sequence[str] = ()  # sentences on what the import so far inferred from other values, of all rows
    decimal: str = "."
    header: tuple[str, ...] = ()
    columns: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)  # [n] values by header
    map: ColumnMap = dataclasses.field(default_factory=ColumnMap)  # of the columns that are read, by the names that methods take
    line: I64 = dataclasses.field(default_factory=lambda: np.zeros(0, np.int64))  # [n] (last) line of each row, from 1
    unreadable: Bools = dataclasses.field(default_factory=lambda: np.zeros(0, bool))  # [n] rows with an invalid value
    empty: int = 0  # number of further rows without any value
    others: int = 0  # number of rows that cannot be read or are no strokes
    problems: dict[Problem, None] = dataclasses.field(default_factory=dict)  # so far, each once
    warnings: list[Problem] = dataclasses.field(default_factory=list)  # what is strange and not wrong
    notes: list[str] = dataclasses.field(default_factory=list)  # the same, of the rows that are left

    @classmethod
    def of(cls, path: Path, content: bytes, entries: Sequence[Mapping[str, str]], lines: Sequence[int], **about: Any) -> "Sheet":
        """The table of strokes from values by header, where a missing key is an empty value, and the line of each."""
        sheet = cls(path=path, content=content, **about)
        for entry, line in zip(entries, lines, strict=True):
            if any(len(value) > _LONGEST for value in entry.values()):
                raise DataError(path, f"a value of more than {_LONGEST:,} characters", line=line)
        header = tuple(dict.fromkeys(name for entry in entries for name in entry))
        sheet.fill(header, [[entry.get(name, "") for name in header] for entry in entries], lines)
        return sheet

    def fill(self, header: tuple[str, ...], rows: Sequence[Sequence[str]], lines: Sequence[int]) -> None:
        """Set the rows."""
        if not rows:
            raise DataError(self.path, "no strokes")
        self.check_size(len(rows))
        self.header, self.line, self.unreadable = header, np.array(lines), np.zeros(len(rows), dtype=bool)
        self.columns = dict(zip(header, zip(*rows, strict=True), strict=True))

    def check_size(self, rows: int) -> None:
        """Raise a DataError for too many rows."""
        if rows > _MOST_ROWS:
            raise DataError(self.path, f"more than {_MOST_ROWS:,} rows; divide the file")

    def require(self, names: Collection[str], line: int | None = None) -> None:
        """Check that columns stand there once, in a header on that line."""
        if twice := sorted({name for name in names if self.header.count(name) > 1}):
            raise DataError(self.path, f"several columns {', '.join(twice)}; rename or remove all but one", line=line)
        if missing := [name for name in names if name not in self.header]:
            header = shown(",".join(self.header))
            raise DataError(self.path, f"missing column {', '.join(missing)}; the header is {header}", line=line)

    def take(self, rows: Bools) -> "Sheet":
        """The same with some of the rows, and without problems, warnings and notes."""
        columns = {name: tuple(itertools.compress(column, rows)) for name, column in self.columns.items()}
        fresh: dict[str, Any] = {"unreadable": np.zeros(rows.sum(), dtype=bool), "problems": {}, "warnings": [], "notes": []}
        return dataclasses.replace(self, columns=columns, line=self.line[rows], **fresh)

    def __len__(self) -> int:
        return len(self.line)

    def __contains__(self, name: str) -> bool:
        return name in self.map.columns

    def named(self, name: str) -> str:
        """The header of a column."""
        return self.map.columns[name]

    @property
    def total(self) -> int:
        """Number of all rows of the file, read or not."""
        return len(self) + self.empty + self.others

    def add(self, message: str, line: int | None = None) -> None:
        """Record a problem of the file or of a line, once."""
        self.problems[Problem(self.path, message, line)] = None
        if len(self.problems) == _MOST_PROBLEMS:
            raise DataError.of([*self.problems, Problem(self.path, "too many problems; the rest is not listed")])

    def mark(self, rows: int | np.integer | Ints, message: str) -> None:
        """Record a problem of rows."""
        for row in np.atleast_1d(rows).tolist():
            self.add(message, int(self.line[row]))
            self.unreadable[row] = True

    def warn(self, rows: Iterable[int | np.integer] | Bools, message: str) -> None:
        """Record what is strange about rows, numbers or a mask; nothing without rows."""
        rows = np.flatnonzero(rows) if isinstance(rows, np.ndarray) and rows.dtype == bool else rows
        self.warnings.extend(Problem(self.path, message, int(self.line[row])) for row in rows)

    def doubt(self, message: str) -> None:
        """Record what is strange about the file, once."""
        if (found := Problem(self.path, message)) not in self.warnings:
            self.warnings.append(found)

    def text(self, name: str) -> tuple[str, ...]:
        """``[n]`` values as they stand there."""
        return self.columns[self.named(name)]

    def numbers(self, name: str) -> F64:
        """``[n]`` numbers, NaN for empty values, without the column, and, with a problem, for what is no finite number."""
        text = self.text(name) if name in self else ()
        if not any(text):
            return np.full(len(self), np.nan)
        values = np.array([_float(t.replace(self.decimal, ".")) for t in text])
        for row in np.flatnonzero(~(np.abs(values) < _LARGEST)):
            if text[row]:
                wrong = "too large" if np.isfinite(values[row]) else "not a number"
                self.mark(row, f"{self.named(name)} {shown(text[row])} is {wrong}")
                values[row] = np.nan
        return values

    def bounded(self, name: str, low: int, high: int, *, whole: bool = True, needed: bool = False) -> F64:
        """``[n]`` numbers from low to high, ``whole`` ones or any, NaN for empty values and without the column. Any other value
        is a problem and becomes NaN, and so is an empty one that is ``needed``."""
        values = self.numbers(name)
        fine = (values >= low) & (values <= high) & ((values == np.floor(values)) | (not whole))
        for row in np.flatnonzero(~fine & ~np.isnan(values)).tolist():
            expected = f"{'a whole number from ' if whole else ''}{low} to {high}"
            self.mark(row, f"{self.named(name)} {values[row]:g}; expected {expected}")
        if needed and name in self:
            self.mark(np.flatnonzero([not text for text in self.text(name)]), f"{self.named(name)} is empty")
        return np.where(fine, values, np.nan)

    def integers(self, name: str, low: int, high: int, *, missing: int, needed: bool = True) -> I64:
        """``[n]`` whole numbers as :meth:`bounded`, ``missing`` where there is none."""
        return np.nan_to_num(self.bounded(name, low, high, needed=needed), nan=missing).astype(np.int64)

    def codes(self, name: str, codes: Mapping[str, int], missing: int, hint: Callable[[str], str]) -> I64:
        """``[n]`` codes of the texts; any other text is a problem with a hint and becomes ``missing``."""
        text = self.text(name)
        for row, value in enumerate(text) if set(text) - codes.keys() else ():
            if value not in codes:
                self.mark(row, f"unknown {self.named(name)} {shown(value)}; {hint(value)}")
        return np.array([codes.get(value, missing) for value in text], dtype=np.int64)

    def words(self, name: str, missing: int = -1) -> I64:
        """``[n]`` codes of words of any language; ``missing`` for empty values, and for all without the column."""
        if name not in self:
            return np.full(len(self), missing)
        own, texts = self.map.values.get(name, {}), sorted(set(self.text(name)))
        vocabulary, known = Words(name, texts, self.header), dict[str, int]()
        for text in texts:
            meant = own.get(plain(text)) or vocabulary.meaning(whole(text))
            if meant is not None:
                known[text] = WORDS[name].index(meant)
            elif not text.strip() and name in _MAY_BE_EMPTY:
                known[text] = missing
        self.notes += [told for text in texts if plain(text) not in own and (told := vocabulary.ambiguous(text))]
        unknown = [text for text in texts if text not in known][:_MOST_HINTS]
        hints = {text: f"did you mean {meant}?" for text in unknown if (meant := vocabulary.meant(text, own))}
        usual = f"map it in [values.{name}] to one of {', '.join(WORDS[name])}"
        return self.codes(name, known, missing, lambda text: hints.get(text, usual))


def read_csv(path: Path, required: Collection[str] = (), *, delimiter: str | None = ",", decimal: str = ".") -> Sheet:
    """Read a CSV file in UTF-8 with a header; ``required``: headers of the columns to read; ``delimiter``: of values (None: the
    most frequent one of the header)."""
    content = read_content(path)
    text = io.StringIO(unicodedata.normalize("NFC", _decode(path, content)), newline="")
    if stated := _SEPARATOR.match(text.getvalue()):
        text.readline()
        if delimiter is not None and stated[1] != delimiter:
            raise DataError(path, f"the delimiter is {stated[1]!r} here, and {delimiter!r} in the map of its columns", line=1)
    above = int(stated is not None)
    if delimiter is None:
        first = text.getvalue().splitlines()[above : above + 1] or [""]
        delimiter = stated[1] if stated else max(DELIMITERS, key=first[0].count)
        decimal = "." if delimiter == "," else ","
    same = ColumnMap(columns={name: name for name in required})
    sheet = Sheet(path=path, content=content, strict=True, decimal=decimal, map=same)
    reader = csv.reader(text, delimiter=delimiter, strict=True)
    rows, lines = [], []
    try:
        if not (header := tuple(next(reader, []))):
            raise DataError(path, "the file is empty")
        sheet.header = header
        sheet.require(required, 1 + above)
        for row in reader:
            line = reader.line_num + above
            if not any(cell.strip() for cell in row):
                sheet.empty += bool(row)
            elif len(row) != len(header):
                sheet.others += 1
                told = f"{len(row)} fields instead of {len(header)}, ending in {shown(row[-1])}: is the file truncated?"
                sheet.add(told, line)
            elif any("\n" in cell and cell.count(delimiter) >= len(header) - 1 for cell in row):
                sheet.others += 1
                sheet.add("a value contains lines that look like rows: is a quotation mark missing?", line)
            else:
                rows.append(row)
                lines.append(line)
            sheet.check_size(len(rows) + sheet.empty)
    except csv.Error as error:
        raise DataError(path, f"{error}: is a quotation mark missing?", line=reader.line_num + above) from error
    if not rows:
        raise DataError.of([*sheet.problems]) if sheet.problems else DataError(path, "no rows below the header")
    sheet.fill(header, rows, lines)
    for found in sheet.problems:  # a row is missing between these two
        after = int(np.searchsorted(sheet.line, found.line or 0))
        sheet.unreadable[max(0, after - 1) : after + 1] = True
    return sheet


def read_content(path: Path) -> bytes:
    """The bytes of a file."""
    try:
        return read_file(path, MAX_LINES)
    except (OSError, ValueError) as error:
        raise DataError(path, f"cannot be read ({problem(error)})") from error


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


def listed(why: str, names: Sequence[str]) -> list[str]:
    """A sentence that lists some names; none without any."""
    return [f"{why}: {', '.join(map(repr, names[:20]))}"] if names else []
