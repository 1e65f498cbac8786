"""Readers of the files of other programs, one module a format; the format is recognised by the content.

Each gives a table of text, with headers and words of any language (:mod:`shuttle_marl.data.words`), which
:mod:`shuttle_marl.data.own` checks and converts.
"""

from pathlib import Path

from shuttle_marl.data.column_map import ColumnMap
from shuttle_marl.data.readers import badminton_db, elan, pipeline, shuttleset_game, sportscode, tree
from shuttle_marl.data.readers.reading import Reading
from shuttle_marl.data.strict_csv import DataError, StrictCsv, read_content

__all__ = ["Reading", "read"]


def read(path: Path, given: ColumnMap) -> Reading:
    """Read a file of any format; ``given``: the user's column map.

    Raises:
        DataError: the file cannot be read, or holds no strokes.
    """
    content = read_content(path)
    start = content[:4000].removeprefix(b"\xef\xbb\xbf").lstrip()
    if start[:1] == b"<" or start[:4] in (b"\xff\xfe<\x00", b"\xfe\xff\x00<"):
        root = tree.parse_xml(path, content)
        if root.tag == elan.ROOT:
            return elan.read(path, content, root)
        if root.find(f".//{sportscode.INSTANCE}") is not None:
            return sportscode.read(path, content, root)
        raise DataError(path, f"XML with root {root.tag[:50]!r}; expected annotations of ELAN, or instances of Sportscode")
    if start[:1] in (b"{", b"["):
        value = tree.parse_json(path, content)
        return (badminton_db if badminton_db.recognises(value) else pipeline).read(path, content, value)
    if start[:4] == b"PK\x03\x04":
        raise DataError(path, "a spreadsheet or an archive; save the sheet as CSV in UTF-8")
    if given.columns:
        sheet = StrictCsv(path, list(given.columns.values()), delimiter=given.delimiter or ",", decimal=given.decimal)
    else:
        sheet = StrictCsv(path, (), delimiter=given.delimiter or None, decimal=given.decimal)
        if shuttleset_game.recognises(sheet.header):
            return shuttleset_game.read(path, sheet)
    return Reading(format="CSV", sheet=sheet, source="own matches", strict=True)
