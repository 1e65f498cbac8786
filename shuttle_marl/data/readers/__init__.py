"""Readers of the files of other programs, one module a format; the format is recognised by the content.

Each gives a table of text, a :class:`~shuttle_marl.data.sheet.Sheet`, with headers and words of any language
(:mod:`shuttle_marl.data.words`), which :func:`shuttle_marl.data.own.clean` checks and converts.
"""

from pathlib import Path

from shuttle_marl.data.column_map import ColumnMap
from shuttle_marl.data.problems import DataError
from shuttle_marl.data.readers import badminton_db, elan, pipeline, shuttleset_game, sportscode, tree
from shuttle_marl.data.sheet import Sheet, read_content, read_csv


def read(path: Path, given: ColumnMap) -> Sheet:
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
        return read_csv(path, given.columns.values(), delimiter=given.delimiter or ",", decimal=given.decimal)
    sheet = read_csv(path, delimiter=given.delimiter or None, decimal=given.decimal)
    return shuttleset_game.read(path, sheet) if shuttleset_game.recognises(sheet.header) else sheet
