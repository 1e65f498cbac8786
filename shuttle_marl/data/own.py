"""Import of a user's matches from a CSV file with a row per stroke, by a :class:`~shuttle_marl.data.column_map.ColumnMap`.

Nothing is repaired: every invalid value and every broken rule of the schema is reported with its line.
"""

import difflib
import hashlib
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl import __version__
from shuttle_marl.arrays import F64, I64, Bools
from shuttle_marl.data.column_map import FAULTS, PLAYERS, WINNERS, WORDS, ColumnMap
from shuttle_marl.data.schema import DISCIPLINES, RANGES, REASONS, STROKES, Account, Cleaned, Outcome, violations
from shuttle_marl.data.strict_csv import DataError, StrictCsv
from shuttle_marl.data.upstream import discipline as discipline_of
from shuttle_marl.data.upstream import player_id
from shuttle_marl.game import court
from shuttle_marl.game.stroke import N_SERVES, SHOTS

POINTS: Final = ("landing", "contact", "striker", "receiver")
_ABOVE: Final = ("clear", "drop", "smash", "half-smash", "net-kill")


def import_matches(path: Path, columns: Path) -> tuple[Cleaned, dict[str, Any]]:
    """Import matches.

    Args:
        path: CSV file in UTF-8 with a row per stroke.
        columns: column map, a TOML file.

    Returns:
        The strokes with their account, and their provenance.

    Raises:
        DataError: an unreadable file, invalid values, or broken rules.
    """
    mapped = ColumnMap.read(columns)
    sheet = StrictCsv(path, list(mapped.columns.values()), delimiter=mapped.delimiter, decimal=mapped.decimal)
    strokes, dropped = _Import(sheet, mapped).table()
    if sheet.problems:
        raise DataError.of(sorted(sheet.problems, key=lambda found: found.line or 0), advice=("--columns", str(columns)))
    account = Account(
        matches=len(strokes["match"].unique()),
        rallies=strokes.group_by(["match", "game", "rally"]).aggregate([]).num_rows,
        rallies_kept=strokes.group_by(["match", "game", "rally"]).aggregate([]).num_rows,
        strokes=strokes.num_rows + dropped,
        strokes_kept=strokes.num_rows,
        dropped={"unknown shot type": dropped} if dropped else {},
        area_agreement=None,
    )
    provenance = {
        "source": mapped.source,
        "file": path.name,
        "sha256": hashlib.sha256(sheet.content).hexdigest(),
        "imported_by": f"shuttle_marl {__version__}",
    }
    return Cleaned(strokes=strokes, account=account, files=(path,)), provenance


