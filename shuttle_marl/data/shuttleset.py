"""Reads the files of ShuttleSet and ShuttleSet22 strictly, as they are; :mod:`shuttle_marl.data.clean` does the rest.

Sources: Wang et al., "ShuttleSet: A Human-Annotated Stroke-Level Singles Dataset for Badminton Tactical Analysis",
KDD 2023 (arXiv 2306.04948); Wang et al., "ShuttleSet22", IT4PSS@IJCAI 2023 (arXiv 2306.15664). Both MIT.
"""

import csv
import dataclasses
import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.data.errors import DataError
from shuttle_marl.data.players import discipline, player_id

SOURCES: Final = {
    "ShuttleSet": Path("ShuttleSet/set"),
    "ShuttleSet22": Path("CoachAI-Challenge-IJCAI2023/ShuttleSet22/set"),
}
"""Folder of each data set below the root of the download."""

SHOT_NAMES: Final = {
    "發短球": "short-serve",
    "發長球": "long-serve",
    "長球": "clear",
    "挑球": "lift",
    "防守回挑": "lift",
    "切球": "drop",
    "過度切球": "drop",
    "殺球": "smash",
    "點扣": "half-smash",
    "平球": "drive",
    "小平球": "drive",
    "後場抽平球": "drive",
    "防守回抽": "drive",
    "推球": "push",
    "撲球": "net-kill",
    "放小球": "net-shot",
    "擋小球": "block",
    "勾球": "cross-court-net-shot",
}
"""Shot types of the files (README of the data sets) and ours."""
UNKNOWN_SHOT: Final = "未知球種"

REASON_NAMES: Final = {
    "出界": "out",
    "掛網": "net",
    "未過網": "short",
    "犯規": "foul",
    "對手落地致勝": "landed",
    "落點判斷失誤": "misjudged",
    "對手落地判斷失誤": "misjudged",
}
"""Values of ``lose_reason``: why the loser of a rally lost it."""

POINTS: Final = ("landing", "hit", "player_location", "opponent_location")
"""Points with pixel coordinates in every row."""
FAR_OFF: Final = 5.0
"""A point more than this far outside the lines [m] cannot be real: the file or its homography is broken."""

_NUMBERS: Final = tuple(f"{point}_{axis}" for point in POINTS for axis in "xy")
_COLUMNS: Final = (
    "rally", "ball_round", "time", "frame_num", "roundscore_A", "roundscore_B", "player", "type", "aroundhead",
    "backhand", "hit_height", "landing_height", "landing_area", "lose_reason", "getpoint_player", "flaw", *_NUMBERS,
)  # fmt: skip
_MATCH_COLUMNS: Final = ("id", "video", "winner", "loser")
_HOMOGRAPHY_COLUMNS: Final = ("video", "homography_matrix")

# The court in the frame of the homographies: 355 x 960 units, net at 480, 660 units from base line to base line.
_UNIT: Final = 13.40 / 660
_CENTRE: Final = np.array([177.5, 480.0])


@dataclasses.dataclass(frozen=True, kw_only=True)
class Match:
    """One match as listed in ``match.csv``.

    Attributes:
        name: folder name, the same in both data sets.
        source: key of :data:`SOURCES`.
        number: ``id`` in that data set.
        players: identifiers of players A and B of the files; A won the match.
        discipline: MS or WS.
        folder: where the files of the games are; it need not exist.
        homography: ``[3, 3]`` pixels to court units.
    """

    name: str
    source: str
    number: int
    players: tuple[str, str]
    discipline: str
    folder: Path
    homography: npt.NDArray[np.float64]

    @property
    def present(self) -> bool:
        """Whether the files of its games are there."""
        return self.folder.is_dir()

    def games(self) -> list[Path]:
        """The files of its games, in order."""
        return sorted(self.folder.glob("set*.csv"))


