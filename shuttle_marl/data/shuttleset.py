"""Strict readers of the files of ShuttleSet and ShuttleSet22; :mod:`shuttle_marl.data.cleaning` cleans their rows.

Sources: Wang et al., "ShuttleSet: A Human-Annotated Stroke-Level Singles Dataset for Badminton Tactical Analysis",
KDD 2023 (arXiv 2306.04948); Wang et al., "ShuttleSet22", IT4PSS@IJCAI 2023 (arXiv 2306.15664). Both MIT. Types and reasons are
the Chinese words of ``words.toml``; the passive drop is 過度切球 in the files, and 過渡切球 in the data sets' README.

An invalid value is an error with file, line and value, unless the file equals a published one (by its SHA-256): its invalid
rows are marked unreadable, and cleaning drops and counts them. The files of the 82 public matches have no such row.
"""

import dataclasses
import functools
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, I8, I64, Array, Ints
from shuttle_marl.base.errors import command
from shuttle_marl.data import upstream
from shuttle_marl.data.schema import FAR_OFF, RANGES, REASONS, DataError, Problem
from shuttle_marl.data.sheet import Sheet, read_csv
from shuttle_marl.data.upstream import discipline, player_id
from shuttle_marl.data.words import table
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import SHOTS

POINTS: Final = ("landing", "hit", "player_location", "opponent_location")  # points with pixel coordinates in every row
_BAD_HOMOGRAPHY: Final = 0.2  # maximum fraction of the rows of a game with both players in one half

_NUMBERS: Final = tuple(f"{point}_{axis}" for point in POINTS for axis in "xy")
_COLUMNS: Final = (
    "rally", "ball_round", "time", "frame_num", "roundscore_A", "roundscore_B", "player", "type", "aroundhead",
    "backhand", "hit_height", "landing_height", "landing_area", "lose_reason", "getpoint_player", *_NUMBERS,
)  # fmt: skip
_MATCH_COLUMNS: Final = ("id", "video", "winner", "loser", "set")
_HOMOGRAPHY_COLUMNS: Final = ("video", "homography_matrix")
_MAX_NUMBER: Final = 9999  # maximum number of rallies, strokes of a rally, and matches of a list
_CLOCK: Final = re.compile(r"(\d{1,4}):([0-5]\d):([0-5]\d)", re.ASCII)

AREA_OF_LABEL: Final = (0, 2, 6, 8, 3, 5, 1, 4, 7)  # index into court.AREAS by label 1 to 9, seen by the player of that half
NEAREST_OF_LABEL: Final = (2, 5, 8, 7, 6, 3, 0)  # nearest area of the labels 10 to 16, which follow each other around the court
# The court in the frame of the homographies: 355 x 960 units, net at 480, 660 units from base line to base line.
_UNIT: Final = 13.40 / 660
_CENTRE: Final = np.array([177.5, 480.0])


@dataclasses.dataclass(frozen=True, kw_only=True)
class ListedMatch:
    """A match listed in ``match.csv``."""

    name: str  # folder name, the same in both data sets
    source: str
    number: int  # its `id` in one
    players: tuple[str, str]  # identifiers of players A (the winner) and B of the files
    discipline: str
    folder: Path  # of the files of its games; it may be missing
    n_games: int
    homography: F64  # [3, 3] pixels to court units

    @property
    def present(self) -> bool:
        """Whether its folder exists."""
        return self.folder.is_dir()

    def games(self) -> list[Path]:
        """The files of its games, in order."""
        found = sorted(path for path in self.folder.glob("set*.csv") if re.fullmatch(r"set\d\.csv", path.name))
        if [path.name for path in found] != [f"set{i + 1}.csv" for i in range(self.n_games)]:
            present = ", ".join(path.name for path in found) or "none"
            raise DataError(self.folder, f"match.csv lists {self.n_games} games, files set1.csv, set2.csv, …; present: {present}")
        return found


