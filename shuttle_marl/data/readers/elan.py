"""Annotations of ELAN (``.eaf``): tiers with values at times.

The tiers of BadmintonDB: ``Points`` (the score before each point), ``Strokes``, and ``Serve-Receive``, who serves first. In other
files a tier is a column, in any language: one of strokes, and further ones, of which the annotations at the same time belong to
a stroke.
"""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

from shuttle_marl.data.readers import badminton_db
from shuttle_marl.data.readers.badminton_db import ENDINGS, Point
from shuttle_marl.data.readers.reading import Reading, sheet_of, spans_around
from shuttle_marl.data.readers.tree import line_of
from shuttle_marl.data.strict_csv import DataError
from shuttle_marl.data.words import Words, bare

ROOT: Final = "ANNOTATION_DOCUMENT"
_SCORE: Final = re.compile(r"(\d{1,2})\s*[:-]\s*(\d{1,2})")
_SERVER: Final = re.compile(r"T([12])P1S")
Tier = list[tuple[float, float, str, int]]
"""Start and end [s], value and line of each annotation, in order of time."""


def read(path: Path, content: bytes, root: ET.Element) -> Reading:
    """Read a file.

    Raises:
        DataError: it has no tier of strokes, or none of players or points.
    """
    tiers = _tiers(path, root)
    words = Words("column", tiers)
    columns: dict[str, Tier] = {}
    unread = []
    for name, annotations in tiers.items():
        meaning = {"points": "score", "servereceive": "service", "servicereceive": "service"}.get(bare(name), words.meaning(name))
        if meaning and not columns.get(meaning):
            columns[meaning] = annotations
        elif annotations:
            unread.append(name)
    strokes = columns.pop("shot", columns.pop("stroke", []))
    if not strokes or not {"player", "score"} & columns.keys():
        expected = "Strokes, and Points or Player"
        raise DataError(path, f"tiers {', '.join(map(repr, tiers)) or 'none'}; expected {expected}, with annotations")
    if "player" not in columns:
        points = _points(path, columns["score"], strokes, columns.get("service", []))
        lost = () if columns.get("service") else ("who served first: the first player of the file",)
        return badminton_db.reading_of(path, content, points, "BadmintonDB ELAN", "line", lost)
    middles = [(start + end) / 2 for start, end, *_ in strokes]
    entries: list[dict[str, str]] = [{} for _ in strokes]
    for name, annotations in columns.items():
        for entry, number in zip(entries, spans_around([annotation[:2] for annotation in annotations], middles), strict=True):
            if number:
                told = annotations[number - 1][2]
                entry[name] = str(number) if name in ("rally", "game") and not told else told
    for entry, (start, _, value, _) in zip(entries, strokes, strict=True):
        entry |= {"shot": value, "seconds": f"{start:.3f}"}
    sheet = sheet_of(path, content, entries, [line for *_, line in strokes])
    named = ", ".join(map(repr, unread[:20]))
    lost = (f"tiers that are no columns here, or another one of the same meaning: {named}",) if unread else ()
    return Reading(format="ELAN", sheet=sheet, source="ELAN", lost=lost)


def _tiers(path: Path, root: ET.Element) -> dict[str, Tier]:
    """Annotations of each tier that are aligned to times."""
    try:
        units = {header.get("TIME_UNITS", "milliseconds") for header in root.iter("HEADER")}
        if units - {"milliseconds"}:
            raise ValueError(f"times in {', '.join(units):.50}; expected milliseconds")
        times = {
            slot.attrib["TIME_SLOT_ID"]: int(slot.attrib["TIME_VALUE"]) / 1000
            for slot in root.iter("TIME_SLOT")
            if "TIME_VALUE" in slot.attrib
        }
        return {
            tier.attrib["TIER_ID"]: sorted(
                (
                    times[annotation.attrib["TIME_SLOT_REF1"]],
                    times[annotation.attrib["TIME_SLOT_REF2"]],
                    (annotation.findtext("ANNOTATION_VALUE") or "").strip(),
                    line_of(annotation),
                )
                for annotation in tier.iter("ALIGNABLE_ANNOTATION")
            )
            for tier in root.iter("TIER")
        }
    except (KeyError, ValueError) as error:
        raise DataError(path, f"a tier or a time of ELAN is incomplete ({type(error).__name__}: {error})") from error


def _points(path: Path, scores: Tier, strokes: Tier, service: Tier) -> list[Point]:
    """The points; who serves follows from the scores, and who strikes from who serves."""
    points: list[Point] = []
    server, at = 0, 0
    for start, end, value, line in scores:
        found = _SCORE.fullmatch(value)
        if found is None:
            raise DataError(path, f"point {value[:50]!r}; expected the score before it, such as 3:5", line=line)
        point = Point(before=(int(found[1]), int(found[2])), game=points[-1].game if points else 1)
        if points:
            last = points[-1]
            point.game += sum(point.before) < sum(last.before)
            gained = [now - before for now, before in zip(point.before, last.before, strict=True)]
            if point.game == last.game and sorted(gained) == [0, 1]:
                server = gained.index(1)
            elif (after := badminton_db.after_cause(last)) is not None:
                server = int(after[1] > last.before[1])
        for begun, _, told, _ in service:
            if start <= begun < end and (named := _SERVER.search(told)):
                server = int(named[1]) - 1
        turn: int | None = server
        while at < len(strokes) and strokes[at][0] < end:
            begun, _, told, place = strokes[at]
            at += 1
            if told.lower() in ENDINGS:
                point.cause = told
                continue
            turn = None if told == "error-tier" else turn  # nobody knows how many strokes are missing
            point.strokes.append((turn, begun, told, place))
            turn = None if turn is None else 1 - turn
        points.append(point)
    return points