@dataclasses.dataclass(frozen=True, kw_only=True)
class RawGame:
    """The rows of one game, column by column; nothing dropped.

    Attributes:
        match: the match.
        game: number of the game, from 1.
        path: the file.
        line: ``[n]`` line in the file of each row.
        rally, stroke: ``[n]`` numbers given by the annotators.
        by_a: ``[n]`` whether player A is the striker.
        shot: ``[n]`` names of :data:`shuttle_marl.stroke.SHOTS`, or ``""`` where unknown.
        height: ``[n]`` contact height: 0 below, 1 above the net, -1 missing.
        met_height: ``[n]`` height at which the receiver met the shuttle, likewise.
        backhand, around_head, flaw: ``[n]`` flags.
        label_area: ``[n]`` area label 1..16 of the landing as annotated, 0 missing.
        reason: ``[n]`` names of ``schema.REASONS``, or ``""``.
        winner: ``[n]`` ``"A"``, ``"B"`` or ``""``.
        score: ``[n, 2]`` points of A and B after the rally.
        clock, frame: ``[n]`` seconds and frames into the video.
        point: for each of :data:`POINTS`, ``[n, 2]`` court metres, origin under the net, not yet egocentric; NaN missing.
    """

    match: Match
    game: int
    path: Path
    line: npt.NDArray[np.int64]
    rally: npt.NDArray[np.int64]
    stroke: npt.NDArray[np.int64]
    by_a: npt.NDArray[np.bool_]
    shot: npt.NDArray[np.str_]
    height: npt.NDArray[np.int8]
    met_height: npt.NDArray[np.int8]
    backhand: npt.NDArray[np.bool_]
    around_head: npt.NDArray[np.bool_]
    flaw: npt.NDArray[np.bool_]
    label_area: npt.NDArray[np.int8]
    reason: npt.NDArray[np.str_]
    winner: npt.NDArray[np.str_]
    score: npt.NDArray[np.int64]
    clock: npt.NDArray[np.int64]
    frame: npt.NDArray[np.int64]
    point: dict[str, npt.NDArray[np.float64]]


def list_matches(root: Path) -> list[Match]:
    """The matches of both data sets below ``root``; one that stands in both is listed once, from ShuttleSet.

    Raises:
        DataError: a list is missing, or names an unknown player or a match without homography.
    """
    matches: dict[str, Match] = {}
    found = [name for name, folder in SOURCES.items() if (root / folder / "match.csv").is_file()]
    if not found:
        expected = ", ".join(f"{folder}/match.csv" for folder in SOURCES.values())
        raise DataError(root, f"no match data here: expected {expected}; get it with `python -m shuttle_marl.data download`")
    for source in found:
        folder = root / SOURCES[source]
        homographies = {
            row["video"]: _homography(folder / "homography.csv", line, row["homography_matrix"])
            for line, row in _rows(folder / "homography.csv", _HOMOGRAPHY_COLUMNS)
        }
        for line, row in _rows(folder / "match.csv", _MATCH_COLUMNS):
            name = row["video"]
            if name in matches:
                continue
            if name not in homographies:
                raise DataError(folder / "homography.csv", f"no homography for match {name!r}")
            players = (player_id(row["winner"]), player_id(row["loser"]))
            kinds = {kind for kind in map(discipline, players) if kind is not None}
            if len(kinds) != 1:
                raise DataError(
                    folder / "match.csv",
                    f"players {players} belong to no or to different disciplines; add them to shuttle_marl/data/players.py",
                    line=line,
                )
            matches[name] = Match(
                name=name,
                source=source,
                number=_integer(folder / "match.csv", line, "id", row["id"]),
                players=players,
                discipline=kinds.pop(),
                folder=folder / name,
                homography=homographies[name],
            )
    return list(matches.values())


