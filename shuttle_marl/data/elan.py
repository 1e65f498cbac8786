"""Annotations of ELAN (``.eaf``): tiers with values at times.

The tiers of BadmintonDB: ``Points`` (the score before each point), ``Strokes``, and ``Serve-Receive``, who serves first. In other
files a tier is a column, in any language: one of strokes, and further ones, of which the annotations at the same time belong to
a stroke.
"""

import dataclasses
import itertools
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.data.schema import DataError, Problem
from shuttle_marl.data.sheet import Sheet, in_video, line_of, listed, scalar, text_of
from shuttle_marl.data.words import WINNERS, Words, bare

_SEATS: Final = ("T1P1", "T2P1")
_ENDINGS: Final = {
    "end_out": "out", "end_fault": "error", "end_miss": "landed", "end_lucky": "landed", "end_misjudge": "misjudged",
}  # fmt: skip
_NAMED: Final = "players and discipline from the name of the file"
_UNNAMED: Final = "names of the players: the file is not named as the published ones"
_FILE: Final = re.compile(r".*?-(MS|WS)-(.+?) \([A-Z]{3}\)-(.+?) \([A-Z]{3}\)-.*")
"""Names of published files: discipline and players."""
_STATUS: Final = ("receiver", "server")
_BACKHAND: Final = re.compile(r"(.+?)[ -]*\(?Bh\)?", re.IGNORECASE)
_LOST: Final = (
    "areas, positions and contact heights",
    "types of strokes that were faults of their own (FAULT): these rows are dropped",
    "whether a serve is short, unless it is a flick serve, and whether a fault fell short or into the net",
    "strokes around the head: they are forehands",
)


@dataclasses.dataclass(kw_only=True)
class _Point:
    """A point of a match: the score before it, its game, what ended it, and its strokes.

    Of a stroke, seat and time [s], None where they are not known, type, and place in the file.
    """

    before: tuple[int, int]
    game: int
    strokes: list[tuple[int | None, float | None, str, int]] = dataclasses.field(default_factory=list)
    cause: str = ""


def is_badminton_db(value: Any) -> bool:
    """Whether a JSON value has the form of BadmintonDB."""
    points = list(value.values()) if isinstance(value, dict) else value
    return isinstance(points, list) and bool(points) and isinstance(points[0], dict) and "PointInfo" in points[0]


def read_badminton_db(path: Path, content: bytes, value: Any) -> Sheet:
    """Read the JSON of BadmintonDB: points with their strokes, times, and the cause of the end."""
    points, place, told = [], 0, list[Problem]()

    def doubt(text: str) -> None:
        told.append(Problem(path, text, place, "stroke"))

    for name, point in value.items() if isinstance(value, dict) else enumerate(value, 1):
        try:
            about = point["PointInfo"]
            seats = [about[seat] for seat in _SEATS]
            found = _Point(
                before=(int(seats[0]["Point"]), int(seats[1]["Point"])),
                game=1 + int(seats[0]["Score"]) + int(seats[1]["Score"]),
                cause=scalar((about.get("WonEnd") or {}).get("Cause")),
            )
            for number, stroke in enumerate(about.get("Rally") or (), 1):
                place += 1
                player = stroke.get("Player")
                seat = _SEATS.index(player) if player in _SEATS else None
                begin = stroke["StrokeBegin"]  # null where the picture missed it
                seconds = None if begin is None else float(begin)
                found.strokes.append((seat, seconds, scalar(stroke.get("StrokeType")), place))
                if player and seat is None:
                    doubt(f"player {player!r:.50}; expected {' or '.join(_SEATS)}")
                if stroke.get("StrokeNum", number) != number:
                    doubt(f"StrokeNum {stroke['StrokeNum']!r:.50} of stroke {number} of its point")
                for at in (0, 1) if number == 1 and seat is not None else ():
                    if seats[at].get("Status", _STATUS[at == seat]) != _STATUS[at == seat]:
                        doubt(f"{player} serves, and {_SEATS[at]} is a {seats[at]['Status']!r:.50}")
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            why = f"{error} is missing" if isinstance(error, KeyError) else "a value is of another kind"
            form = f"PointInfo with Point and Score of {' and '.join(_SEATS)}, and a Rally of strokes with StrokeBegin"
            raise DataError(path, f"{name}: no point of BadmintonDB, {why}; expected {form}") from error
        points.append(found)
    return _sheet_of(path, content, points, told, format="BadmintonDB JSON", unit="stroke")


