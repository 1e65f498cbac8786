"""Annotations of ELAN (``.eaf``): tiers with values at times.

The tiers of BadmintonDB: ``Points`` (the score before each point), ``Strokes``, and ``Serve-Receive``, who serves first. In other
files a tier is a column, in any language: one of strokes, and further ones, of which the annotations at the same time belong to
a stroke.
"""

import itertools
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.data.problems import DataError
from shuttle_marl.data.readers import badminton_db
from shuttle_marl.data.readers.badminton_db import ENDINGS, Point
from shuttle_marl.data.readers.tree import line_of, spans_around, text_of
from shuttle_marl.data.sheet import Sheet
from shuttle_marl.data.words import Words, bare

ROOT: Final = "ANNOTATION_DOCUMENT"
_OF_BADMINTON_DB: Final = {"points": "score", "servereceive": "service", "servicereceive": "service"}
_OF_ANOTHER: Final = "REF_ANNOTATION"
_DEEPEST: Final = 20
"""Levels of tiers whose annotations belong to other ones."""
_SCORE: Final = re.compile(r"(\d{1,2})\s*[:-]\s*(\d{1,2})")
_SERVER: Final = re.compile(r"T([12])P1S")


class Annotation(NamedTuple):
    """An annotation.

    Attributes:
        start, end: times in the video [s].
        line: in the file.
        name, parent: identifiers of it, and of the annotation that it belongs to.
    """

    start: float
    end: float
    value: str
    line: int
    name: str = ""
    parent: str = ""


Tier = list[Annotation]
"""Annotations in order of time."""


def read(path: Path, content: bytes, root: ET.Element) -> Sheet:
    """Read a file.

    Raises:
        DataError: it has no tier of strokes, or none of players or points.
    """
    inferred = list[str]()
    tiers = _tiers(path, root, inferred)
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
    unread = [repr(name) for name, annotations in tiers.items() if annotations and name not in used][:20]
    lost = [f"tiers that are no columns here, or another one of the same meaning: {', '.join(unread)}"] if unread else []
    if of_badminton_db:
        points = _points(path, columns["score"], strokes, columns.get("service", []))
        lost += [] if columns.get("service") else ["who served first: the first player of the file"]
        return badminton_db.sheet_of(path, content, points, lost, inferred, format="BadmintonDB ELAN")
    middles = [(stroke.start + stroke.end) / 2 for stroke in strokes]
    entries: list[dict[str, str]] = [{} for _ in strokes]
    for name, annotations in columns.items():
        if annotations is strokes:
            continue
        spans = spans_around([annotation[:2] for annotation in annotations], middles)
        of_stroke = {annotation.parent: number for number, annotation in enumerate(annotations, 1) if annotation.parent}
        for entry, stroke, number in zip(entries, strokes, spans, strict=True):
            if number := of_stroke.get(stroke.name, number):
                told = annotations[number - 1].value
                entry[name] = str(number) if name in ("rally", "game") and not told else told
    for entry, stroke in zip(entries, strokes, strict=True):
        entry |= {"shot": stroke.value, "seconds": f"{stroke.start:.3f}"}
    lines = [stroke.line for stroke in strokes]
    return Sheet.of(path, content, entries, lines, format="ELAN", source="ELAN", lost=lost, inferred=inferred)


def _tiers(path: Path, root: ET.Element, inferred: list[str]) -> dict[str, Tier]:
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
        found: dict[str, Annotation] = {}
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


def _annotation(element: ET.Element, start: float, end: float, found: dict[str, Annotation]) -> Annotation:
    value, name = text_of(element, "ANNOTATION_VALUE"), element.get("ANNOTATION_ID", "")
    found[name] = Annotation(start, end, value, line_of(element), name, element.get("ANNOTATION_REF", ""))
    return found[name]


def _aligned(tier: ET.Element, slots: dict[str, float], found: dict[str, Annotation], inferred: list[str]) -> Tier:
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


def _dependent(tier: ET.Element, found: dict[str, Annotation], inferred: list[str]) -> Tier:
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


def _points(path: Path, scores: Tier, strokes: Tier, service: Tier) -> list[Point]:
    """The points; who serves follows from the scores, and who strikes from who serves."""
    points: list[Point] = []
    server, at = 0, 0
    for start, end, value, line, *_ in scores:
        found = _SCORE.fullmatch(value)
        if found is None:
            raise DataError(path, f"point {value[:50]!r}; expected the score before it, such as 3:5", line=line)
        point = Point(before=(int(found[1]), int(found[2])), game=1)
        if points:
            last = points[-1]
            point.game = last.game + (sum(point.before) < sum(last.before))
            gained = [now - before for now, before in zip(point.before, last.before, strict=True)]
            if point.game == last.game and sorted(gained) == [0, 1]:
                server = gained.index(1)
            elif (after := badminton_db.after_cause(last)) is not None:
                server = int(after[1] > last.before[1])
        named = [told for each in service if start <= each.start < end and (told := _SERVER.search(each.value))]
        server = int(named[-1][1]) - 1 if named else server
        turn: int | None = server
        while at < len(strokes) and strokes[at].start < end:
            stroke, at = strokes[at], at + 1
            if stroke.value.lower() in ENDINGS:
                point.cause = stroke.value
                continue
            turn = None if stroke.value == "error-tier" else turn  # nobody knows how many strokes are missing
            point.strokes.append((turn, stroke.start, stroke.value, stroke.line))
            turn = None if turn is None else 1 - turn
        points.append(point)
    return points