@dataclasses.dataclass(frozen=True, kw_only=True)
class RawGame:
    """Columns of all n rows of a game.

    - ``unreadable``: whether a value was invalid and replaced by a missing one.
    - ``rally``, ``stroke``: numbers of the annotators, from 1; 0 missing.
    - ``by_a``: whether player A is the striker.
    - ``shot``: index into :data:`shuttle_marl.game.stroke.SHOTS`, -1 unknown.
    - ``height``, ``met_height``: contact heights of the stroke and of the receiver: 0 below, 1 above the net, -1 missing.
    - ``backhand``, ``around_head``: flags.
    - ``label_area``: area label 1..16 of the landing as annotated, 0 missing.
    - ``reason``: index into ``schema.REASONS``, -1 missing or not at the end of a rally.
    - ``winner``: 0 for A, 1 for B, -1 missing or not at the end of a rally.
    - ``score``: ``[n, 2]`` points of A and B after the rally, -1 missing.
    - ``clock``, ``frame``: seconds and frames into the video, -1 missing.
    - each of :data:`POINTS`: ``[n, 2]`` court metres, origin under the net, not yet egocentric; NaN missing.
    """

    match: ListedMatch
    game: int  # number of the game, from 1
    path: Path
    problems: Sequence[Problem]  # invalid values
    published: bool  # whether these are of a published file, in which their rows are dropped
    broken_homography: bool  # whether the points are invalid, with too many rows with both players in one half
    empty: int  # number of further rows, without any value
    columns: Mapping[str, Array]

    def __getitem__(self, column: str) -> Array:
        return self.columns[column]

    def __len__(self) -> int:
        return len(self.columns["rally"])

    def take(self, rows: Ints) -> "RawGame":
        """Rows by index."""
        return dataclasses.replace(self, columns={name: values[rows] for name, values in self.columns.items()})


def list_matches(root: Path, problems: list[Problem] | None = None) -> list[ListedMatch]:
    """The matches of both data sets below ``root``.

    Eight matches are in both data sets, with equal values except for missing ``landing_height``. They are listed once: from
    ShuttleSet, unless only the other folder is present.

    Args:
        problems: list to which problems are added instead of raising; matches with problems are left out.

    Raises:
        DataError: no readable list, or, without ``problems``, a repeated match, players of unknown or different disciplines, a
            match without homography, or an invalid value.
    """
    sources = [name for name, folder in upstream.SOURCES.items() if (root / folder / "match.csv").is_file()]
    if not sources:
        expected = ", ".join(f"{folder}/match.csv" for folder in upstream.SOURCES.values())
        raise DataError(root, f"no match data here: expected {expected}; download it with `{command('data', 'download')}`")
    found: list[Problem] = [] if problems is None else problems
    matches: dict[str, ListedMatch] = {}
    for source in sources:
        for name, match in _list_source(root / upstream.SOURCES[source], source, found).items():
            if name not in matches or (match.present and not matches[name].present):
                matches[name] = match
    if problems is None and found:
        raise DataError.of(found)
    return list(matches.values())


def _list_source(folder: Path, source: str, problems: list[Problem]) -> dict[str, ListedMatch]:
    plane = read_csv(folder / "homography.csv", _HOMOGRAPHY_COLUMNS)
    homographies = dict[str, F64]()
    for i, (name, text) in enumerate(zip(plane.text("video"), plane.text("homography_matrix"), strict=True)):
        try:
            matrix = np.array(json.loads(text), dtype=np.float64)
        except (ValueError, TypeError, OverflowError, RecursionError):
            matrix = np.empty(0)
        if matrix.shape == (3, 3) and np.isfinite(matrix).all():
            homographies[name] = matrix
        else:
            plane.mark(i, f"homography_matrix {text!r} of match {name!r} is not a 3 x 3 matrix")
    sheet = read_csv(folder / "match.csv", _MATCH_COLUMNS)
    numbers = sheet.integers("id", 1, _MAX_NUMBER, missing=0)
    n_games = sheet.integers("set", 1, 9, missing=0)
    matches: dict[str, ListedMatch] = {}
    for i, name in enumerate(sheet.text("video")):
        players = (player_id(sheet.text("winner")[i]), player_id(sheet.text("loser")[i]))
        kinds = {kind for kind in map(discipline, players) if kind is not None}
        if not name or name in matches:
            sheet.mark(i, f"match {name!r} is repeated or has no name")
        if name not in homographies:
            sheet.mark(i, f"no homography for match {name!r} in homography.csv")
        if len(kinds) != 1:
            sheet.mark(i, f"players {players} have an unknown or different disciplines; see shuttle_marl/data/upstream")
        if not sheet.unreadable[i]:
            about: dict[str, Any] = {"discipline": kinds.pop(), "folder": folder / name, "homography": homographies[name]}
            about |= {"number": int(numbers[i]), "n_games": int(n_games[i])}
            matches[name] = ListedMatch(name=name, source=source, players=players, **about)
    problems += [*plane.problems, *sheet.problems]
    return matches


