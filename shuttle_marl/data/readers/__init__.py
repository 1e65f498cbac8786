"""Readers of the files of other programs, one module a format; the format is recognised by the content.

Each has ``recognises(value)`` and ``read(path, content, value)`` for the parsed content: an XML element, a JSON value, or the
sheet of a CSV file. It gives a table of text, a :class:`~shuttle_marl.data.sheet.Sheet`, with headers and words of any language
(:mod:`shuttle_marl.data.words`), which :func:`shuttle_marl.data.own.clean` checks and converts.
"""

from pathlib import Path
from typing import Any, Final

from shuttle_marl.data.column_map import ColumnMap
from shuttle_marl.data.problems import DataError
from shuttle_marl.data.readers import badminton_db, elan, pipeline, shuttleset_game, sportscode, tree
from shuttle_marl.data.sheet import Sheet, read_content, read_csv

_READERS: Final = (elan, sportscode, badminton_db, pipeline, shuttleset_game)
"""The first one that recognises a file reads it."""


def read(path: Path, given: ColumnMap) -> Sheet:
    """Read a file of any format; ``given``: the user's column map.

    Raises:
        DataError: the file cannot be read, or holds no strokes.
    """
    content = read_content(path)
    value = _parsed(path, content, given)
    for reader in _READERS:
        if reader.recognises(value):
            return reader.read(path, content, value)
    if not isinstance(value, Sheet):
        raise DataError(path, f"XML with root {value.tag[:50]!r}; expected annotations of ELAN, or instances of Sportscode")
    return value


def _parsed(path: Path, content: bytes, given: ColumnMap) -> Any:
    start = content[:4000].removeprefix(b"\xef\xbb\xbf").lstrip()
    if start[:1] == b"<" or start[:4] in (b"\xff\xfe<\x00", b"\xfe\xff\x00<"):
        return tree.parse_xml(path, content)
    if start[:1] in (b"{", b"["):
        return tree.parse_json(path, content)
    if start[:4] == b"PK\x03\x04":
        raise DataError(path, "a spreadsheet or an archive; save the sheet as CSV in UTF-8")
    if given.columns:
        return read_csv(path, given.columns.values(), delimiter=given.delimiter or ",", decimal=given.decimal)
    return read_csv(path, delimiter=given.delimiter or None, decimal=given.decimal)
