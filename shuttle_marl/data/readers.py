"""Readers of the files that users have; the format is recognised by the content.

Each gives a table of text, a :class:`~shuttle_marl.data.sheet.Sheet`, with headers and words of any language
(:mod:`shuttle_marl.data.words`), which :func:`shuttle_marl.data.own.clean` checks and converts. XML has no document type, so no
entities and nothing from elsewhere.
"""

import bisect
import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final
from xml.parsers import expat

import numpy as np

from shuttle_marl.data.schema import DataError, Problem
from shuttle_marl.data.sheet import Sheet, listed, read_content, read_csv
from shuttle_marl.data.shuttleset import SINGLE_GAME, read_single_game
from shuttle_marl.data.words import ColumnMap, Words

_READ: Final = (
    "a CSV table with a row per stroke, a game of ShuttleSet, or XML of Sportscode, Dartfish or Nacsport; export a table (CSV)"
)
_INSTANCE: Final = ".//ALL_INSTANCES/instance"
_KINDS: Final = ("shot", "ending", "technique", "height", "area")  # of words that labels without a group may be, in this order
_LINE: Final = "\N{NUMBER SIGN}line"  # attribute of each element: its line in the file, a name that no XML attribute has
_DEEPEST: Final = 50
_MOST_ELEMENTS: Final = 1_000_000
_FEW: Final = 3  # examples in a sentence

_Stroke = tuple[float, float, int, dict[str, str]]  # start, end, line and values by column


def read(path: Path, given: ColumnMap) -> Sheet:
    """Read a file of any format, with the user's column map; a DataError if it cannot be read, or holds no strokes."""
    content = read_content(path)
    start = content[:4000].removeprefix(b"\xef\xbb\xbf").lstrip()
    if start[:1] == b"<" or start[:4] in (b"\xff\xfe<\x00", b"\xfe\xff\x00<"):
        return _read_sportscode(path, content, _parsed(path, content))
    if start[:1] in (b"{", b"["):
        raise DataError(path, f"JSON is not read; expected {_READ}")
    if start[:4] == b"PK\x03\x04":
        raise DataError(path, "a spreadsheet or an archive; save the sheet as CSV in UTF-8")
    if start[:4] == b"PAR1":
        raise DataError(path, "a Parquet table; what `import` writes is read as it is, other tables are saved as CSV")
    if given.columns:
        return read_csv(path, given.columns.values(), delimiter=given.delimiter or ",", decimal=given.decimal)
    sheet = read_csv(path, delimiter=given.delimiter or None, decimal=given.decimal)
    return read_single_game(path, sheet) if set(sheet.header) >= SINGLE_GAME else sheet


