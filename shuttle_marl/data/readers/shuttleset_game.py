"""A single game of ShuttleSet (``set1.csv``), without the lists of its matches and their homographies.

``data convert`` reads the folder of the data sets, with the names of the players and the points on the court.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from shuttle_marl.data.readers.reading import Reading, sheet_of
from shuttle_marl.data.shuttleset import AREA_OF_LABEL, NEAREST_OF_LABEL
from shuttle_marl.data.strict_csv import Sheet
from shuttle_marl.game.court import AREAS

_MARKS: Final = {"ball_round", "rally", "player", "type", "landing_area"}
_AREAS: Final = ("", *(AREAS[i] for i in (*AREA_OF_LABEL, *NEAREST_OF_LABEL)))
"""Area by label; those outside of the court are the nearest ones."""
_FELL: Final = ("掛網", "未過網")
"""Endings of strokes that did not cross the net; their landing tells no target."""
_LOST: Final = (
    "points on the court: pixels need the homography of the match, which `data convert` reads with the folder of the data set",
    "names of the players: A won the match",
)


def recognises(header: Sequence[str]) -> bool:
    """Whether a CSV file is of this format."""
    return set(header) >= _MARKS


def read(path: Path, sheet: Sheet) -> Reading:
    """Read a file."""

    def column(name: str) -> tuple[str, ...]:
        return tuple(value.strip() for value in sheet.columns.get(name, ("",) * len(sheet)))

    def number(value: str) -> str:
        return re.sub(r"\.0*$", "", value)

    of_file = re.fullmatch(r"set(\d)", path.stem)
    match_and_game = (path.absolute().parent.name, of_file[1]) if of_file else (path.stem, "1")
    names, games = (
        column(name) if name in sheet.header else (value,) * len(sheet)
        for name, value in zip(("match_id", "set"), match_and_game, strict=True)
    )
    columns = [
        column(name)
        for name in ("rally", "ball_round", "player", "type", "aroundhead", "backhand", "hit_height", "landing_area",
                     "lose_reason", "getpoint_player", "roundscore_A", "roundscore_B", "time", "frame_num")
    ]  # fmt: skip
    entries = []
    for match, game, *values in zip(names, games, *columns, strict=True):
        rally, stroke, player, kind, around, back, height, area, ending, winner, a, b, clock, frame = values
        label = number(area)
        entry = {"match": match, "game": number(game), "rally": number(rally), "stroke": number(stroke), "player": player}
        entry["shot"] = kind or "unknown"
        # What cannot be read stays as it is: the import names it.
        strange = [mark for mark in (around, back) if number(mark) not in ("", "0", "1")]
        technique = "around-the-head" if number(around) == "1" else "backhand" if number(back) == "1" else "forehand"
        entry["technique"] = strange[0] if strange else technique
        entry["height"] = {"1": "above", "2": "below"}.get(number(height), height)
        target = _AREAS[int(label or 0)] if (label or "0").isdigit() and int(label or 0) < len(_AREAS) else area
        entry |= {"area": "" if ending in _FELL else target, "ending": ending, "winner": winner}
        if {player} <= {"A", "B"}:
            entry |= dict(zip(("points", "points_opponent"), map(number, (a, b) if player == "A" else (b, a)), strict=True))
        hours = re.fullmatch(r"(\d+):(\d\d):(\d\d)", clock)
        entry["seconds"] = clock if hours is None else str(3600 * int(hours[1]) + 60 * int(hours[2]) + int(hours[3]))
        entry["frame"] = number(frame)
        entries.append(entry)
    found = sheet_of(path, sheet.content, entries, sheet.line.tolist())
    found.empty = sheet.empty
    served, met, landed = column("server"), column("hit_area"), column("landing_area")
    rallies = list(zip(names, games, column("rally"), strict=True))
    for row, rally in enumerate(rallies):
        first = row == 0 or rallies[row - 1] != rally
        if served[row] and (number(served[row]) == "1") != first:
            found.warn([row], f"server {served[row]!r:.50}; expected 1 for the first stroke of a rally, and for no other")
        if not first and met[row] and landed[row - 1] and number(met[row]) != number(landed[row - 1]):
            found.warn([row], "hit_area is not the landing_area of the stroke before, which is used")
    return Reading(format="ShuttleSet", sheet=found, source="ShuttleSet", lost=_LOST)