def read_game(match: Match, path: Path) -> RawGame:
    """Read the file of one game.

    Raises:
        DataError: missing column, wrong encoding, truncated row, unknown shot type or reason, a value that is no
            number, or a point that lies far off the court. The message names file, line and value.
    """
    number = re.fullmatch(r"set(\d+)", path.stem)
    if number is None:
        raise DataError(path, "the file of a game is named set<number>.csv")
    lines: list[int] = []
    columns: dict[str, list[str]] = {column: [] for column in _COLUMNS}
    for line, row in _rows(path, _COLUMNS):
        lines.append(line)
        for column in _COLUMNS:
            columns[column].append(row[column])
    if not lines:
        raise DataError(path, "no rows")

    def integers(column: str) -> npt.NDArray[np.int64]:
        return np.array([_integer(path, n, column, value) for n, value in zip(lines, columns[column], strict=True)])

    def optional(column: str) -> npt.NDArray[np.float64]:
        values = zip(lines, columns[column], strict=True)
        return np.array([_number(path, n, column, value) if value else np.nan for n, value in values])

    def one_of(column: str, names: dict[str, str]) -> npt.NDArray[np.str_]:
        for n, value in zip(lines, columns[column], strict=True):
            if value not in names:
                known = ", ".join(key for key in names if key)
                raise DataError(path, f"unknown {column} {value!r}; expected one of {known}", line=n)
        return np.array([names[value] for value in columns[column]])

    def heights(column: str) -> npt.NDArray[np.int8]:
        values = optional(column)
        for n, value in zip(lines, values, strict=True):
            if not (np.isnan(value) or value in (1, 2)):
                raise DataError(path, f"{column} {value:g}; expected 1 (above) or 2 (below the net)", line=n)
        return np.where(np.isnan(values), -1, 2 - np.nan_to_num(values)).astype(np.int8)

    labels = np.nan_to_num(optional("landing_area"))
    for n, value in zip(lines, labels, strict=True):
        if not 0 <= value <= 16:
            raise DataError(path, f"landing_area {value:g}; expected 1 to 16", line=n)
    point = {
        name: _project(path, lines, name, optional(f"{name}_x"), optional(f"{name}_y"), match.homography) for name in POINTS
    }
    return RawGame(
        match=match,
        game=int(number.group(1)),
        path=path,
        line=np.array(lines),
        rally=integers("rally"),
        stroke=integers("ball_round"),
        by_a=one_of("player", {"A": "A", "B": "B"}) == "A",
        shot=one_of("type", {**SHOT_NAMES, UNKNOWN_SHOT: "", "": ""}),
        height=heights("hit_height"),
        met_height=heights("landing_height"),
        backhand=optional("backhand") == 1,
        around_head=optional("aroundhead") == 1,
        flaw=optional("flaw") == 1,
        label_area=labels.astype(np.int8),
        reason=one_of("lose_reason", {**REASON_NAMES, "": ""}),
        winner=one_of("getpoint_player", {"A": "A", "B": "B", "": ""}),
        score=np.stack([integers("roundscore_A"), integers("roundscore_B")], axis=1),
        clock=np.array([_seconds(path, n, value) for n, value in zip(lines, columns["time"], strict=True)]),
        frame=integers("frame_num"),
        point=point,
    )


def _rows(path: Path, required: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield (line, row) of a CSV file in UTF-8 with a header, values stripped of nothing."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})") from error
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        value = raw[error.start : error.end].hex()
        raise DataError(path, f"byte 0x{value} is not UTF-8; save the file as UTF-8", line=line) from None
    reader = csv.reader(io.StringIO(text, newline=""))
    header = next(reader, [])
    missing = [column for column in required if column not in header]
    if missing:
        raise DataError(path, f"missing column {', '.join(missing)}; the header is {','.join(header)!r}", line=1)
    try:
        for row in reader:
            if len(row) != len(header):
                raise DataError(
                    path,
                    f"{len(row)} fields instead of {len(header)}, ending in {row[-1:]}: is the file truncated?",
                    line=reader.line_num,
                )
            yield reader.line_num, dict(zip(header, row, strict=True))
    except csv.Error as error:
        raise DataError(path, str(error), line=reader.line_num) from error


def _number(path: Path, line: int, column: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise DataError(path, f"{column} {value!r} is not a number", line=line)
    return number


def _integer(path: Path, line: int, column: str, value: str) -> int:
    number = _number(path, line, column, value)
    if number != int(number):
        raise DataError(path, f"{column} {value!r} is not a whole number", line=line)
    return int(number)


def _seconds(path: Path, line: int, value: str) -> int:
    clock = re.fullmatch(r"(\d+):([0-5]\d):([0-5]\d)", value)
    if clock is None:
        raise DataError(path, f"time {value!r}; expected h:mm:ss", line=line)
    hours, minutes, seconds = map(int, clock.groups())
    return 3600 * hours + 60 * minutes + seconds


def _homography(path: Path, line: int, text: str) -> npt.NDArray[np.float64]:
    try:
        matrix = np.array(json.loads(text), dtype=np.float64)
    except (ValueError, TypeError):
        matrix = np.empty(0)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise DataError(path, f"homography_matrix {text!r} is not a 3 x 3 matrix", line=line)
    return matrix


def _project(
    path: Path,
    lines: list[int],
    name: str,
    x: npt.NDArray[np.float64],
    y: npt.NDArray[np.float64],
    homography: npt.NDArray[np.float64],
) -> npt.NDArray[np.float64]:
    """Pixels to metres on the court, origin under the middle of the net."""
    image = homography @ np.stack([x, y, np.ones_like(x)])
    metres: npt.NDArray[np.float64] = ((image[:2] / image[2]).T - _CENTRE) * _UNIT
    limits = np.array([3.05, 6.70]) + FAR_OFF
    for i in np.flatnonzero((np.abs(metres) > limits).any(axis=1)):
        raise DataError(
            path,
            f"{name} at pixel ({x[i]:g}, {y[i]:g}) is {metres[i, 0]:.1f} m, {metres[i, 1]:.1f} m from the middle of the "
            "net, far off the court: a wrong value or a wrong homography",
            line=lines[i],
        )
    return metres
