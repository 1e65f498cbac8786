"""Instances of Sportscode and of programs that write its XML (Dartfish, Nacsport): start, end, code, labels in groups.

A stroke is an instance whose code or one of whose labels is a type of stroke; groups are columns, in any language. Labels
without a known group count if they are words of badminton. The code is the player if it is no stroke. Instances called rally or
game number the strokes within them.
"""

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, Final

from shuttle_marl.data.problems import DataError, Problem
from shuttle_marl.data.readers.tree import line_of, spans_around, text_of
from shuttle_marl.data.sheet import Sheet
from shuttle_marl.data.words import Words

INSTANCE: Final = "ALL_INSTANCES/instance"
_KINDS: Final = ("shot", "ending", "technique", "height", "area")
"""Kinds of words that labels without a group may be, the first ones first."""


def read(path: Path, content: bytes, root: ET.Element) -> Sheet:
    """Read a file.

    Raises:
        DataError: it holds no strokes.
    """
    columns = Words("column", ())
    kinds = {kind: Words(kind, (label.text or "" for label in root.iter("text"))) for kind in _KINDS}
    spans: dict[str, list[tuple[float, float]]] = {"game": [], "rally": []}
    strokes: list[tuple[float, float, int, dict[str, str]]] = []
    twice: list[Problem] = []
    others, unread = 0, set[str]()
    for instance in root.iterfind(f".//{INSTANCE}"):
        code = text_of(instance, "code")
        entry: dict[str, str] = {}
        for label in instance.iterfind("label"):
            group, word = text_of(label, "group"), text_of(label, "text")
            column = columns.meaning(group) or next((kind for kind in _KINDS if kinds[kind].meaning(word)), "")
            if column and entry.setdefault(column, word) != word:
                text = f"{column} {word!r:.50} beside {entry[column]!r:.50}, which is used"
                twice.append(Problem(path, text, line_of(instance)))
            elif not column:
                unread.add(group or word)
        if kinds["shot"].meaning(code):
            entry.setdefault("shot", code)
        elif "shot" in entry and not columns.meaning(code):
            entry.setdefault("player", code)
        start, end = (_seconds(path, instance, tag) for tag in ("start", "end"))
        if "shot" in entry:
            strokes.append((start, end, line_of(instance), entry))
            continue
        others += 1
        span = columns.meaning(code.rstrip("0123456789 "))
        if span in spans:
            spans[span].append((start, end))
    strokes.sort(key=lambda stroke: stroke[:2])
    middles = [(start + end) / 2 for start, end, *_ in strokes]
    numbers = {name: spans_around(sorted(within), middles) for name, within in spans.items()}
    entries = []
    for i, (start, _, _, entry) in enumerate(strokes):
        entry["seconds"] = f"{start:.3f}"
        for name, number in numbers.items():
            if number[i]:
                entry.setdefault(name, str(number[i]))
        entries.append(entry)
    lost = ["times of the strokes: those of the start of their instances, which may be earlier"]
    if unread:
        lost.append(f"labels that are no columns here: {', '.join(map(repr, sorted(unread)[:20]))}")
    about: dict[str, Any] = {"format": "Sportscode XML", "source": "Sportscode", "lost": lost, "others": others}
    return Sheet.of(path, content, entries, [line for _, _, line, _ in strokes], warnings=twice, **about)


def _seconds(path: Path, instance: ET.Element, tag: str) -> float:
    try:
        if math.isfinite(seconds := float(text_of(instance, tag))):
            return seconds
    except ValueError:
        pass
    raise DataError(path, f"{tag} {text_of(instance, tag)[:50]!r}; expected seconds", line=line_of(instance))
