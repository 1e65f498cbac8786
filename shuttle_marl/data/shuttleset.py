"""Strict readers of the files of ShuttleSet and ShuttleSet22; :mod:`shuttle_marl.data.cleaning` cleans their rows.

Sources: Wang et al., "ShuttleSet: A Human-Annotated Stroke-Level Singles Dataset for Badminton Tactical Analysis",
KDD 2023 (arXiv 2306.04948); Wang et al., "ShuttleSet22", IT4PSS@IJCAI 2023 (arXiv 2306.15664). Both MIT.

An invalid value is an error with file, line and value, unless the file equals a published one (by its SHA-256): its invalid
rows are marked unreadable, and cleaning drops and counts them. The files of the 82 public matches have no such row.
"""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, I8, I64, Bools, Ints
from shuttle_marl.base.errors import command
from shuttle_marl.data import upstream
from shuttle_marl.data.schema import FAR_OFF, REASONS
from shuttle_marl.data.strict_csv import DataError, Problem, StrictCsv
from shuttle_marl.data.upstream import discipline, player_id
from shuttle_marl.game.stroke import SHOTS

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
"""Shot types by name in the files, which have 過度切球 for the passive drop (in the data sets' README 過渡切球)."""
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
"""Reasons by value of ``lose_reason``."""

POINTS: Final = ("landing", "hit", "player_location", "opponent_location")
"""Points with pixel coordinates in every row."""
BAD_HOMOGRAPHY: Final = 0.2
"""Maximum fraction of the rows of a game with both players in one half; above, its homography is broken."""

_NUMBERS: Final = tuple(f"{point}_{axis}" for point in POINTS for axis in "xy")
_COLUMNS: Final = (
    "rally", "ball_round", "time", "frame_num", "roundscore_A", "roundscore_B", "player", "type", "aroundhead",
    "backhand", "hit_height", "landing_height", "landing_area", "lose_reason", "getpoint_player", "flaw", *_NUMBERS,
)  # fmt: skip
_MATCH_COLUMNS: Final = ("id", "video", "winner", "loser", "set")
_HOMOGRAPHY_COLUMNS: Final = ("video", "homography_matrix")
_MAX_NUMBER: Final = 9999
"""Maximum number of rallies, strokes of a rally, and matches of a list."""
_MAX_FRAMES: Final = 10_000_000

AREA_OF_LABEL: Final = (0, 2, 6, 8, 3, 5, 1, 4, 7)
"""Index into court.AREAS by area label 1 to 9, from the view of the player of that half."""
NEAREST_OF_LABEL: Final = (2, 5, 8, 7, 6, 3, 0)
"""Nearest area of the labels 10 to 16, which lie outside of the court and follow each other around it."""
_SHOT_CODES: Final = {**{name: SHOTS.index(shot) for name, shot in SHOT_NAMES.items()}, UNKNOWN_SHOT: -1, "": -1}
_REASON_CODES: Final = {**{name: REASONS.index(reason) for name, reason in REASON_NAMES.items()}, "": -1}

# The court in the frame of the homographies: 355 x 960 units, net at 480, 660 units from base line to base line.
_UNIT: Final = 13.40 / 660
_CENTRE: Final = np.array([177.5, 480.0])


@dataclasses.dataclass(frozen=True, kw_only=True)
class ListedMatch:
    """A match listed in ``match.csv``.

    Attributes:
        name: folder name, the same in both data sets.
        source: ``ShuttleSet`` or ``ShuttleSet22``.
        number: ``id`` in that data set.
        players: identifiers of players A (the winner) and B of the files.
        folder: folder of the files of its games; it may be missing.
        n_games: number of games, as listed.
        homography: ``[3, 3]`` pixels to court units.
    """

    name: str
    source: str
    number: int
    players: tuple[str, str]
    discipline: str
    folder: Path
    n_games: int
    homography: F64

    @property
    def present(self) -> bool:
        """Whether its folder exists."""
        return self.folder.is_dir()

    def games(self) -> list[Path]:
        """The files of its games, in order.

        Raises:
            DataError: their number differs from ``match.csv``.
        """
        found = sorted(path for path in self.folder.glob("set*.csv") if re.fullmatch(r"set\d\.csv", path.name))
        if [path.name for path in found] != [f"set{i + 1}.csv" for i in range(self.n_games)]:
            present = ", ".join(path.name for path in found) or "none"
            raise DataError(self.folder, f"match.csv lists {self.n_games} games, files set1.csv, set2.csv, …; present: {present}")
        return found


