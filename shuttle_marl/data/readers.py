"""Readers of the files of other programs; the format is recognised by the content.

Each gives a table of text, a :class:`~shuttle_marl.data.sheet.Sheet`, with headers and words of any language
(:mod:`shuttle_marl.data.words`), which :func:`shuttle_marl.data.own.clean` checks and converts.
"""

import fractions
import itertools
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from shuttle_marl.data import sheet
from shuttle_marl.data.elan import is_badminton_db, read_badminton_db, read_elan
from shuttle_marl.data.inference import UNKNOWN_END, at_ends, end_of, ends_in, ends_note
from shuttle_marl.data.schema import DataError, Problem
from shuttle_marl.data.sheet import Sheet, in_video, line_of, listed, parse_json, parse_xml, read_csv, scalar, text_of
from shuttle_marl.data.shuttleset import SINGLE_GAME, read_single_game
from shuttle_marl.data.words import ColumnMap, Words, bare

_INSTANCE: Final = ".//ALL_INSTANCES/instance"
_KINDS: Final = ("shot", "ending", "technique", "height", "area")
"""Kinds of words that labels without a group may be, the first ones first."""
_Entry = dict[str, str]
_DEEPEST: Final = 8
_RATE: Final = 30.0
_SIDE: Final = re.compile(r"(top|bottom)[_\s-]+(.+)", re.IGNORECASE)  # types of stroke that begin with who struck it
_PLAYERS: Final = re.compile("players?|names?|sides?", re.IGNORECASE)  # keys of objects with the names of the players
_RATES: Final = ("fps", "framerate", "framespersecond")
_LONGEST: Final = 20


def read(path: Path, given: ColumnMap) -> Sheet:
    """Read a file of any format, with the user's column map; a DataError if it cannot be read, or holds no strokes."""
    content = sheet.read_content(path)
    value = _parsed(path, content, given)
    if isinstance(value, Sheet):
        return value if given.columns or not set(value.header) >= SINGLE_GAME else read_single_game(path, value)
    if not isinstance(value, ET.Element):
        return (
            read_badminton_db(path, content, value) if is_badminton_db(value) else _read_json(path, content, value, given.rules)
        )
    if value.tag == "ANNOTATION_DOCUMENT":
        return read_elan(path, content, value)
    if value.find(_INSTANCE) is None:
        raise DataError(path, f"XML with root {value.tag[:50]!r}; expected annotations of ELAN, or instances of Sportscode")
    return _read_sportscode(path, content, value)


def _parsed(path: Path, content: bytes, given: ColumnMap) -> Any:
    start = content[:4000].removeprefix(b"\xef\xbb\xbf").lstrip()
    if start[:1] == b"<" or start[:4] in (b"\xff\xfe<\x00", b"\xfe\xff\x00<"):
        return parse_xml(path, content)
    if start[:1] in (b"{", b"["):
        return parse_json(path, content)
    if start[:4] == b"PK\x03\x04":
        raise DataError(path, "a spreadsheet or an archive; save the sheet as CSV in UTF-8")
    if given.columns:
        return read_csv(path, given.columns.values(), delimiter=given.delimiter or ",", decimal=given.decimal)
    return read_csv(path, delimiter=given.delimiter or None, decimal=given.decimal)


