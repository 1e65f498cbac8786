"""What a reader gives: a table of text, and what its format does not have."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from shuttle_marl.data.strict_csv import DataError, Sheet

_LONGEST: Final = 1000
"""Most characters of a name or a word."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Reading:
    """A file of any format as a table.

    Attributes:
        source: source of the matches, unless the map of the user names one.
        strict: whether a problem stops the import; otherwise its rally is dropped, because users cannot correct the file.
        lost: sentences on what the format, or this file, does not have.
        inferred: sentences on what is inferred from other values.
    """

    format: str
    sheet: Sheet
    source: str
    strict: bool = False
    lost: tuple[str, ...] = ()
    inferred: tuple[str, ...] = ()


def sheet_of(path: Path, content: bytes, entries: Sequence[Mapping[str, str]], lines: Sequence[int], unit: str = "line") -> Sheet:
    """The table of entries, whose keys are its headers.

    Args:
        entries: the strokes; a missing key is an empty value.
        lines: where each stands.
        unit: what ``lines`` counts.

    Raises:
        DataError: there are none, or too many, or a value is too long.
    """
    header = list(dict.fromkeys(name for entry in entries for name in entry))
    for entry, line in zip(entries, lines, strict=True):
        if any(len(value) > _LONGEST for value in entry.values()):
            raise DataError(path, f"a value of more than {_LONGEST:,} characters in {unit} {line}")
    sheet = Sheet(path, content, unit=unit)
    sheet.fill(header, [[entry.get(name, "") for name in header] for entry in entries], lines)
    return sheet


def spans_around(spans: Sequence[tuple[float, float]], moments: Sequence[float]) -> list[int]:
    """Number, from 1, of the last span that each moment lies in, 0 for none; in the time of sorting.

    Args:
        spans: start and end of each, in order of time.
        moments: in any order.
    """
    number = [0] * len(moments)
    around: list[int] = []  # spans that have begun and may not be over, each with an earlier end than the one before it
    begun = 0
    for k in sorted(range(len(moments)), key=moments.__getitem__):
        while begun < len(spans) and spans[begun][0] <= moments[k]:
            while around and spans[around[-1]][1] <= spans[begun][1]:
                around.pop()
            around.append(begun)
            begun += 1
        while around and spans[around[-1]][1] < moments[k]:
            around.pop()
        number[k] = around[-1] + 1 if around else 0
    return number
