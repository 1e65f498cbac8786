"""Strokes that a program recognised in a video, as JSON: objects with a type of stroke, anywhere in the file.

Such as ``[{"frame": 120, "player": "top", "stroke_type": "smash", "confidence": 0.93}, …]``, or the same within rallies. Keys
are those of columns, in any language. Scalars of the objects around, such as a rally's number or winner, count for all its
strokes; ``"players": {"top": "Ada", "bottom": "Bea"}`` names the players in the first game of the strokes below.
"""

import fractions
import math
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from shuttle_marl.data.people import UNKNOWN_END, at_ends, end_of, ends_in, ends_note
from shuttle_marl.data.problems import DataError
from shuttle_marl.data.readers.tree import text
from shuttle_marl.data.sheet import Sheet
from shuttle_marl.data.words import Words, bare

Entry = dict[str, str]
_DEEPEST: Final = 8
_RATE: Final = 30.0
_SIDE: Final = re.compile(r"(top|bottom)[_\s-]+(.+)", re.IGNORECASE)
"""Types of stroke that begin with who struck it."""
_PLAYERS: Final = re.compile("players?|names?|sides?", re.IGNORECASE)
"""Keys of objects with the names of the players."""
_RATES: Final = ("fps", "framerate", "framespersecond")
_MOST_KEYS: Final = 20
"""Keys that a message lists."""


def read(path: Path, content: bytes, value: Any) -> Sheet:
    """Read a file.

    Raises:
        DataError: it holds no strokes, a rate of frames is no number, or players who are named by ends change them unseen.
    """
    found = _Strokes()
    entries = found.below(value)
    if not entries:
        raise DataError(path, 'JSON without strokes; expected objects with a type of stroke, such as "stroke_type": "smash"')
    inferred, lost = list[str](), list[str]()
    if any("player" not in entry for entry in entries):
        for entry in entries:
            if sided := _SIDE.fullmatch(entry["shot"]):
                entry["player"], entry["shot"] = sided.groups()
    inferred += [_name(path, *named) for named in found.named]
    for entry in entries:
        rate = _rate(path, entry.pop("fps", ""))
        if "seconds" not in entry and entry.get("frame", "").isdecimal() and len(entry["frame"]) < _MOST_KEYS:
            entry["seconds"] = f"{int(entry['frame']) / (rate or _RATE):.3f}"
            if not rate:
                inferred.append(f"times from frames, at {_RATE:g} frames a second, because the file has no fps")
    if not {"ending", "winner", "score"} & set().union(*entries):
        lost.append("scores and how rallies ended")
    shifts = "times of objects around, not added to those of strokes"
    for keys, why in ((found.unread, "keys that are no columns here"), (found.shifts, shifts)):
        if keys:
            lost.append(f"{why}: {', '.join(map(repr, sorted(keys)[:_MOST_KEYS]))}")
    about: dict[str, Any] = {"format": "JSON of a video pipeline", "source": "video pipeline", "unit": "stroke"}
    about |= {"lost": lost, "inferred": [*dict.fromkeys(inferred)], "others": found.others}
    sheet = Sheet.of(path, content, entries, range(1, len(entries) + 1), **about)
    if found.twice:
        listed = ", ".join(map(repr, sorted(found.twice)[:_MOST_KEYS]))
        sheet.doubt(f"keys that mean the same as one before, with another value, are not read: {listed}")
    return sheet


def _rate(path: Path, told: str) -> float:
    """A rate such as ``25``, ``29.97``, or ``30000/1001``; 0 for an empty one."""
    try:
        rate = float(fractions.Fraction(told.removesuffix("fps").strip() or "0")) if len(told) < _MOST_KEYS else math.nan
    except (ValueError, ZeroDivisionError, OverflowError):
        rate = math.nan
    if told and not 1 <= rate <= 10_000:
        raise DataError(path, f"fps {told!r:.50}; expected frames a second, such as 30 or 30000/1001")
    return rate


def _name(path: Path, ends: Mapping[str, str], strokes: list[Entry]) -> str:
    """Replace the ends of the strokes below an object that names them; a sentence on it.

    Raises:
        DataError: the players change ends within the strokes, nobody knows when.
    """
    games = [int(entry["game"]) if entry.get("game", "").isdecimal() else 1 for entry in strokes]
    for column in ("player", "opponent", "winner"):
        at = [k for k, entry in enumerate(strokes) if end_of(entry.get(column, ""))]
        words = [strokes[k][column] for k in at]
        for k, name in zip(at, at_ends(ends, words, [games[k] for k in at], min(games)), strict=True):
            if not name:
                raise DataError(path, f"{column} {strokes[k][column]!r} of game {games[k]}: {UNKNOWN_END}")
            strokes[k][column] = name
    return ends_note(games)


class _Strokes:
    """Search for strokes; collects names of the ends, the number of entries that are none, and keys that are not read."""

    def __init__(self) -> None:
        self._words = Words("column", ())
        self.named: list[tuple[Mapping[str, str], list[Entry]]] = []
        self.others = 0
        self.twice: set[str] = set()
        self.unread: set[str] = set()
        self.shifts: set[str] = set()

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
                    self.twice.add(name)
            if "shot" in scalars:
                self.unread |= {name for name, child in node.items() if child and not (name in values and self._column(name))}
                self.shifts |= {column for column in ("seconds", "frame") if column in scalars and column in around}
                return [{**around, **scalars}]
            ending = scalars.pop("ending", "")  # of the rally, so of its last stroke
            for name, child in node.items():
                found += self.below(child, {**around, **scalars}, name, depth + 1)
            if found:
                self._name(node, found)
                self.unread |= {name for name in values if not self._column(name) and not end_of(name)}
            if found and ending:
                found[-1].setdefault("ending", ending)
        return found

    def _name(self, node: Mapping[str, Any], strokes: list[Entry]) -> None:
        """Names of the ends in an object, or in one of the players in it."""
        inside = (child for key, child in node.items() if isinstance(child, dict) and _PLAYERS.match(key))
        for names in (*inside, node):
            ends = ends_in({key: name for key, name in names.items() if isinstance(name, str) and name.strip()})
            if {"near", "far"} <= ends.keys() or {"left", "right"} <= ends.keys():
                self.named.append((ends, strokes))