def read_game(match: ListedMatch, path: Path) -> RawGame:
    """Read the file of one game, one of ``match.games()``."""
    sheet = read_csv(path, _COLUMNS)
    point = {name: _project(sheet, name, match.homography) for name in POINTS}
    striker, receiver = point["player_location"][:, 1], point["opponent_location"][:, 1]
    broken = bool((striker * receiver > 0).mean() > _BAD_HOMOGRAPHY)
    if not broken:
        _check_points(sheet, point)
    columns = {
        **point,
        "rally": sheet.integers("rally", 1, _MAX_NUMBER, missing=0),
        "stroke": sheet.integers("ball_round", 1, _MAX_NUMBER, missing=0),
        "by_a": _choices(sheet, "player", {"A": 0, "B": 1}) == 0,
        "shot": _choices(sheet, "type", _chinese("shot", SHOTS)),
        "height": _height(sheet, "hit_height"),
        "met_height": _height(sheet, "landing_height"),
        "backhand": _optional(sheet, "backhand", 1) == 1,
        "around_head": _optional(sheet, "aroundhead", 1) == 1,
        "label_area": _optional(sheet, "landing_area", 16),
        "reason": _choices(sheet, "lose_reason", _chinese("ending", ("", *REASONS[1:]))),
        "winner": _choices(sheet, "getpoint_player", {"A": 0, "B": 1, "": -1}),
        "score": np.stack([sheet.integers(f"roundscore_{who}", 0, 30, missing=-1) for who in "AB"], axis=1),
        "clock": _seconds(sheet, "time"),
        "frame": sheet.integers("frame_num", *RANGES["frame"], missing=-1),
        "unreadable": sheet.unreadable,
    }
    return RawGame(
        match=match,
        game=int(path.stem.removeprefix("set")),
        path=path,
        problems=sorted(sheet.problems, key=lambda problem: problem.line or 0),
        published=bool(sheet.problems) and upstream.is_published(sheet.content),
        broken_homography=broken,
        empty=sheet.empty,
        columns=columns,
    )


def _choices(sheet: Sheet, name: str, codes: dict[str, int]) -> I8:
    """``[n]`` codes of values; unknown ones are a problem and become -1."""
    known = ", ".join([key or "nothing" for key in codes][:20]) + (", …" if len(codes) > 20 else "")
    return sheet.codes(name, codes, -1, lambda _: f"expected one of {known}").astype(np.int8)


@functools.cache
def _chinese(kind: str, names: Sequence[str]) -> dict[str, int]:
    """Codes of the Chinese words of a kind; -1 for what is not known."""
    known = {word: meaning for word, meaning in table(kind)["zh"].items() if meaning in (*names, "unknown")}
    return {"": -1} | {word: -1 if meaning == "unknown" else names.index(meaning) for word, meaning in known.items()}


def _optional(sheet: Sheet, name: str, high: int) -> I8:
    """``[n]`` integers from 1 to high, 0 for empty values."""
    return sheet.integers(name, 1, high, missing=0, needed=False).astype(np.int8)


def _height(sheet: Sheet, name: str) -> I8:
    """Heights as 0 below, 1 above the net, -1 missing; the files have 1 above, 2 below (in their README 0)."""
    codes = _optional(sheet, name, 2)
    return np.where(codes == 0, -1, 2 - codes).astype(np.int8)


def _seconds_of(text: str) -> int | None:
    clock = _CLOCK.fullmatch(text)
    return None if clock is None else 3600 * int(clock[1]) + 60 * int(clock[2]) + int(clock[3])


def _seconds(sheet: Sheet, name: str) -> I64:
    """``[n]`` times [s]; other values are a problem and become -1."""
    known = {text: seconds for text in set(sheet.text(name)) if (seconds := _seconds_of(text)) is not None}
    return sheet.codes(name, known, -1, lambda _: "expected h:mm:ss")


def _project(sheet: Sheet, name: str, homography: F64) -> F64:
    """``[n, 2]`` court coordinates [m] of pixels, origin under the middle of the net; NaN missing."""
    x, y = sheet.numbers(f"{name}_x"), sheet.numbers(f"{name}_y")
    image = homography @ np.stack([x, y, np.ones_like(x)])
    with np.errstate(divide="ignore", invalid="ignore"):
        metres: F64 = ((image[:2] / image[2]).T - _CENTRE) * _UNIT
    return metres