def _sheet_of(path: Path, content: bytes, points: list[_Point], warnings: list[Problem], **about: Any) -> Sheet:
    told = _FILE.fullmatch(path.stem)
    discipline, *people = told.groups() if told else ("", *_SEATS)
    entries, places = list[dict[str, str]](), list[int]()
    number = game = 0
    for point, following in zip(points, [*points[1:], None], strict=True):
        number = number + 1 if point.game == game else 1
        game = point.game
        after = _after_cause(point)
        if following is not None and following.game == game:  # a point between them may be missing
            after = following.before if sum(following.before) == sum(point.before) + 1 else None
        won = None if after is None else int(after[1] > point.before[1])
        for i, (seat, seconds, kind, place) in enumerate(point.strokes):
            backhand = _BACKHAND.fullmatch(kind)
            shot = backhand[1] if backhand else kind
            own = i % 2 if seat is None else seat
            known = seat is not None and shot.strip("*").upper() not in ("", "FAULT", "ERROR-TIER")
            entry = {"shot": shot if known else "unknown", "technique": "backhand" if backhand else "forehand"}
            entry |= {"game": str(game), "rally": str(number), "stroke": str(i + 1)}
            striker = "unknown" if seat is None and i == 0 else people[own]  # whose rally it was tells who won the one before
            entry |= {"player": striker, "opponent": people[1 - own]} | ({"discipline": discipline} if told else {})
            entry["seconds"] = "" if seconds is None else f"{seconds:.3f}"
            if after is not None:
                entry |= {"points": str(after[own]), "points_opponent": str(after[1 - own])}
            if i == len(point.strokes) - 1:
                # Who won follows from the score; a cause that contradicts it is another one.
                ending = _ENDINGS.get(point.cause.lower(), "unknown")
                if won is not None and (ending in WINNERS) != (won == seat):
                    ending = "unknown"
                if point.cause and ending == "unknown":
                    text = f"cause {point.cause!r:.50} is unknown, or contradicts who won by the score"
                    warnings.append(Problem(path, text, place, about.get("unit", "line")))
                entry |= {"ending": ending, "winner": "" if won is None else people[won]}
            entries.append(entry)
            places.append(place)
    kind, sentence = ("inferred", _NAMED) if told else ("lost", _UNNAMED)
    about["lost"] = [*_LOST, *about.get("lost", ())]
    about[kind] = [*about.get(kind, ()), sentence]
    return Sheet.of(path, content, entries, places, source="BadmintonDB", warnings=warnings, **about)


def _after_cause(point: _Point) -> tuple[int, int] | None:
    """The score after a point by its cause; None without one."""
    ending = _ENDINGS.get(point.cause.lower())
    if ending is None or not point.strokes or point.strokes[-1][0] is None:
        return None
    won = point.strokes[-1][0] if ending in WINNERS else 1 - point.strokes[-1][0]
    return point.before[0] + (won == 0), point.before[1] + (won == 1)


_OF_BADMINTON_DB: Final = {"points": "score", "servereceive": "service", "servicereceive": "service"}
_OF_ANOTHER: Final = "REF_ANNOTATION"
_DEEPEST: Final = 20
_SCORE: Final = re.compile(r"(\d{1,2})\s*[:-]\s*(\d{1,2})")
_SERVER: Final = re.compile(r"T([12])P1S")


class _Annotation(NamedTuple):
    """An annotation, with times in the video [s], and identifiers of it and of the annotation that it belongs to."""

    start: float
    end: float
    value: str
    line: int
    name: str = ""
    parent: str = ""


_Tier = list[_Annotation]


