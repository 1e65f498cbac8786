"""Annotations of BadmintonDB as JSON (Ban et al., MMSports 2022): points with their strokes, times, and the cause of the end."""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from shuttle_marl.data.column_map import WINNERS
from shuttle_marl.data.problems import DataError
from shuttle_marl.data.readers.tree import text
from shuttle_marl.data.sheet import Sheet

SEATS: Final = ("T1P1", "T2P1")
ENDINGS: Final = {
    "end_out": "out", "end_fault": "error", "end_miss": "landed", "end_lucky": "landed", "end_misjudge": "misjudged",
}  # fmt: skip
"""Ending by cause."""
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
class Point:
    """A point of a match.

    Attributes:
        before: score before it, of seats 0 and 1.
        game: from 1.
        strokes: seat (None: not known), time [s] (None: not known), type and place in the file of each stroke.
        cause: of its end.
    """

    before: tuple[int, int]
    game: int
    strokes: list[tuple[int | None, float | None, str, int]] = dataclasses.field(default_factory=list)
    cause: str = ""


def recognises(value: Any) -> bool:
    """Whether JSON is of this format."""
    points = list(value.values()) if isinstance(value, dict) else value
    return bool(points) and isinstance(points, list) and isinstance(points[0], dict) and "PointInfo" in points[0]


def read(path: Path, content: bytes, value: Any) -> Sheet:
    """Read a file.

    Raises:
        DataError: a point has another form.
    """
    points, place, told = [], 0, list[tuple[int, str]]()
    for name, point in value.items() if isinstance(value, dict) else enumerate(value, 1):
        try:
            about = point["PointInfo"]
            seats = [about[seat] for seat in SEATS]
            found = Point(
                before=(int(seats[0]["Point"]), int(seats[1]["Point"])),
                game=1 + int(seats[0]["Score"]) + int(seats[1]["Score"]),
                cause=text((about.get("WonEnd") or {}).get("Cause")),
            )
            for number, stroke in enumerate(about.get("Rally") or (), 1):
                place += 1
                player = stroke.get("Player")
                seat = SEATS.index(player) if player in SEATS else None
                begin = stroke["StrokeBegin"]  # null where the picture missed it
                seconds = None if begin is None else float(begin)
                found.strokes.append((seat, seconds, text(stroke.get("StrokeType")), place))
                if player and seat is None:
                    told.append((place, f"player {player!r:.50}; expected {' or '.join(SEATS)}"))
                if stroke.get("StrokeNum", number) != number:
                    told.append((place, f"StrokeNum {stroke['StrokeNum']!r:.50} of stroke {number} of its point"))
                if number == 1 and seat is not None:
                    wrong = [at for at in (0, 1) if seats[at].get("Status", _STATUS[at == seat]) != _STATUS[at == seat]]
                    told += [(place, f"{player} serves, and {SEATS[at]} is a {seats[at]['Status']!r:.50}") for at in wrong]
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            raise DataError(path, f"{name}: no point of BadmintonDB ({type(error).__name__}: {error})") from error
        points.append(found)
    sheet = sheet_of(path, content, points, format="BadmintonDB JSON", unit="stroke")
    for at, what in told:
        sheet.warn([at - 1], what)
    return sheet


def sheet_of(
    path: Path, content: bytes, points: list[Point], lost: Sequence[str] = (), inferred: Sequence[str] = (), **about: Any
) -> Sheet:
    """The table of the strokes of points."""
    told = _FILE.fullmatch(path.stem)
    discipline, *people = told.groups() if told else ("", *SEATS)
    entries, places, doubted = list[dict[str, str]](), list[int](), list[tuple[int, str]]()
    number = game = 0
    for point, following in zip(points, [*points[1:], None], strict=True):
        number = number + 1 if point.game == game else 1
        game = point.game
        after = following.before if following is not None and following.game == game else after_cause(point)
        won = None if after is None else int(after[1] > point.before[1])
        for i, (seat, seconds, kind, place) in enumerate(point.strokes):
            backhand = _BACKHAND.fullmatch(kind)
            shot = backhand[1] if backhand else kind
            own = i % 2 if seat is None else seat
            known = seat is not None and shot.strip("*").upper() not in ("", "FAULT", "ERROR-TIER")
            entry = {"shot": shot if known else "unknown", "technique": "backhand" if backhand else "forehand"}
            entry |= {"game": str(game), "rally": str(number), "stroke": str(i + 1)}
            entry |= {"player": people[own], "opponent": people[1 - own]} | ({"discipline": discipline} if told else {})
            entry["seconds"] = "" if seconds is None else f"{seconds:.3f}"
            if after is not None:
                entry |= {"points": str(after[own]), "points_opponent": str(after[1 - own])}
            if i == len(point.strokes) - 1:
                # Who won follows from the score; a cause that contradicts it is another one.
                ending = ENDINGS.get(point.cause.lower(), "unknown")
                if won is not None and (ending in WINNERS) != (won == seat):
                    ending = "unknown"
                if point.cause and ending == "unknown":
                    doubted.append((len(entries), f"cause {point.cause!r:.50} is unknown, or contradicts who won by the score"))
                entry |= {"ending": ending, "winner": "" if won is None else people[won]}
            entries.append(entry)
            places.append(place)
    unnamed = [] if told else ["names of the players: the file is not named as the published ones"]
    by_name = ["players and discipline from the name of the file"] if told else []
    about |= {"source": "BadmintonDB", "lost": [*_LOST, *lost, *unnamed], "inferred": [*by_name, *inferred]}
    sheet = Sheet.of(path, content, entries, places, **about)
    for row, what in doubted:
        sheet.warn([row], what)
    return sheet


def after_cause(point: Point) -> tuple[int, int] | None:
    """The score after a point by its cause; None without one."""
    ending = ENDINGS.get(point.cause.lower())
    if ending is None or not point.strokes or point.strokes[-1][0] is None:
        return None
    won = point.strokes[-1][0] if ending in WINNERS else 1 - point.strokes[-1][0]
    return point.before[0] + (won == 0), point.before[1] + (won == 1)
