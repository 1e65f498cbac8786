"""A single game of ShuttleSet (``set1.csv``), without the lists of its matches and their homographies.

``data convert`` reads the folder of the data sets, with the names of the players and the points on the court.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from shuttle_marl.data.sheet import Sheet
from shuttle_marl.data.shuttleset import AREA_OF_LABEL, NEAREST_OF_LABEL
from shuttle_marl.game.court import AREAS

_MARKS: Final = {"ball_round", "rally", "player", "type", "landing_area"}
_AREAS: Final = ("", *(AREAS[i] for i in (*AREA_OF_LABEL, *NEAREST_OF_LABEL)))
"""Area by label; those outside of the court are the nearest ones."""
_FELL: Final = ("掛網", "未過網")
"""Endings of strokes that did not cross the net; their landing tells no target."""
_AS_THEY_ARE: Final = {
    "match": "match_id", "game": "set", "rally": "rally", "stroke": "ball_round", "player": "player", "ending": "lose_reason",
    "winner": "getpoint_player", "frame": "frame_num",
}  # fmt: skip
_COLUMNS: Final = (
    *_AS_THEY_ARE.values(), "type", "aroundhead", "backhand", "hit_height", "hit_area", "landing_area", "roundscore_A",
    "roundscore_B", "time", "server",
)  # fmt: skip
_DECIMALS: Final = re.compile(r"(?<=\d)\.0*$")
_LOST: Final = (
    "points on the court: pixels need the homography of the match, which `data convert` reads with the folder of the data set",
    "names of the players: A won the match",
)


def recognises(header: Sequence[str]) -> bool:
    """Whether a CSV file is of this format."""
    return set(header) >= _MARKS


def read(path: Path, sheet: Sheet) -> Sheet:
    """Read a file."""
    of_file = re.fullmatch(r"set(\d)", path.stem)
    absent = {"match_id": path.absolute().parent.name, "set": of_file[1]} if of_file else {"match_id": path.stem, "set": "1"}
    columns = [map(str.strip, sheet.columns.get(name, (absent.get(name, ""),) * len(sheet))) for name in _COLUMNS]
    rows = [dict(zip(_COLUMNS, values, strict=True)) for values in zip(*columns, strict=True)]
    for row in rows:
        row.update({name: _DECIMALS.sub("", value) for name, value in row.items() if name != "match_id"})
    about: dict[str, Any] = {"format": "ShuttleSet", "source": "ShuttleSet", "lost": _LOST, "empty": sheet.empty}
    found = Sheet.of(path, sheet.content, [_entry(row) for row in rows], sheet.line.tolist(), **about)
    before: dict[str, str] = {}
    for number, row in enumerate(rows):
        first = any(before.get(name) != row[name] for name in ("match_id", "set", "rally"))
        if row["server"] and (row["server"] == "1") != first:
            told = f"server {row['server']!r:.50}; expected 1 for the first stroke of a rally, and for no other"
            found.warn([number], told)
        if not first and row["hit_area"] and before["landing_area"] and row["hit_area"] != before["landing_area"]:
            found.warn([number], "hit_area is not the landing_area of the stroke before, which is used")
        before = row
    return found


def _entry(row: Mapping[str, str]) -> dict[str, str]:
    """A stroke; what cannot be read stays as it is: the import names it."""
    player, ending, label = row["player"], row["lose_reason"], row["landing_area"] or "0"
    area = _AREAS[int(label)] if label.isdecimal() and int(label) < len(_AREAS) else label
    around, back = row["aroundhead"], row["backhand"]
    strange = [mark for mark in (around, back) if mark not in ("", "0", "1")]
    technique = "around-the-head" if around == "1" else "backhand" if back == "1" else "forehand"
    clock = re.fullmatch(r"(\d+):(\d\d):(\d\d)", row["time"])
    entry = {name: row[header] for name, header in _AS_THEY_ARE.items()} | {
        "shot": row["type"] or "unknown",
        "technique": strange[0] if strange else technique,
        "height": {"1": "above", "2": "below"}.get(row["hit_height"], row["hit_height"]),
        "area": "" if ending in _FELL else area,
        "seconds": row["time"] if clock is None else str(3600 * int(clock[1]) + 60 * int(clock[2]) + int(clock[3])),
    }
    if player in ("A", "B"):
        entry |= {"points": row[f"roundscore_{player}"], "points_opponent": row[f"roundscore_{'BA'[player == 'B']}"]}
    return entry
