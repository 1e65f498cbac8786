"""Strokes that a program recognised in a video, as JSON: objects with a type of stroke, anywhere in the file.

Such as ``[{"frame": 120, "player": "top", "stroke_type": "smash", "confidence": 0.93}, …]``, or the same within rallies. Keys
are those of columns, in any language. Scalars of the objects around, such as a rally's number or winner, count for all its
strokes; ``"players": {"top": "Ada", "bottom": "Bea"}`` names the players.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from shuttle_marl.data.readers.reading import Reading, sheet_of
from shuttle_marl.data.readers.tree import text
from shuttle_marl.data.strict_csv import DataError, Problem
from shuttle_marl.data.words import Words, bare

Entry = dict[str, str]
_DEEPEST: Final = 8
_RATE: Final = 30.0
_SIDE: Final = re.compile(r"(top|bottom)[_\s-]+(.+)", re.IGNORECASE)
"""Types of stroke that begin with who struck it."""
_RATES: Final = ("fps", "framerate", "framespersecond")


def read(path: Path, content: bytes, value: Any) -> Reading:
    """Read a file.

    Raises:
        DataError: it holds no strokes.
    """
    found = _Strokes()
    entries, names = found.below(value), found.names
    if not entries:
        raise DataError(path, 'JSON without strokes; expected objects with a type of stroke, such as "stroke_type": "smash"')
    inferred, lost = list[str](), list[str]()
    if any("player" not in entry for entry in entries):
        for entry in entries:
            if sided := _SIDE.fullmatch(entry["shot"]):
                entry["player"], entry["shot"] = sided.groups()
    for entry in entries:
        entry["player"] = names.get(bare(entry.get("player", "")), entry.get("player", ""))
        rate = float(entry.pop("fps", "") or 0)
        if "seconds" not in entry and entry.get("frame", "").isdigit():
            entry["seconds"] = f"{int(entry['frame']) / (rate or _RATE):.3f}"
            if not rate and not inferred:
                inferred.append(f"times from frames, at {_RATE:g} frames a second, because the file has no fps")
    if {bare(entry["player"]) for entry in entries} <= {"top", "bottom", "near", "far"}:
        lost.append("names of the players: top and bottom are the halves of the picture, which they change between games")
    if not {"ending", "winner", "score"} & set().union(*entries):
        lost.append("scores and how rallies ended")
    sheet = sheet_of(path, content, entries, range(1, len(entries) + 1), "stroke")
    sheet.others = found.others
    if found.unread:
        listed = ", ".join(map(repr, sorted(found.unread)[:10]))
        sheet.warnings.append(Problem(path, f"keys that mean the same as one before, with another value, are not read: {listed}"))
    return Reading(
        format="JSON of a video pipeline",
        sheet=sheet,
        source="video pipeline",
        lost=tuple(lost),
        inferred=tuple(inferred),
    )


class _Strokes:
    """Search for strokes; collects names of the sides, the number of entries that are none, and unread keys."""

    def __init__(self) -> None:
        self._words = Words("column", ())
        self.names: dict[str, str] = {}
        self.others = 0
        self.unread: set[str] = set()

    def _column(self, key: str) -> str:
        """The column of a key; the rate of the frames; empty for others."""
        return "fps" if bare(key) in _RATES else self._words.meaning(key) or ""

    def below(self, node: Any, around: Mapping[str, str] = MappingProxyType({}), key: str = "", depth: int = 0) -> list[Entry]:
        """Strokes below a node, with the scalars around."""
        found: list[Entry] = []
        if depth > _DEEPEST:
            return found
        if isinstance(node, list):
            column, none = self._column(key), 0
            for number, child in enumerate(node, 1):
                numbered = {column: str(number)} if column in ("game", "rally") else {}
                inside = self.below(child, {**around, **numbered}, "", depth + 1)
                found += inside
                none += not inside
            self.others += none if found else 0
        elif isinstance(node, dict):
            values = {name: told for name, child in node.items() if (told := text(child))}
            scalars: Entry = {}
            for name, told in values.items():
                if (column := self._column(name)) and scalars.setdefault(column, told) != told:
                    self.unread.add(name)
            if "shot" in scalars:
                return [{**around, **scalars}]
            ending = scalars.pop("ending", "")  # of the rally, so of its last stroke
            sides = {bare(name): told for name, told in values.items()}
            if {"top", "bottom"} <= sides.keys() or {"near", "far"} <= sides.keys():
                self.names |= sides
            for name, child in node.items():
                found += self.below(child, {**around, **scalars}, name, depth + 1)
            if found and ending:
                found[-1].setdefault("ending", ending)
        return found