class _Import:
    """Conversion of the columns of a file; problems are recorded in the sheet."""

    def __init__(self, sheet: StrictCsv, mapped: ColumnMap) -> None:
        self._sheet, self._map, self._n = sheet, mapped, len(sheet)
        self._match = np.array(self._text("match"))
        self._game = self._number("game", 1)
        self._rally = self._number("rally", 1)
        key = np.stack([np.unique(self._match, return_inverse=True)[1], self._game, self._rally])
        self._first = np.r_[True, (key[:, 1:] != key[:, :-1]).any(axis=0)]
        self._group = np.cumsum(self._first) - 1
        columns = [sheet.text(column) for column in mapped.columns.values()]
        for row in range(1, self._n):
            if all(column[row] == column[row - 1] for column in columns):
                sheet.mark(row, "duplicate of the row before")

    def table(self) -> tuple[pa.Table, int]:
        """The strokes of the rallies without unreadable rows, and the number of dropped rows."""
        sheet = self._sheet
        shot = self._code("shot", -1)
        serve = (shot >= 0) & (shot < N_SERVES)
        player, opponent = self._players()
        points = self._points()
        area = self._areas(points["landing"])
        outcome, reason = self._outcomes(player)
        discipline = self._disciplines(player, opponent)
        start = np.flatnonzero(self._first)[self._group]
        height = self._code("height", -1, without=np.isin(shot, [SHOTS.index(name) for name in _ABOVE]).astype(np.int64))
        stroke = self._number("stroke", 1) if "stroke" in self._map.columns else np.arange(self._n) - start + 1
        landing_x, landing_y = points["landing"].T.astype(np.float32)
        columns: dict[str, Any] = {
            "match": self._match,
            "source": np.full(self._n, self._map.source),
            "discipline": discipline,
            "game": self._game,
            "rally": self._rally,
            "stroke": stroke,
            "player": player,
            "opponent": opponent,
            "shot": shot,
            "height": np.where(serve, 0, height),
            "technique": self._code("technique", -1, without=np.zeros(self._n, np.int64)),
            "hurried": pa.nulls(self._n, pa.bool_()),
            "area": _nullable(area, area < 0),
            "in_court": _nullable(court.in_court(landing_x, landing_y), np.isnan(landing_y)),
            **{
                f"{name}_{axis}": _nullable(xy[:, i], np.isnan(xy[:, i]))
                for name, xy in points.items()
                for i, axis in enumerate("xy")
            },
            "clock": self._optional("seconds", "clock"),
            "frame": pa.nulls(self._n, pa.int32()),
            "outcome": outcome,
            "reason": reason,
            "points": self._optional("points", "points"),
            "points_opponent": self._optional("points_opponent", "points_opponent"),
            "label_area": pa.nulls(self._n, pa.int8()),
        }
        # An unreadable row would cause false problems of the other rows of its rally.
        readable = ~np.isin(self._group, np.unique(self._group[sheet.unreadable]))
        known = np.flatnonzero((shot < len(SHOTS)) & readable)
        if not len(known) and not sheet.problems:
            raise DataError(sheet.path, "no stroke of a known shot type")
        arrays = [_array(columns[field.name], field.type).take(pa.array(known)) for field in STROKES]
        strokes = pa.table(arrays, schema=STROKES)
        for violation in violations(strokes):
            for row in violation.rows:
                sheet.add(int(sheet.line[known[row]]), f"expected: {violation.rule}")
        return strokes, self._n - len(known)

    def _text(self, name: str) -> tuple[str, ...]:
        column = self._map.columns[name]
        spellings = self._map.values.get("player", {}) if name in PLAYERS else {}
        values = tuple(spellings.get(value.strip().casefold(), value.strip()) for value in self._sheet.text(column))
        for row, value in enumerate(values):
            if not value or not value.isprintable():
                self._sheet.mark(row, f"{column} {value!r}; expected a name")
        return values

    def _number(self, name: str, without: int) -> I64:
        if name not in self._map.columns:
            return np.full(self._n, without)
        low, high = RANGES[name]
        return self._sheet.integers(self._map.columns[name], low, high, missing=without)

    def _optional(self, name: str, field: str) -> pa.Array:
        """Optional integers."""
        kind = STROKES.field(field).type
        if name not in self._map.columns:
            return pa.nulls(self._n, kind)
        values = np.floor(self._sheet.numbers(self._map.columns[name]))
        low, high = RANGES[field]
        for row in np.flatnonzero((values < low) | (values > high)):
            self._sheet.mark(row, f"{self._map.columns[name]} {values[row]:g}; expected {low} to {high}")
        fine = (values >= low) & (values <= high)
        return _nullable(np.where(fine, np.nan_to_num(values), 0).astype(np.int64), ~fine)

    def _code(self, name: str, missing: int, *, without: I64 | None = None) -> I64:
        """Codes of the words of a column; ``without``: codes if the column is not mapped."""
        if name not in self._map.columns:
            assert without is not None
            return without
        column, words = self._map.columns[name], WORDS[name]
        own = self._map.values.get(name, {})
        codes: dict[str, int] = {}
        for text in set(self._sheet.text(column)):
            plain = text.strip().casefold()
            meant = own.get(plain, plain.replace(" ", "-").replace("_", "-"))
            lower = [word.casefold() for word in words]
            if meant.casefold() in lower:
                codes[text] = lower.index(meant.casefold())
            elif not plain and name in ("area", "ending"):
                codes[text] = missing
        for row, text in enumerate(self._sheet.text(column)):
            if text not in codes:
                close = difflib.get_close_matches(text.strip().casefold(), [*own, *words], n=1)
                hint = f"; did you mean {close[0]}?" if close else f"; map it in [values.{name}] to one of {', '.join(words)}"
                self._sheet.mark(row, f"unknown {column} {text!r}{hint}")
        return np.array([codes.get(text, missing) for text in self._sheet.text(column)], dtype=np.int64)

    def _players(self) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Identifiers of strikers and receivers."""
        player = self._identifiers("player")
        if "opponent" in self._map.columns:
            return player, self._identifiers("opponent")
        opponent = player.copy()
        for match in np.unique(self._match):
            rows = np.flatnonzero(self._match == match)
            names, first, count = np.unique(player[rows], return_index=True, return_counts=True)
            if len(names) != 2:
                if not self._sheet.unreadable[rows].any():  # else reported already
                    listed = ", ".join(names[:5])
                    rarest = rows[first[np.lexsort((-first, count))[0]]]
                    self._sheet.mark(
                        rarest, f"match {str(match)!r} has {len(names)} players ({listed}); expected two, or a column opponent"
                    )
                self._sheet.unreadable[rows] = True
                continue
            opponent[rows] = np.where(player[rows] == names[0], names[1], names[0])
        return player, opponent

    def _identifiers(self, name: str) -> npt.NDArray[Any]:
        return np.array([player_id(value) for value in self._text(name)], dtype=object)

    def _points(self) -> dict[str, F64]:
        """``[n, 2]`` points in the striker's frame, NaN missing."""
        sign = np.ones(self._n)
        if self._map.coordinates == "court":
            sign = np.where(self._code("side", 0) == 1, -1.0, 1.0)
        points = {}
        for name in POINTS:
            columns = [self._map.columns.get(f"{name}_{axis}") for axis in "xy"]
            values = [np.full(self._n, np.nan) if column is None else self._sheet.numbers(column) for column in columns]
            points[name] = np.stack(values, axis=1) * sign[:, None]
        return points

    def _areas(self, landing: F64) -> I64:
        """Areas of the landing points, or of the column where there is none."""
        computed = court.area_of(*landing.astype(np.float32).T).astype(np.int64)
        if "area" not in self._map.columns:
            return computed
        named = self._code("area", -1)
        if self._map.areas_seen_by == "striker":
            named = np.where(named < 0, -1, named + 2 - 2 * (named % 3))
        return np.where(computed >= 0, computed, named)

    def _outcomes(self, player: npt.NDArray[Any]) -> tuple[I64, I64]:
        """Outcome and reason of each stroke, from the endings and winners of rallies."""
        last = np.r_[self._first[1:], True]
        words = WORDS["ending"]
        unknown = words.index("unknown")
        ending = self._code("ending", 0, without=np.zeros(self._n, np.int64))
        for row in np.flatnonzero(~last & (ending > 0)):
            self._sheet.mark(row, f"ending {words[ending[row]]!r} of a stroke that is not the last of its rally")
        won = self._won(player)
        faults, winners = ([words.index(word) for word in group] for group in (FAULTS, WINNERS))
        fault, winner = np.isin(ending, faults), np.isin(ending, winners)
        for row in np.flatnonzero(last & ((fault & (won == 1)) | (winner & (won == 0)))):
            self._sheet.mark(row, f"ending {words[ending[row]]!r} contradicts who won the rally")
        undecided = last & ~fault & ~winner
        outcome = np.where(fault, Outcome.FAULT, np.where(winner, Outcome.WINNER, Outcome.RETURNED))
        by_winner = np.select([won == 1, won == 0], [Outcome.WINNER, Outcome.FAULT], Outcome.UNKNOWN)
        outcome = np.where(undecided, by_winner, outcome)
        for row in np.flatnonzero(undecided & (won < 0) & (ending != unknown) & ~self._sheet.unreadable):
            self._sheet.mark(
                row, "the last stroke of its rally has neither an ending nor a winner; use unknown if neither is known"
            )
        reason = np.array([REASONS.index(word) for word in words])[ending]
        return outcome.astype(np.int64), np.where(undecided, REASONS.index("unknown"), reason)

    def _won(self, player: npt.NDArray[Any]) -> I64:
        """``[n]`` 1 if the striker won the rally, 0 if not, -1 unknown."""
        if "winner" not in self._map.columns:
            return np.full(self._n, -1)
        winner_of: dict[int, str] = {}
        spellings = self._map.values.get("player", {})
        for row, text in enumerate(self._sheet.text(self._map.columns["winner"])):
            name = spellings.get(text.strip().casefold(), text)
            if name.strip() and winner_of.setdefault(int(self._group[row]), player_id(name)) != player_id(name):
                self._sheet.mark(row, f"{name.strip()!r} contradicts another winner of this rally")
        winners = [winner_of.get(int(group)) for group in self._group]
        return np.array([-1 if name is None else int(name == striker) for name, striker in zip(winners, player, strict=True)])

    def _disciplines(self, player: npt.NDArray[Any], opponent: npt.NDArray[Any]) -> npt.NDArray[Any]:
        if "discipline" in self._map.columns:
            return np.array(DISCIPLINES)[np.maximum(self._code("discipline", -1), 0)]
        if self._map.discipline:
            return np.full(self._n, self._map.discipline)
        known = [discipline_of(a) or discipline_of(b) for a, b in zip(player, opponent, strict=True)]
        if None in known:
            self._sheet.mark(
                known.index(None),
                f'unknown discipline; set discipline = "{DISCIPLINES[0]}" or "{DISCIPLINES[1]}" in the map, or map a column',
            )
        return np.array([kind or DISCIPLINES[0] for kind in known])


def _nullable(values: npt.NDArray[Any], missing: Bools) -> pa.Array:
    return pa.array(values, mask=missing)


def _array(values: Any, kind: pa.DataType) -> pa.Array:
    return values.cast(kind) if isinstance(values, pa.Array) else pa.array(values.tolist(), kind)