def _read_json(path: Path, content: bytes, value: Any, rules: str) -> Sheet:
    """Strokes that a program recognised in a video, as JSON: objects with a type of stroke, anywhere in the file.

    Such as ``[{"frame": 120, "player": "top", "stroke_type": "smash", "confidence": 0.93}, …]``, or the same within rallies. Keys
    are those of columns, in any language. Scalars of the objects around, such as a rally's number or winner, count for all its
    strokes; ``"players": {"top": "Ada", "bottom": "Bea"}`` names the players in the first game of the strokes below.
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
    inferred += [_name(path, *named, rules) for named in found.named]
    for entry in entries:
        rate = _rate(path, entry.pop("fps", ""))
        if "seconds" not in entry and entry.get("frame", "").isdecimal() and len(entry["frame"]) < _LONGEST:
            entry["seconds"] = f"{int(entry['frame']) / (rate or _RATE):.3f}"
            if not rate:
                inferred.append(f"times from frames, at {_RATE:g} frames a second, because the file has no fps")
    if not {"ending", "winner", "score"} & set().union(*entries):
        lost.append("scores and how rallies ended")
    lost += listed("keys that are no columns here", sorted(found.unread))
    lost += listed("times of objects around, not added to those of strokes", sorted(found.shifts))
    about: dict[str, Any] = {"format": "JSON of a video pipeline", "source": "video pipeline", "unit": "stroke"}
    about |= {"lost": lost, "inferred": [*dict.fromkeys(inferred)], "others": found.others}
    strokes = Sheet.of(path, content, entries, range(1, len(entries) + 1), **about)
    for told in listed("keys that mean the same as one before, with another value, are not read", sorted(found.twice)):
        strokes.doubt(told)
    return strokes


def _rate(path: Path, told: str) -> float:
    """A rate such as ``25``, ``29.97``, or ``30000/1001``; 0 for an empty one."""
    try:
        rate = float(fractions.Fraction(told.removesuffix("fps").strip() or "0")) if len(told) < _LONGEST else math.nan
    except (ValueError, ZeroDivisionError, OverflowError):
        rate = math.nan
    if told and not 1 <= rate <= 10_000:
        raise DataError(path, f"fps {told!r:.50}; expected frames a second, such as 30 or 30000/1001")
    return rate


def _name(path: Path, ends: Mapping[str, str], strokes: list[_Entry], rules: str) -> str:
    """Replace the ends of the strokes below an object that names them; a sentence on it."""
    games = [int(entry["game"]) if entry.get("game", "").isdecimal() else 1 for entry in strokes]
    for column in ("player", "opponent", "winner"):
        at = [k for k, entry in enumerate(strokes) if end_of(entry.get(column, ""))]
        words = [strokes[k][column] for k in at]
        for k, name in zip(at, at_ends(ends, words, [games[k] for k in at], min(games), rules), strict=True):
            if not name:
                raise DataError(path, f"{column} {strokes[k][column]!r} of game {games[k]}: {UNKNOWN_END}")
            strokes[k][column] = name
    return ends_note(games)


class _Strokes:
    """Search for strokes; collects names of the ends, the number of entries that are none, and keys that are not read."""

    def __init__(self) -> None:
        self._words = Words("column", ())
        self.named: list[tuple[Mapping[str, str], list[_Entry]]] = []
        self.others = 0
        self.twice: set[str] = set()
        self.unread: set[str] = set()
        self.shifts: set[str] = set()

    def _column(self, key: str) -> str:
        """The column of a key; the rate of the frames; empty for others."""
        return "fps" if bare(key) in _RATES else self._words.meaning(key) or ""

    def _score(self, key: str, value: Any) -> str:
        """A score such as ``[5, 3]``; empty for others."""
        pair = isinstance(value, list) and len(value) == 2 and all(isinstance(each, int) for each in value)
        return "-".join(map(str, value)) if pair and self._column(key) == "score" else ""

    def below(self, node: Any, around: Mapping[str, str] = MappingProxyType({}), key: str = "", depth: int = 0) -> list[_Entry]:
        """Strokes below a node, with the scalars around."""
        found: list[_Entry] = []
        if depth > _DEEPEST:
            return found
        if isinstance(node, list):
            column, none = self._column(key) or self._column(key.removesuffix("s")), 0
            for number, child in enumerate(node, 1):
                numbered = {column: str(number)} if column in ("game", "rally") else {}
                inside = self.below(child, {**around, **numbered}, "", depth + 1)
                found += inside
                none += not inside
            self.others += none if found else 0
        elif isinstance(node, dict):
            values = {name: told for name, child in node.items() if (told := scalar(child) or self._score(name, child))}
            scalars: _Entry = {}
            for name, told in values.items():
                if (column := self._column(name)) and scalars.setdefault(column, told) != told:
                    self.twice.add(name)
            if "shot" in scalars:
                self.unread |= {name for name, child in node.items() if child and not (name in values and self._column(name))}
                self.shifts |= {column for column in ("seconds", "frame") if column in scalars and column in around}
                return [{**around, **scalars}]
            ending, others = scalars.pop("ending", ""), set[str]()  # of the rally, so of its last stroke
            rates = set[str]()
            for name, child in node.items():
                inside = self.below(child, {**around, **scalars}, name, depth + 1)
                found += inside
                of_video = set[str]() if inside else self._rates(child)
                rates |= of_video
                nested = isinstance(child, dict | list) and not (name in values or of_video or _PLAYERS.match(name))
                others |= {name} if child and nested and not inside else set()
            if found:
                self._name(node, found)
                self.unread |= others | {name for name in values if not self._column(name) and not end_of(name)}
            if found and ending:
                found[-1].setdefault("ending", ending)
            for entry in found if len(rates) == 1 else ():
                entry.setdefault("fps", *rates)
            self.twice |= {"fps"} if found and len(rates) > 1 else set()
        return found

    def _rates(self, node: Any, depth: int = 0) -> set[str]:
        """Rates of frames in an object without strokes, such as one on the video."""
        if not isinstance(node, dict) or depth > _DEEPEST:
            return set()
        own = {scalar(child) for key, child in node.items() if self._column(key) == "fps"} - {""}
        return own.union(*(self._rates(child, depth + 1) for child in node.values()))

    def _name(self, node: Mapping[str, Any], strokes: list[_Entry]) -> None:
        """Names of the ends in an object, or in one of the players in it."""
        inside = (child for key, child in node.items() if isinstance(child, dict) and _PLAYERS.match(key))
        for names in (*inside, node):
            ends = ends_in({key: name for key, name in names.items() if isinstance(name, str) and name.strip()})
            if {"near", "far"} <= ends.keys() or {"left", "right"} <= ends.keys():
                self.named.append((ends, strokes))


def _read_sportscode(path: Path, content: bytes, value: ET.Element) -> Sheet:
    """Instances of Sportscode and of programs that write its XML (Dartfish, Nacsport): start, end, code, labels in groups.

    A stroke is an instance whose code or one of whose labels is a type of stroke; groups are columns, in any language. Labels
    without a known group count if they are words of badminton. The code is the player if it is no stroke. Instances called rally
    or game number the strokes within them, and those that are endings belong to the stroke before.
    """
    columns = Words("column", ())
    kinds = {kind: Words(kind, (label.text or "" for label in value.iter("text"))) for kind in _KINDS}
    spans: dict[str, list[tuple[float, float, str]]] = {"game": [], "rally": [], "ending": []}
    strokes: list[tuple[float, float, int, dict[str, str]]] = []
    twice: list[Problem] = []
    others, unread, codes = 0, set[str](), set[str]()
    for instance in value.iterfind(_INSTANCE):
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
        if span in ("game", "rally"):
            spans[span].append((start, end, ""))
        elif kinds["ending"].meaning(code):
            spans["ending"].append((start, start, code))
        else:
            codes.add(code)
    strokes.sort(key=lambda stroke: stroke[:2])
    if spans["ending"]:  # a word such as net is one too, where its button was pressed during a stroke
        for before, stroke in itertools.pairwise([*strokes]):
            code = stroke[3]["shot"]
            if stroke[0] < before[1] and kinds["ending"].meaning(code):
                spans["ending"].append((stroke[0], stroke[0], code))
                strokes.remove(stroke)
                others += 1
    lost = ["times of the strokes: those of the start of their instances, which may be earlier"]
    lost += listed("labels that are no columns here", sorted(unread))
    lost += listed("codes that are no strokes, endings or spans", sorted(codes))
    about: dict[str, Any] = {"format": "Sportscode XML", "source": "Sportscode", "lost": lost, "others": others}
    return in_video(path, content, strokes, spans, warnings=twice, **about)


def _seconds(path: Path, instance: ET.Element, tag: str) -> float:
    try:
        if math.isfinite(seconds := float(text_of(instance, tag))):
            return seconds
    except ValueError:
        pass
    raise DataError(path, f"{tag} {text_of(instance, tag)[:50]!r}; expected seconds", line=line_of(instance))
