"""What several readers share: XML and JSON in bounded time and memory, and which span of time a stroke lies in.

XML has no document type, so no entities and nothing from elsewhere, and a bounded depth.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

import numpy as np

from shuttle_marl.base.files import parsed
from shuttle_marl.data.problems import DataError

LINE: Final = "\N{NUMBER SIGN}line"
"""Attribute of each element: its line in the file, a name that no XML attribute has."""
_DEEPEST: Final = 50
_MOST_ELEMENTS: Final = 1_000_000


def parse_xml(path: Path, content: bytes) -> ET.Element:
    """The root of an XML file.

    Raises:
        DataError: it is not well-formed, has a document type, or is too deep or too large.
    """
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
        builder.start(tag, {**attributes, LINE: str(parser.CurrentLineNumber)})

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


def text_of(element: ET.Element, tag: str) -> str:
    """Text of the first child of that name, empty without one."""
    return (element.findtext(tag) or "").strip()


def line_of(element: ET.Element) -> int:
    """Its line in the file."""
    return int(element.attrib[LINE])


def parse_json(path: Path, content: bytes) -> Any:
    """The value of a JSON file.

    Raises:
        DataError: it is no JSON, too deep, or has a key twice.
    """
    try:
        return parsed(content.decode("utf-8-sig"), finite=True)
    except ValueError as error:
        raise DataError(path, f"no readable JSON ({error})") from error


def text(value: object) -> str:
    """A scalar of JSON as text; empty for null and for what is no scalar."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.10g}" if isinstance(value, float) else str(value).strip() if isinstance(value, int | str) else ""


def spans_around(spans: Sequence[tuple[float, float]], moments: Sequence[float]) -> list[int]:
    """Number, from 1, of the last span that each moment lies in, 0 for none.

    Args:
        spans: start and end of each, in order of time.
        moments: in any order.
    """
    order, number = np.argsort(moments), np.zeros(len(moments), dtype=np.int64)
    times = np.asarray(moments)[order]
    begins, ends = np.asarray(spans, dtype=np.float64).reshape(-1, 2).T
    within = zip(np.searchsorted(times, begins), np.searchsorted(times, ends, "right"), strict=True)
    for k, (first, end) in enumerate(within, 1):
        number[order[first:end]] = k
    return number.tolist()