def _read_sportscode(path: Path, content: bytes, root: ET.Element) -> Sheet:
    """Instances of Sportscode and of programs that write its XML (Dartfish, Nacsport): start, end, code, labels in groups.

    A stroke is an instance whose code or one of whose labels is a type of stroke; groups are columns, in any language. Labels
    without a known group count if they are words of badminton. The code is the player if it is no stroke. Instances called rally
    or game number the strokes within them, and those that are endings belong to the stroke before.
    """
    if root.find(_INSTANCE) is None:
        raise DataError(path, f"XML with root {root.tag[:50]!r} and without instances of Sportscode; expected {_READ}")
    columns = Words("column", ())
    kinds = {kind: Words(kind, (label.text or "" for label in root.iter("text"))) for kind in _KINDS}
    spans: dict[str, list[tuple[float, float]]] = {"game": [], "rally": []}
    endings: list[tuple[float, str]] = []
    strokes: list[_Stroke] = []
    twice: list[Problem] = []
    others, unread, codes = 0, set[str](), set[str]()
    for instance in root.iterfind(_INSTANCE):
        code = _text(instance, "code")
        entry: dict[str, str] = {}
        for label in instance.iterfind("label"):
            group, word = _text(label, "group"), _text(label, "text")
            column = columns.meaning(group) or next((kind for kind in _KINDS if kinds[kind].meaning(word)), "")
            if column and entry.setdefault(column, word) != word:
                text = f"{column} {word!r:.50} beside {entry[column]!r:.50}, which is used"
                twice.append(Problem(path, text, _line(instance)))
            elif not column:
                unread.add(group or word)
        if kinds["shot"].meaning(code):
            entry.setdefault("shot", code)
        elif "shot" in entry and not columns.meaning(code):
            entry.setdefault("player", code)
        start, end = (_seconds(path, instance, tag) for tag in ("start", "end"))
        if "shot" in entry:
            strokes.append((start, end, _line(instance), entry))
            continue
        others += 1
        span = columns.meaning(code.rstrip("0123456789 "))
        if span in ("game", "rally"):
            spans[span].append((start, end))
        elif kinds["ending"].meaning(code):
            endings.append((start, code))
        else:
            codes.add(code)
    strokes.sort(key=lambda stroke: stroke[:2])
    if endings:  # a word such as net is one too, where its button was pressed during a stroke
        for before, stroke in itertools.pairwise([*strokes]):
            code = stroke[3]["shot"]
            if stroke[0] < before[1] and kinds["ending"].meaning(code):
                endings.append((stroke[0], code))
                strokes.remove(stroke)
                others += 1
    beside = [*_number(strokes, spans), *_end(strokes, endings)]
    for start, _, _, entry in strokes:
        entry["seconds"] = f"{start:.3f}"
    lost = ["times of the strokes: those of the start of their instances, which may be earlier"]
    lost += listed("labels that are no columns here", sorted(unread))
    lost += listed("codes that are no strokes, endings or spans", sorted(codes))
    lost += listed(f"{len(beside)} instances without a stroke, such as", beside[:_FEW])
    entries, lines = [entry for *_, entry in strokes], [line for _, _, line, _ in strokes]
    about = {"format": "Sportscode XML", "source": "Sportscode"}
    return Sheet.of(path, content, entries, lines, lost=lost, others=others, warnings=twice, **about)


def _number(strokes: Sequence[_Stroke], spans: Mapping[str, Sequence[tuple[float, float]]]) -> list[str]:
    """Number strokes by the last span around their middles; names of spans without a stroke."""
    middles = np.array([(start + end) / 2 for start, end, *_ in strokes])
    order, beside = np.argsort(middles), list[str]()
    for name, unordered in spans.items():
        number, within = np.zeros(len(strokes), dtype=np.int64), np.array(sorted(unordered)).reshape(-1, 2)
        first, end = np.searchsorted(middles[order], within[:, 0]), np.searchsorted(middles[order], within[:, 1], "right")
        for k, inside in enumerate(map(slice, first.tolist(), end.tolist()), 1):
            number[order[inside]] = k
        for (*_, entry), k in zip(strokes, number.tolist(), strict=True):
            if k:
                entry.setdefault(name, str(k))
        beside += [name] * (len(within) - len(set(number.tolist()) - {0}))
    return beside


def _end(strokes: Sequence[_Stroke], endings: Sequence[tuple[float, str]]) -> list[str]:
    """Give endings to the strokes that begin before them; those without such a stroke."""
    begins = [start for start, *_ in strokes]
    before = [(bisect.bisect_right(begins, start), code) for start, code in sorted(endings)]
    for number, code in before:
        if number:
            strokes[number - 1][3].setdefault("ending", code)
    return [f"ending {code}" for number, code in before if not number]


def _seconds(path: Path, instance: ET.Element, tag: str) -> float:
    try:
        if math.isfinite(seconds := float(_text(instance, tag))):
            return seconds
    except ValueError:
        pass
    raise DataError(path, f"{tag} {_text(instance, tag)[:50]!r}; expected seconds", line=_line(instance))


def _text(element: ET.Element, tag: str) -> str:
    return (element.findtext(tag) or "").strip()


def _line(element: ET.Element) -> int:
    return int(element.attrib[_LINE])


def _parsed(path: Path, content: bytes) -> ET.Element:
    builder, parser = ET.TreeBuilder(), expat.ParserCreate()
    depth = elements = 0

    def refuse(*_: object) -> None:
        told = "the XML has a document type declaration, which is not read; delete it"
        raise DataError(path, told, line=parser.CurrentLineNumber)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if depth > _DEEPEST or elements > _MOST_ELEMENTS:
            raise DataError(path, "the XML is too deep or too large", line=parser.CurrentLineNumber)
        builder.start(tag, {**attributes, _LINE: str(parser.CurrentLineNumber)})

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, builder.data
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise DataError(path, f"no readable XML ({error})") from error
    return builder.close()