def read_elan(path: Path, content: bytes, value: ET.Element) -> Sheet:
    """Read an annotation document of ELAN."""
    inferred = list[str]()
    tiers = _tiers(path, value, inferred)
    words = Words("column", tiers)
    named: dict[str, str] = {}
    for name, annotations in tiers.items():
        if annotations and (meaning := _OF_BADMINTON_DB.get(bare(name), words.meaning(name))):
            named.setdefault(meaning, name)
    columns = {meaning: tiers[name] for meaning, name in named.items()}
    strokes = columns.get("shot") or columns.get("stroke", [])
    if not strokes or not {"player", "score"} & columns.keys():
        expected = "Strokes, and Points or Player"
        raise DataError(path, f"tiers {', '.join(map(repr, tiers)) or 'none'}; expected {expected}, with annotations")
    of_badminton_db = "player" not in columns
    used = {named[name] for name in (("shot", "stroke", "score", "service") if of_badminton_db else named) if name in named}
    unread = [name for name, annotations in tiers.items() if annotations and name not in used]
    lost = listed("tiers that are no columns here, or another one of the same meaning", unread)
    if of_badminton_db:
        points = _points(path, columns["score"], strokes, columns.get("service", []))
        lost += [] if columns.get("service") else ["who served first: the first player of the file"]
        return _sheet_of(path, content, points, [], lost=lost, inferred=inferred, format="BadmintonDB ELAN")
    entries: list[dict[str, str]] = [{"shot": stroke.value} for stroke in strokes]
    of_stroke = {stroke.name: entry for stroke, entry in zip(strokes, entries, strict=True) if stroke.name}
    spans: dict[str, list[tuple[float, float, str]]] = {name: [] for name, tier in columns.items() if tier is not strokes}
    for name, within in spans.items():
        for each in columns[name]:
            if each.parent in of_stroke:
                of_stroke[each.parent][name] = each.value
            else:
                within.append(each[:3])
    placed = [(stroke.start, stroke.end, stroke.line, entry) for stroke, entry in zip(strokes, entries, strict=True)]
    return in_video(path, content, placed, spans, format="ELAN", source="ELAN", lost=lost, inferred=inferred)


def _tiers(path: Path, root: ET.Element, inferred: list[str]) -> dict[str, _Tier]:
    """Annotations of each tier: at times, or of other annotations."""
    try:
        units = {header.get("TIME_UNITS", "milliseconds") for header in root.iter("HEADER")}
        if units - {"milliseconds"}:
            raise ValueError(f"times in {', '.join(units):.50}; expected milliseconds")
        offsets = [int(each.get("TIME_ORIGIN") or 0) / 1000 for each in root.iter("MEDIA_DESCRIPTOR")] or [0.0]
        if any(offsets):
            several = "" if len(set(offsets)) == 1 else f", the first of {len(offsets)} files with other offsets"
            inferred.append(f"times in the video: {offsets[0]:g} s later than in ELAN (TIME_ORIGIN){several}")
        slots = {
            each.attrib["TIME_SLOT_ID"]: float(each.get("TIME_VALUE", "nan")) / 1000 + offsets[0]
            for each in root.iter("TIME_SLOT")
        }
        found: dict[str, _Annotation] = {}
        tiers = {tier.attrib["TIER_ID"]: _aligned(tier, slots, found, inferred) for tier in root.iter("TIER")}
        pending = [tier for tier in root.iter("TIER") if tier.find(f".//{_OF_ANOTHER}") is not None]
        for _ in range(_DEEPEST):
            ready = [tier for tier in pending if all(each.attrib["ANNOTATION_REF"] in found for each in tier.iter(_OF_ANOTHER))]
            for tier in ready:
                tiers[tier.attrib["TIER_ID"]] += _dependent(tier, found, inferred)
            pending = [tier for tier in pending if tier not in ready]
        if pending:
            raise ValueError(f"tier {pending[0].attrib['TIER_ID']!r:.50} refers to annotations that are not there")
        return {name: sorted(annotations) for name, annotations in tiers.items()}
    except (KeyError, ValueError) as error:
        raise DataError(path, f"a tier or a time of ELAN is incomplete ({type(error).__name__}: {error})") from error


def _annotation(element: ET.Element, start: float, end: float, found: dict[str, _Annotation]) -> _Annotation:
    value, name = text_of(element, "ANNOTATION_VALUE"), element.get("ANNOTATION_ID", "")
    found[name] = _Annotation(start, end, value, line_of(element), name, element.get("ANNOTATION_REF", ""))
    return found[name]