@dataclasses.dataclass(frozen=True, kw_only=True)
class RawGame:
    """Columns of all rows of a game.

    Attributes:
        game: number of the game, from 1.
        broken_homography: whether the points are invalid (:data:`BAD_HOMOGRAPHY`).
        empty: number of further rows, without any value.
        line: ``[n]`` line in the file of each row.
        unreadable: ``[n]`` rows with an invalid value, which was replaced by a missing one.
        rally, stroke: ``[n]`` numbers of the annotators, from 1; 0 missing.
        by_a: ``[n]`` whether player A is the striker.
        shot: ``[n]`` index into :data:`shuttle_marl.game.stroke.SHOTS`, -1 unknown.
        height: ``[n]`` contact height: 0 below, 1 above the net, -1 missing.
        met_height: ``[n]`` height of the receiver's contact, likewise.
        backhand, around_head, flaw: ``[n]`` flags.
        label_area: ``[n]`` area label 1..16 of the landing as annotated, 0 missing.
        reason: ``[n]`` index into ``schema.REASONS``, -1 missing or not at the end of a rally.
        winner: ``[n]`` 0 for A, 1 for B, -1 missing or not at the end of a rally.
        score: ``[n, 2]`` points of A and B after the rally, -1 missing.
        clock, frame: ``[n]`` seconds and frames into the video, -1 missing.
        point: for each of :data:`POINTS`, ``[n, 2]`` court metres, origin under the net, not yet egocentric; NaN missing.
    """

    match: ListedMatch
    game: int
    path: Path
    broken_homography: bool
    empty: int
    line: I64
    unreadable: Bools
    rally: I64
    stroke: I64
    by_a: Bools
    shot: I8
    height: I8
    met_height: I8
    backhand: Bools
    around_head: Bools
    flaw: Bools
    label_area: I8
    reason: I8
    winner: I8
    score: I64
    clock: I64
    frame: I64
    point: dict[str, F64]

    def take(self, rows: Ints) -> "RawGame":
        """Rows by index."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        taken: dict[str, Any] = {name: value[rows] for name, value in values.items() if isinstance(value, np.ndarray)}
        return dataclasses.replace(self, **taken, point={name: xy[rows] for name, xy in self.point.items()})


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
    found: list[Problem] = []
    matches: dict[str, ListedMatch] = {}
    for source in sources:
        for match in _list_source(root / upstream.SOURCES[source], source, found):
            other = matches.get(match.name)
            if other is None or (match.present and not other.present):
                matches[match.name] = match
    if problems is not None:
        problems.extend(found)
    elif found:
        raise DataError.of(found)
    return list(matches.values())


def _list_source(folder: Path, source: str, problems: list[Problem]) -> list[ListedMatch]:
    homographies = _homographies(folder / "homography.csv", problems)
    sheet = StrictCsv(folder / "match.csv", _MATCH_COLUMNS)
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
            matches[name] = ListedMatch(
                name=name,
                source=source,
                number=int(numbers[i]),
                players=players,
                discipline=kinds.pop(),
                folder=folder / name,
                n_games=int(n_games[i]),
                homography=homographies[name],
            )
    problems.extend(sheet.problems)
    return list(matches.values())


def _homographies(path: Path, problems: list[Problem]) -> dict[str, F64]:
    sheet = StrictCsv(path, _HOMOGRAPHY_COLUMNS)
    homographies = {}
    for i, (name, text) in enumerate(zip(sheet.text("video"), sheet.text("homography_matrix"), strict=True)):
        try:
            matrix = np.array(json.loads(text), dtype=np.float64)
        except (ValueError, TypeError, OverflowError, RecursionError):
            matrix = np.empty(0)
        if matrix.shape == (3, 3) and np.isfinite(matrix).all():
            homographies[name] = matrix
        else:
            sheet.mark(i, f"homography_matrix {text!r} of match {name!r} is not a 3 x 3 matrix")
    problems.extend(sheet.problems)
    return homographies


def read_game(match: ListedMatch, path: Path, problems: list[Problem] | None = None) -> RawGame:
    """Read the file of one game.

    Args:
        path: the file, one of ``match.games()``.
        problems: list to which invalid values are added instead of raising.

    Raises:
        DataError: the file cannot be decoded, lacks a column or rows; or, unless ``problems`` is given or the file is a
            published one, contains an invalid value.
    """
    sheet = StrictCsv(path, _COLUMNS)
    point = {name: _project(sheet, name, match.homography) for name in POINTS}
    striker, receiver = point["player_location"][:, 1], point["opponent_location"][:, 1]
    broken = bool((striker * receiver > 0).mean() > BAD_HOMOGRAPHY)
    if not broken:
        _check_points(sheet, point)
    raw = RawGame(
        match=match,
        game=int(path.stem.removeprefix("set")),
        path=path,
        broken_homography=broken,
        empty=sheet.empty,
        line=sheet.line,
        rally=sheet.integers("rally", 1, _MAX_NUMBER, missing=0),
        stroke=sheet.integers("ball_round", 1, _MAX_NUMBER, missing=0),
        by_a=sheet.choices("player", {"A": 0, "B": 1}) == 0,
        shot=sheet.choices("type", _SHOT_CODES),
        height=_height(sheet, "hit_height"),
        met_height=_height(sheet, "landing_height"),
        backhand=sheet.codes("backhand", 1) == 1,
        around_head=sheet.codes("aroundhead", 1) == 1,
        flaw=sheet.codes("flaw", 1) == 1,
        label_area=sheet.codes("landing_area", 16),
        reason=sheet.choices("lose_reason", _REASON_CODES),
        winner=sheet.choices("getpoint_player", {"A": 0, "B": 1, "": -1}),
        score=np.stack([sheet.integers(f"roundscore_{who}", 0, 30, missing=-1) for who in "AB"], axis=1),
        clock=sheet.seconds("time"),
        frame=sheet.integers("frame_num", 0, _MAX_FRAMES, missing=-1),
        point=point,
        unreadable=sheet.unreadable,
    )
    found = sorted(sheet.problems, key=lambda problem: problem.line or 0)
    if problems is not None:
        problems.extend(found)
    elif found and not upstream.is_published(sheet.content):
        raise DataError.of(found)
    return raw


def _height(sheet: StrictCsv, column: str) -> I8:
    """Heights as 0 below, 1 above the net, -1 missing; the files have 1 above, 2 below (in their README 0)."""
    codes = sheet.codes(column, 2)
    return np.where(codes == 0, -1, 2 - codes).astype(np.int8)


def _project(sheet: StrictCsv, name: str, homography: F64) -> F64:
    """``[n, 2]`` court coordinates [m] of pixels, origin under the middle of the net; NaN missing."""
    x, y = sheet.numbers(f"{name}_x"), sheet.numbers(f"{name}_y")
    image = homography @ np.stack([x, y, np.ones_like(x)])
    with np.errstate(divide="ignore", invalid="ignore"):
        metres: F64 = ((image[:2] / image[2]).T - _CENTRE) * _UNIT
    return metres


def _check_points(sheet: StrictCsv, point: dict[str, F64]) -> None:
    """Mark points far off the court and set them missing."""
    limits = np.array([3.05, 6.70]) + FAR_OFF
    for name, metres in point.items():
        for row in np.flatnonzero((np.abs(metres) > limits).any(axis=1)):
            pixel = f"{sheet.text(f'{name}_x')[row]}, {sheet.text(f'{name}_y')[row]}"
            sheet.mark(
                row,
                f"{name} at pixel ({pixel}) is {metres[row, 0]:.1f} m, {metres[row, 1]:.1f} m from the middle of the net, "
                "far off the court: a wrong value or a wrong homography",
            )
            metres[row] = np.nan