def _check_points(sheet: Sheet, point: dict[str, F64]) -> None:
    limits = np.array([3.05, 6.70]) + FAR_OFF
    for name, metres in point.items():
        for row in np.flatnonzero((np.abs(metres) > limits).any(axis=1)):
            pixel, (x, y) = ", ".join(sheet.text(f"{name}_{axis}")[row] for axis in "xy"), metres[row]
            where = f"{x:.1f} m, {y:.1f} m from the middle of the net, far off the court"
            sheet.mark(row, f"{name} at pixel ({pixel}) is {where}: a wrong value or a wrong homography")
            metres[row] = np.nan


SINGLE_GAME: Final = frozenset({"ball_round", "rally", "player", "type", "landing_area"})
"""Headers that show a single game, without the lists of its matches and their homographies."""
_AREAS: Final = ("", *(AREAS[i] for i in (*AREA_OF_LABEL, *NEAREST_OF_LABEL)))  # area by label, or nearest one
_AS_THEY_ARE: Final = {
    "match": "match_id", "game": "set", "rally": "rally", "stroke": "ball_round", "player": "player", "ending": "lose_reason",
    "winner": "getpoint_player", "frame": "frame_num",
}  # fmt: skip
_READ: Final = (
    *_AS_THEY_ARE.values(), "type", "aroundhead", "backhand", "hit_height", "hit_area", "landing_area", "roundscore_A",
    "roundscore_B", "time", "server",
)  # fmt: skip
_LOST: Final = (
    "points on the court: pixels need the homography of the match, which `data convert` reads with the folder of the data set",
    "names of the players: A won the match",
)


def read_single_game(path: Path, sheet: Sheet) -> Sheet:
    """The strokes of a single game (``set1.csv``) for the import; what cannot be read stays as it is, and the import names it."""
    of_file = re.fullmatch(r"set(\d)", path.stem)
    absent = {"match_id": path.absolute().parent.name, "set": of_file[1]} if of_file else {"match_id": path.stem, "set": "1"}
    rows: list[dict[str, str]] = [{} for _ in range(len(sheet))]
    for name in _READ:
        for row, value in zip(rows, sheet.columns.get(name, (absent.get(name, ""),) * len(sheet)), strict=True):
            row[name] = value.strip() if name == "match_id" else re.sub(r"(?<=\d)\.0*$", "", value.strip())
    entries = [_entry(row) for row in rows]
    columns = {name: tuple(entry[name] for entry in entries) for name in entries[0]}
    about: dict[str, Any] = {"format": "ShuttleSet", "source": "ShuttleSet", "lost": _LOST, "strict": False, "decimal": "."}
    found = dataclasses.replace(sheet, header=tuple(columns), columns=columns, **about)
    before: dict[str, str] = {}
    for number, row in enumerate(rows):
        first = any(before.get(name) != row[name] for name in ("match_id", "set", "rally"))
        if row["server"] and (row["server"] == "1") != first:
            found.warn([number], f"server {row['server']!r:.50}; expected 1 for the first stroke of a rally, and for no other")
        if not first and row["hit_area"] and before["landing_area"] and row["hit_area"] != before["landing_area"]:
            found.warn([number], "hit_area is not the landing_area of the stroke before, which is used")
        before = row
    return found


def _entry(row: Mapping[str, str]) -> dict[str, str]:
    ending, label = row["lose_reason"], row["landing_area"] or "0"
    area = _AREAS[int(label)] if label.isdecimal() and int(label) < len(_AREAS) else label
    around, back = row["aroundhead"], row["backhand"]
    strange = [mark for mark in (around, back) if mark not in ("", "0", "1")]
    technique = "around-the-head" if around == "1" else "backhand" if back == "1" else "forehand"
    seconds = _seconds_of(row["time"])
    own, other = {"A": ("A", "B"), "B": ("B", "A")}.get(row["player"], ("", ""))
    return {name: row[header] for name, header in _AS_THEY_ARE.items()} | {
        "shot": row["type"] or "unknown",
        "technique": strange[0] if strange else technique,
        "height": {"1": "above", "2": "below"}.get(row["hit_height"], row["hit_height"]),
        "area": "" if ending in ("掛網", "未過網") else area,  # did not cross the net: the landing tells no target
        "seconds": row["time"] if seconds is None else str(seconds),
        "points": row.get(f"roundscore_{own}", ""),
        "points_opponent": row.get(f"roundscore_{other}", ""),
    }