def _aligned(tier: ET.Element, slots: dict[str, float], found: dict[str, _Annotation], inferred: list[str]) -> _Tier:
    """Annotations at times; what has none lies evenly between those around it."""
    elements = list(tier.iter("ALIGNABLE_ANNOTATION"))
    refs = [each.attrib[f"TIME_SLOT_REF{end}"] for each in elements for end in (1, 2)]
    times, place = np.array([slots[ref] for ref in refs]), np.cumsum([a != b for a, b in itertools.pairwise(["", *refs])])
    if missing := int(np.isnan(times).sum()):
        known = ~np.isnan(times)
        if not (known[0] and known[-1] and (np.diff(times[known]) >= 0).all()):
            raise ValueError(f"tier {tier.attrib['TIER_ID']!r:.50} has a time slot without a time")
        times = np.where(known, times, np.interp(place, place[known], times[known]))
        inferred.append(f"times of {tier.attrib['TIER_ID']!r}: {missing:,} of {len(times):,} lie evenly between others")
    return [
        _annotation(each, start, end, found) for each, (start, end) in zip(elements, times.reshape(-1, 2).tolist(), strict=True)
    ]


def _dependent(tier: ET.Element, found: dict[str, _Annotation], inferred: list[str]) -> _Tier:
    """Annotations of other annotations; several of one divide its time evenly."""
    of_parent: dict[str, list[ET.Element]] = {}
    for each in tier.iter(_OF_ANOTHER):
        before = of_parent.setdefault(each.attrib["ANNOTATION_REF"], [])
        if each.get("PREVIOUS_ANNOTATION", "") not in ("", before[-1].get("ANNOTATION_ID") if before else ""):
            raise ValueError(f"tier {tier.attrib['TIER_ID']!r:.50} has annotations in another order than they follow each other")
        before.append(each)
    if several := sum(len(elements) for elements in of_parent.values() if len(elements) > 1):
        inferred.append(f"times of {tier.attrib['TIER_ID']!r}: {several:,} annotations divide that of another one evenly")
    annotations = []
    for parent, elements in of_parent.items():
        start, width = found[parent].start, (found[parent].end - found[parent].start) / len(elements)
        for k, each in enumerate(elements):
            annotations.append(_annotation(each, start + k * width, start + (k + 1) * width, found))
    return annotations


def _points(path: Path, scores: _Tier, strokes: _Tier, service: _Tier) -> list[_Point]:
    """The points; who serves follows from the scores, and who strikes from who serves."""
    points: list[_Point] = []
    server: int | None = 0
    at = 0
    for start, end, value, line, *_ in scores:
        found = _SCORE.fullmatch(value)
        if found is None:
            raise DataError(path, f"point {value[:50]!r}; expected the score before it, such as 3:5", line=line)
        point = _Point(before=(int(found[1]), int(found[2])), game=1)
        if points:
            last = points[-1]
            point.game = last.game + (sum(point.before) < sum(last.before))
            gained = [now - before for now, before in zip(point.before, last.before, strict=True)]
            if point.game == last.game and min(gained) == 0:  # a point that was replayed is served again
                server = gained.index(max(gained)) if any(gained) else server
            elif (after := _after_cause(last)) is not None:
                server = int(after[1] > last.before[1])
            elif point.game != last.game and last.before[0] != last.before[1]:  # who led won the game
                server = last.before.index(max(last.before))
            else:
                server = None
        named = [told for each in service if start <= each.start < end and (told := _SERVER.search(each.value))]
        server = int(named[-1][1]) - 1 if named else server
        turn = server
        while at < len(strokes) and strokes[at].start < end:
            stroke, at = strokes[at], at + 1
            if stroke.value.lower() in _ENDINGS:
                point.cause = stroke.value
                continue
            turn = None if stroke.value == "error-tier" else turn  # nobody knows how many strokes are missing
            point.strokes.append((turn, stroke.start, stroke.value, stroke.line))
            turn = None if turn is None else 1 - turn
        points.append(point)
    return points
