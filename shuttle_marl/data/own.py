"""Import of a user's matches from a table of strokes, by a :class:`~shuttle_marl.data.column_map.ColumnMap`.

Nothing is repaired: every invalid value and every broken rule of the schema is reported with its line. Columns that repeat each
other are compared; where they may differ, or values are improbable, that is a warning. What the file lacks is inferred where
other values tell it, and marked.
"""

import dataclasses
import hashlib
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl import __version__
from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.data import readers
from shuttle_marl.data.cleaning import FIXED_HEIGHT
from shuttle_marl.data.column_map import FAULTS, PLAYERS, WINNERS, WORDS, ColumnMap, nfc, plain
from shuttle_marl.data.inference import LONG_REPLIES, PAUSE, areas_met, read_score, winners_by_score
from shuttle_marl.data.schema import (
    DISCIPLINES,
    RANGES,
    REACH_OVER,
    REASONS,
    STROKES,
    Account,
    Cleaned,
    Outcome,
    stroke_table,
    violations,
)
from shuttle_marl.data.strict_csv import DataError, Problem, Sheet, grouped, shown
from shuttle_marl.data.upstream import discipline as discipline_of
from shuttle_marl.data.upstream import player_id
from shuttle_marl.data.words import Words
from shuttle_marl.game import court
from shuttle_marl.game.stroke import N_SERVES, SHOTS

POINTS: Final = ("landing", "contact", "striker", "receiver")
_ABOVE: Final = ("clear", "drop", "smash", "half-smash", "net-kill")
_MAY_BE_EMPTY: Final = ("area", "ending", "height", "technique", "forced")
_MOST_HINTS: Final = 50
"""Unknown words of a column for which a similar one is looked up."""
_MOST_MATCHES: Final = 10_000
INFERRED: Final = {
    "shot": "whether serves are short, from the replies",
    "height": "contact heights, from the shot types",
    "technique": "techniques, taken as forehand",
    "area": "areas, from the next strokes; their confidence is a column",
    "outcome": "who won the rallies, from who serves next",
}
"""What may be inferred of a stroke, and from what."""

_APART: Final = 0.5
"""Largest distance of a contact point from the landing of the stroke before, which is the same point [m]."""
_REACH: Final = 4.0
"""Largest distance of a player from a contact point [m]; 3.5 in 999 of 1,000 published strokes."""
_SHALLOW: Final = 3.0
"""Points all within this distance of the middle of the net are improbable [m]."""
_TINY: Final = 1.05
"""Points all within this distance of the middle of the net are no metres [m], but fractions of a court."""
_OTHER_SCORE: Final = "the score is not that of the last stroke of its rally, which is used"
_FEW: Final = 10
"""Fewer points tell nothing for certain."""
_TEMPO: Final = (0.3, 5.0)
"""Probable median time between two strokes [s]; 0.9 in published matches."""


def import_matches(path: Path, columns: Path | None = None) -> tuple[Cleaned, dict[str, Any]]:
    """Import matches.

    Args:
        path: file of a format of :mod:`shuttle_marl.data.readers`.
        columns: column map, a TOML file; None: the columns are those that the words of the header mean.

    Returns:
        The strokes with their account, and their provenance.

    Raises:
        DataError: an unreadable file, invalid values, or broken rules; with the number of rows that were read.
    """
    given = ColumnMap() if columns is None else ColumnMap.read(columns)
    reading = readers.read(path, given)
    try:
        return _imported(path, columns, given, reading)
    except DataError as error:
        error.rows = reading.sheet.total
        raise


def _imported(path: Path, columns: Path | None, given: ColumnMap, reading: readers.Reading) -> tuple[Cleaned, dict[str, Any]]:
    sheet = reading.sheet
    mapped = given.filled(sheet)
    mapped = dataclasses.replace(mapped, source=given.source or reading.source)
    sheet.require(mapped.columns.values())
    lost, told = list(reading.lost), list(sheet.warnings)  # of the reader
    sheet.warnings.clear()
    if unread := [repr(name) for name in sheet.header if name and name not in map(nfc, mapped.columns.values())]:
        told.append(Problem(path, f"columns that the map does not name are not read: {', '.join(unread)}"))
    broken, rallies, lets = 0, 0, 0
    while True:
        own = _Import(sheet, mapped, strict=reading.strict)
        if (played := own.without_lets()) is not None:
            lets += len(sheet) - len(played)
            sheet = played
            continue
        strokes = own.table()
        rallies = max(rallies, own.rallies)
        if not sheet.problems:
            break
        wrong = own.wrong()
        if reading.strict or wrong.all() or not wrong.any():
            advice = () if columns is None else ("--columns", str(columns))
            raise DataError.of(sorted(sheet.problems, key=lambda found: found.line or 0), advice=advice)
        told += sheet.problems
        broken += int(wrong.sum())
        sheet = sheet.without(wrong)
    dropped = {
        "empty row": sheet.empty,
        "no stroke": sheet.others,
        "let": lets,
        "broken rally": broken,
        "unknown shot type": len(sheet) - strokes.num_rows,
    }
    account = Account(
        matches=len(strokes["match"].unique()),
        rallies=rallies,
        rallies_kept=strokes.group_by(["match", "game", "rally"]).aggregate([]).num_rows,
        strokes=reading.sheet.total,
        strokes_kept=strokes.num_rows,
        dropped={reason: count for reason, count in dropped.items() if count},
        area_agreement=None,
    )
    unknown = int(((strokes["area"].is_null().to_numpy()) & (strokes["outcome"].to_numpy() != Outcome.FAULT)).sum())
    lost += [f"areas of strokes without a known reply: {unknown:,} of {strokes.num_rows:,}"] if unknown else []
    inferred = (*reading.inferred, *own.inferred(strokes))
    provenance = {
        "source": mapped.source,
        "format": reading.format,
        "file": path.name,
        "sha256": hashlib.sha256(sheet.content).hexdigest(),
        "inferred": list(inferred),
        "lost": lost,
        "imported_by": f"shuttle_marl {__version__}",
    }
    found = sorted([*told, *sheet.warnings], key=lambda problem: problem.line or 0)
    return Cleaned(
        strokes=strokes,
        account=account,
        files=(path,),
        warnings=tuple(str(problem) for problem in grouped(found)),
        format=reading.format,
        inferred=inferred,
        lost=tuple(lost),
    ), provenance


class _Import:
    """Conversion of the columns of a file; problems are recorded in the sheet."""

    def __init__(self, sheet: Sheet, mapped: ColumnMap, *, strict: bool) -> None:
        self._sheet, self._map, self._n, self._strict = sheet, mapped, len(sheet), strict
        self._marks: dict[str, Bools] = {}
        self._notes: list[str] = []
        if "match" in mapped.columns:
            self._match = np.array(self._text("match"))
        else:
            self._match = np.full(self._n, "".join(c if c.isprintable() else "_" for c in sheet.path.stem).strip() or "match")
        self._game = self._number("game", 1)
        shot = self._code("shot", -1)
        known, match = np.unique(self._match, return_inverse=True)
        if len(known) > _MOST_MATCHES:
            raise DataError(sheet.path, f"{len(known):,} matches, more than {_MOST_MATCHES:,}; divide the file")
        self._rally = self._number("rally", 1) if "rally" in mapped.columns else self._numbered(match, shot)
        key = np.stack([match, self._game, self._rally])
        self._first = np.r_[True, (key[:, 1:] != key[:, :-1]).any(axis=0)]
        self._group = np.cumsum(self._first) - 1
        self.rallies = int(self._first.sum())
        self._beside = np.r_[False, (key[:2, 1:] == key[:2, :-1]).all(axis=0)]  # in the game of the row before
        self._names: dict[str, str] = {}
        self._alike: dict[str, str] = {}
        self._warn_alike(self._match.tolist(), "match")
        columns = [sheet.text(column) for column in mapped.columns.values()]
        for row in range(1, self._n) if {"rally", "stroke", "seconds", "frame"} & mapped.columns.keys() else ():
            if all(column[row] == column[row - 1] for column in columns):
                sheet.mark(row, "duplicate of the row before")
        self._stroke = self._strokes(shot)
        self._reply = np.r_[~self._first[1:] & (np.diff(self._stroke) == 1), False]
        following = np.where(self._reply, np.r_[shot[1:], -1], -1)
        bare = shot == WORDS["shot"].index("serve")
        self._shot = np.where(bare, np.isin(following, LONG_REPLIES).astype(np.int64), shot)
        self._mark("shot", bare)

    def _numbered(self, match: I64, shot: I64) -> I64:
        """Numbers of rallies in their games: each begins with a serve, or after a pause."""
        begins = np.isin(shot, [*range(N_SERVES), WORDS["shot"].index("serve")])
        if "seconds" in self._map.columns:
            begins |= np.diff(self._sheet.numbers(self._map.columns["seconds"]), prepend=np.nan) > PAUSE
        fresh = np.r_[True, (np.diff(match) != 0) | (np.diff(self._game) != 0)]
        number = np.cumsum(begins | fresh)
        self._notes.append(f"where rallies begin: with each serve, or after a pause of {PAUSE:g} s")
        return number - number[np.flatnonzero(fresh)][np.cumsum(fresh) - 1] + 1

    def _strokes(self, shot: I64) -> I64:
        """Numbers of strokes in their rallies; in files of programs one is missing where a player strikes twice in a row."""
        if "stroke" in self._map.columns:
            return self._number("stroke", 1)
        start = np.flatnonzero(self._first)[self._group]
        if self._strict:
            return np.arange(self._n) - start + 1
        player = np.array(self._sheet.text(self._map.columns["player"]))
        if twice := int(((player[1:] == player[:-1]) & ~self._first[1:]).sum()):
            self._notes.append(f"a stroke is missing where a player strikes twice in a row: {twice:,} times")
        served = np.isin(shot, [-1, *range(N_SERVES), *map(WORDS["shot"].index, ("unknown", "serve"))])
        step = np.cumsum(np.where(np.r_[False, player[1:] == player[:-1]], 2, 1))
        return step - step[start] + np.where(served[start], 1, 2)

    def _mark(self, name: str, rows: Bools) -> None:
        self._marks[name] = self._marks.get(name, np.zeros(self._n, dtype=bool)) | rows

    def wrong(self) -> Bools:
        """``[n]`` rows of the rallies with problems."""
        return np.isin(self._group, self._group[self._sheet.unreadable])

    def without_lets(self) -> Sheet | None:
        """The sheet without rallies that were replayed, which do not count as rallies of their games; None: there are none."""
        let = self._code("ending", 0) == WORDS["ending"].index("let")
        if not let.any():
            return None
        part = np.cumsum(self._first | np.r_[False, let[:-1]])  # the replay may have the same number
        kept, fresh = ~np.isin(part, part[let]), ~self._beside
        counted = np.cumsum(self._beside & np.r_[False, let[:-1] & (np.diff(self._rally) > 0)])
        number = self._rally - counted + counted[fresh][np.cumsum(fresh) - 1]
        sheet = self._sheet.without(~kept)
        if "rally" in self._map.columns:
            sheet.columns[nfc(self._map.columns["rally"])] = tuple(map(str, number[kept].tolist()))
        return sheet

    def inferred(self, strokes: pa.Table) -> tuple[str, ...]:
        """Sentences on what was inferred, with the numbers of kept strokes."""
        words = strokes["inferred"].fill_null("").to_pylist()
        counts = {name: sum(name in word.split() for word in words) for name in INFERRED}
        return (
            *self._notes,
            *(f"{text}: {counts[name]:,} of {strokes.num_rows:,} strokes" for name, text in INFERRED.items() if counts[name]),
        )

    def table(self) -> pa.Table:
        """The strokes of known types of the rallies without unreadable rows."""
        sheet, shot, stroke = self._sheet, self._shot, self._stroke
        serve = (shot >= 0) & (shot < N_SERVES)
        player, opponent = self._players()
        points = self._points()
        technique = self._code("technique", -1)
        self._mark("technique", technique < 0)
        landed = self._areas(points["landing"])
        met, share = areas_met(np.where(self._reply, np.r_[shot[1:], -1], -1), np.r_[technique[1:], -1])
        guessed = (landed < 0) & (met >= 0)
        self._mark("area", guessed)
        area = np.where(guessed, met, landed)
        ending = self._code("ending", 0)
        scored, after = self._scores(player, ending)
        outcome, reason = self._outcomes(player, opponent, ending, scored)
        forced = self._code("forced", -1)
        for word, code in (("unforced-error", 0), ("forced-error", 1)):
            forced = np.where(ending == WORDS["ending"].index(word), code, forced)
        discipline = self._disciplines(player, opponent)
        height = self._code("height", -1)
        self._mark("height", (height < 0) & ~serve)
        height = np.where(height >= 0, height, np.isin(shot, [SHOTS.index(name) for name in _ABOVE])).astype(np.int64)
        sure = np.full(self._n, np.nan)
        if "confidence" in self._map.columns:
            sure = sheet.numbers(self._map.columns["confidence"])
            for row in np.flatnonzero((sure < 0) | (sure > 1)):
                sheet.mark(row, f"{self._map.columns['confidence']} {sure[row]:g}; expected 0 to 1")
        sure = np.where(guessed, np.where(np.isnan(sure), 1.0, sure) * share, sure)
        marks = [" ".join(name for name in INFERRED if name in self._marks and self._marks[name][row]) for row in range(self._n)]
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
            "height": height,
            "technique": np.maximum(technique, 0),
            "area": pa.array(area, mask=area < 0),
            "in_court": pa.array(court.in_court(landing_x, landing_y), mask=np.isnan(landing_y)),
            "clock": self._optional("seconds", "clock"),
            "frame": self._optional("frame", "frame"),
            "outcome": outcome,
            "reason": reason,
            **{name: after.get(name, self._optional(name, name)) for name in ("points", "points_opponent")},
            "forced": pa.array(forced == 1, mask=forced < 0),
            "confidence": sure,
            "inferred": pa.array([mark or None for mark in marks], pa.string()),
        }
        if "stroke" in self._map.columns:
            missing = stroke != np.where(self._first, 1, np.r_[0, stroke[:-1]] + 1)
            sheet.warn(np.flatnonzero(missing), "strokes of the rally are missing before this one")
        self._compare_numbers(player, opponent, outcome, columns["points"], columns["points_opponent"])
        self._compare_points(points, outcome, reason)
        for name, usual in FIXED_HEIGHT.items():
            where = ("below", "above")[1 - usual]
            sheet.warn(np.flatnonzero((shot == SHOTS.index(name)) & (height == 1 - usual)), f"a {name} struck {where} the net")
        # An unreadable row would cause false problems of the other rows of its rally.
        readable = ~np.isin(self._group, np.unique(self._group[sheet.unreadable]))
        known = np.flatnonzero((shot < len(SHOTS)) & readable)
        if not len(known) and not sheet.problems:
            raise DataError(sheet.path, "no stroke of a known shot type")
        strokes = stroke_table(columns, points).take(pa.array(known))
        for violation in violations(strokes):
            sheet.mark(known[violation.rows], f"expected: {violation.rule}")
        return strokes

    def _text(self, name: str) -> tuple[str, ...]:
        column = self._map.columns[name]
        spellings = self._map.values.get("player", {}) if name in PLAYERS else {}
        values = tuple(nfc(spellings.get(plain(value), value.strip())) for value in self._sheet.text(column))
        for row, value in enumerate(values):
            if not value or not value.isprintable():
                self._sheet.mark(row, f"{column} {shown(value)}; expected a name")
            elif name in PLAYERS and not any(map(str.isalnum, value)):
                self._sheet.mark(row, f"{column} {shown(value)}; expected a name with letters or digits")
        return values

    def _number(self, name: str, without: int) -> I64:
        if name not in self._map.columns:
            return np.full(self._n, without)
        low, high = RANGES[name]
        return self._sheet.integers(self._map.columns[name], low, high, missing=without)

    def _optional(self, name: str, field: str) -> pa.Array:
        kind = STROKES.field(field).type
        if name not in self._map.columns:
            return pa.nulls(self._n, kind)
        values = self._sheet.numbers(self._map.columns[name])
        low, high = RANGES[field]
        # Times may have fractions, which the table does not keep.
        fine = (values >= low) & (values <= high) & ((name == "seconds") | (values == np.floor(values)))
        for row in np.flatnonzero(~fine & ~np.isnan(values)):
            self._sheet.mark(row, f"{self._map.columns[name]} {values[row]:g}; expected a whole number from {low} to {high}")
        return pa.array(np.where(fine, np.nan_to_num(values), 0).astype(np.int64), mask=~fine)

    def _code(self, name: str, missing: int) -> I64:
        """Codes of the words of a column; ``missing`` for empty values, and for all if the column is not mapped."""
        if name not in self._map.columns:
            return np.full(self._n, missing)
        column, words = self._map.columns[name], WORDS[name]
        own, texts = self._map.values.get(name, {}), set(self._sheet.text(column))
        vocabulary = Words(name, texts)
        codes: dict[str, int] = {}
        for text in texts:
            meant = own.get(plain(text)) or vocabulary.meaning(text)
            if meant is not None:
                codes[text] = words.index(meant)
            elif not text.strip() and name in _MAY_BE_EMPTY:
                codes[text] = missing
        unknown = sorted(texts - codes.keys())
        hints = {text: vocabulary.meant(text, own) for text in unknown[:_MOST_HINTS]}
        for row, text in enumerate(self._sheet.text(column)) if unknown else ():
            if text not in codes:
                meant = hints.get(text)
                hint = f"did you mean {meant}?" if meant else f"map it in [values.{name}] to one of {', '.join(words)}"
                self._sheet.mark(row, f"unknown {column} {shown(text)}; {hint}")
        return np.array([codes.get(text, missing) for text in self._sheet.text(column)], dtype=np.int64)

    def _players(self) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        player = self._identifiers("player")
        if "opponent" in self._map.columns:
            return player, self._identifiers("opponent")
        opponent = player.copy()
        of_match, begins = np.argsort(self._match, kind="stable"), np.unique(np.sort(self._match), return_index=True)[1]
        for rows in np.split(of_match, begins[1:]):
            match = self._match[rows[0]]
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
        names = self._text(name)
        for row, value in enumerate(names):
            if (other := self._names.setdefault(player_id(value), value)) != value:
                self._sheet.mark(
                    row,
                    f"{shown(value)} and {shown(other)} would be one player, {player_id(value)}; write one name, or map one in "
                    "[values.player]",
                )
        self._warn_alike(names, "player")
        return np.array([player_id(value) for value in names], dtype=object)

    def _warn_alike(self, names: Sequence[str], what: str) -> None:
        """Warn of names that differ only in capitals, accents, width, or the order of words, or mix alphabets."""
        for row in sorted({name: row for row, name in reversed(list(enumerate(names)))}.values()):
            name = str(names[row])
            words = player_id("".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c))).split("-")
            other = self._alike.setdefault(f"{what} {words if what == 'match' else sorted(words)}", name)
            if other != name and (what == "match" or player_id(other) != player_id(name)):
                self._sheet.warn([row], f"{shown(name)} and {shown(other)} are alike: are they one {what}?")
            mixed = {unicodedata.name(c, "").partition(" ")[0] for c in name if c.isalpha()} & {"LATIN", "CYRILLIC", "GREEK"}
            if len(mixed) > 1:
                self._sheet.warn([row], f"{what} {shown(name)} mixes letters of {' and '.join(sorted(mixed)).lower()}")

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
            furthest = np.nanmax(np.abs(points[name]), axis=1, initial=0)[~np.isnan(points[name]).all(axis=1)]
            limit = _SHALLOW if len(furthest) > _FEW / 2 else _TINY
            if len(furthest) > 2 and furthest.max() <= limit:
                text = f"all {len(furthest)} {name} points lie within {limit:g} m of the middle of the net: are these metres?"
                certain = len(furthest) >= _FEW and furthest.max() <= _TINY
                (self._sheet.problems if certain else self._sheet.warnings).append(Problem(self._sheet.path, text))
        return points

    def _areas(self, landing: F64) -> I64:
        """Areas of the landing points, or of the column where there is none."""
        computed = court.area_of(*landing.astype(np.float32).T).astype(np.int64)
        if "area" not in self._map.columns:
            return computed
        named = self._code("area", -1)
        if self._map.areas_seen_by == "striker":
            named = np.where(named < 0, -1, named + 2 - 2 * (named % 3))
        differ = np.flatnonzero((computed >= 0) & (named >= 0) & (computed != named))
        self._sheet.warn(differ, f"{self._map.columns['area']} is not the area of the landing point, which is used")
        return np.where(computed >= 0, computed, named)

    def _scores(self, player: npt.NDArray[Any], ending: I64) -> tuple[I64, dict[str, pa.Array]]:
        """``[n]`` 1 if the striker won the rally by the score, or by who serves next, 0 if not, -1 unknown; points after it."""
        words, first = WORDS["ending"], np.flatnonzero(self._first)
        last = np.r_[first[1:], self._n] - 1
        fresh = ~self._beside[first]
        side = (player != player[first][np.flatnonzero(fresh)][np.cumsum(fresh) - 1][self._group]).astype(np.int64)
        server = np.where(self._stroke[first] % 2 == 1, side[first], 1 - side[first])
        after: dict[str, pa.Array] = {}
        winner = np.full(len(first), -1)
        following = np.where(np.r_[fresh[1:], True], -1, np.r_[server[1:], -1])  # who won serves next
        if "score" in self._map.columns:
            fault, won_by = (np.isin(ending[last], [words.index(word) for word in group]) for group in (FAULTS, WINNERS))
            told = np.select([fault, won_by], [1 - side[last], side[last]], following)
            scores: list[tuple[int, int] | None] = [None] * len(first)
            for row, text in enumerate(self._sheet.text(self._map.columns["score"])):
                if text.strip() and (score := read_score(text)) is None:
                    self._sheet.mark(row, f"score {shown(text)}; expected points such as 5-3 (did a spreadsheet make it a date?)")
                elif text.strip():
                    if scores[self._group[row]] not in (None, score):
                        self._sheet.warn([row], _OTHER_SCORE)
                    scores[self._group[row]] = score
            points, won, reading = winners_by_score(scores, fresh, server.tolist(), told.tolist())
            self._notes.append(reading)
            winner = np.array(won)
            both = np.array([(np.nan, np.nan) if pair is None else pair for pair in points])[self._group]
            for name, seat in (("points", side), ("points_opponent", 1 - side)):
                own = both[np.arange(self._n), seat]
                after[name] = pa.array(np.nan_to_num(own).astype(np.int64), mask=np.isnan(own))
        elif not {"ending", "winner"} & self._map.columns.keys():
            winner = following
            self._mark("outcome", np.isin(np.arange(self._n), last[winner >= 0]))
        of_row = winner[self._group]
        return np.where(of_row < 0, -1, (of_row == side).astype(np.int64)), after

    def _outcomes(self, player: npt.NDArray[Any], opponent: npt.NDArray[Any], ending: I64, scored: I64) -> tuple[I64, I64]:
        """Outcome and reason of each stroke, from the endings and winners of rallies."""
        last = np.r_[self._first[1:], True]
        words = WORDS["ending"]
        unknown = words.index("unknown")
        for row in np.flatnonzero(~last & (ending > 0)):
            self._sheet.mark(row, f"ending {words[ending[row]]!r} of a stroke that is not the last of its rally")
        won = self._won(player, opponent)
        won = np.where(won < 0, scored, won)
        faults, winners = ([words.index(word) for word in group] for group in (FAULTS, WINNERS))
        fault, winner = np.isin(ending, faults), np.isin(ending, winners)
        for row in np.flatnonzero(last & ((fault & (won == 1)) | (winner & (won == 0)))):
            self._sheet.mark(row, f"ending {words[ending[row]]!r} contradicts who won the rally")
        undecided = last & ~fault & ~winner
        outcome = np.where(fault, Outcome.FAULT, np.where(winner, Outcome.WINNER, Outcome.RETURNED))
        by_winner = np.select([won == 1, won == 0], [Outcome.WINNER, Outcome.FAULT], Outcome.UNKNOWN)
        outcome = np.where(undecided, by_winner, outcome)
        if "ending" in self._map.columns and self._strict:
            unsaid = np.flatnonzero(undecided & (won >= 0) & (ending != unknown))
            self._sheet.warn(unsaid, "the last stroke of its rally has no ending, only a winner")
        readable = ~np.isin(self._group, self._group[self._sheet.unreadable])
        if self._strict and {"ending", "winner"} & self._map.columns.keys():
            unsaid = np.flatnonzero(undecided & (won < 0) & (ending != unknown) & readable)
            text = "the last stroke of its rally has neither an ending nor a winner; use unknown if neither is known"
            self._sheet.mark(unsaid, text)
        reason = np.array([REASONS.index(word if word in REASONS else "unknown") for word in words])[ending]
        return outcome.astype(np.int64), np.where(undecided, REASONS.index("unknown"), reason)

    def _won(self, player: npt.NDArray[Any], opponent: npt.NDArray[Any]) -> I64:
        """``[n]`` 1 if the striker won the rally, 0 if not, -1 unknown."""
        if "winner" not in self._map.columns:
            return np.full(self._n, -1)
        winner_of: dict[int, str] = {}
        spellings = self._map.values.get("player", {})
        for row, text in enumerate(self._sheet.text(self._map.columns["winner"])):
            name = spellings.get(plain(text), text).strip()
            both = (player[row], opponent[row])
            if not name or both[0] == both[1]:  # reported already
                continue
            if player_id(name) not in both:
                self._sheet.mark(row, f"winner {shown(name)}; expected one of the players, {' or '.join(both)}")
            elif winner_of.setdefault(int(self._group[row]), player_id(name)) != player_id(name):
                self._sheet.mark(row, f"{shown(name)} contradicts another winner of this rally")
        winners = [winner_of.get(int(group)) for group in self._group]
        return np.array([-1 if name is None else int(name == striker) for name, striker in zip(winners, player, strict=True)])

    def _compare_numbers(
        self, player: npt.NDArray[Any], opponent: npt.NDArray[Any], outcome: I64, points: pa.Array, points_opponent: pa.Array
    ) -> None:
        """Compare numbers of rallies, sides, times and scores with the rows before them."""
        sheet = self._sheet
        fresh = ~self._beside
        gap = self._rally - np.where(fresh, 0, np.r_[0, self._rally[:-1]])
        sheet.warn(np.flatnonzero(self._first & (gap > 1)), "rallies of the game are missing before this one")
        same = np.r_[False, self._match[1:] == self._match[:-1]]
        leap = self._game - np.where(same, np.r_[0, self._game[:-1]], 0)
        sheet.warn(np.flatnonzero(leap > 1), "games of the match are missing before this one")
        won = np.select([outcome == Outcome.WINNER, outcome == Outcome.FAULT], [player, opponent], "")
        served = self._first & (self._stroke == 1) & (self._shot < N_SERVES) & ~fresh & (gap == 1)
        others = served & np.r_[False, (won[:-1] != "") & (won[:-1] != player[1:])]
        sheet.warn(np.flatnonzero(others), "the server did not win the rally before")
        if "side" in self._map.columns:
            end = (self._code("side", 0) == 1) ^ (player < opponent)
            moved = ~fresh & np.r_[False, end[1:] != end[:-1]]
            sheet.mark(np.flatnonzero(moved & ~self._first), "the players are not on the sides of the stroke before")
            sheet.warn(np.flatnonzero(moved & self._first & (self._game < 3)), "the players change sides during the game")
        if "seconds" in self._map.columns:
            passed = np.diff(sheet.numbers(self._map.columns["seconds"]), prepend=np.nan)
            sheet.warn(np.flatnonzero(~fresh & self._first & (passed < 0)), "the time is before that of the rally before")
            sheet.mark(np.flatnonzero(~self._first & (passed < 0)), "the time is before that of the stroke before")
            inside = passed[~self._first & ~np.isnan(passed)]
            if len(inside) and not _TEMPO[0] <= np.median(inside) <= _TEMPO[1]:
                text = f"half of the strokes follow the one before after {np.median(inside):g} s or less: are these seconds?"
                sheet.warnings.append(Problem(sheet.path, text))
        number, score = 0, dict[str, int]()
        last = np.flatnonzero(np.r_[self._first[1:], True])
        same = (player == player[last[self._group]])[:, None]
        told = np.stack([np.array(column.to_pylist(), dtype=np.float64) for column in (points, points_opponent)], axis=1)
        told = np.where(same, told, told[:, ::-1])
        differ = np.abs(told - told[last[self._group]]).max(axis=1, initial=0) > 0
        sheet.warn(np.flatnonzero(differ), _OTHER_SCORE)
        for row in last:
            if self._group[row] and not self._beside[np.searchsorted(self._group, self._group[row])]:
                number, score = 0, {}
            both, after = (player[row], opponent[row]), (points[row].as_py(), points_opponent[row].as_py())
            if None in after:
                continue
            rallies, before = int(self._rally[row]) - number, tuple(score.get(who, 0) for who in both)
            gained = (after[0] - before[0], after[1] - before[1])
            winner = {Outcome.WINNER: gained[0], Outcome.FAULT: gained[1]}.get(Outcome(outcome[row]), 1)
            text = f"score {after[0]}:{after[1]} after {before[0]}:{before[1]}, {rallies} rallies before"
            if min(gained) < 0 or sum(gained) > rallies or winner < 1:
                sheet.mark(row, f"{text}: it does not follow from who won; games need the column game")
            elif sum(gained) < rallies:
                sheet.warn([row], f"{text}: fewer points than rallies")
            number, score = int(self._rally[row]), dict(zip(both, after, strict=True))

    def _compare_points(self, points: dict[str, F64], outcome: I64, reason: I64) -> None:
        """Compare points with each other, and landings with the endings."""
        warn = self._sheet.warn
        landing, contact = points["landing"], points["contact"]
        met = np.r_[[[np.nan] * 2], -landing[:-1]]  # seen by the player who met the shuttle there
        met[self._first] = np.nan
        for other, limit, text in ((met, _APART, "where the stroke before was met"), (points["striker"], _REACH, "the striker")):
            far = np.hypot(*(contact - other).T) > limit
            warn(np.flatnonzero(far), f"the contact point is more than {limit:g} m from {text}")
        inside, over = court.in_court(*landing.astype(np.float32).T), landing[:, 1] > REACH_OVER
        known = ~np.isnan(landing[:, 1])
        out, short = reason == REASONS.index("out"), np.isin(reason, [REASONS.index("net"), REASONS.index("short")])
        for wrong, text in (
            (out & inside, "out, and the landing point lies in court"),
            (short & over, "net or short, and the landing point lies beyond the net"),
            ((outcome == Outcome.WINNER) & ~inside, "a winner, and the landing point lies outside the court"),
        ):
            warn(np.flatnonzero(known & wrong), text)
        returned = known & (outcome == Outcome.RETURNED)
        if returned.sum() > 2 and (returned & ~inside).sum() > returned.sum() / 3:
            text = "a third of the returned strokes were met outside the court: are x and y metres from the middle of the net?"
            self._sheet.warnings.append(Problem(self._sheet.path, text))

    def _disciplines(self, player: npt.NDArray[Any], opponent: npt.NDArray[Any]) -> npt.NDArray[Any]:
        known = [{discipline_of(a), discipline_of(b)} - {None} for a, b in zip(player, opponent, strict=True)]
        if "discipline" in self._map.columns:
            given = np.array(DISCIPLINES)[np.maximum(self._code("discipline", -1), 0)]
        elif self._map.discipline:
            given = np.full(self._n, self._map.discipline)
        else:
            if self._map.guessed and not any(known):
                self._notes.append(
                    f'the discipline: {DISCIPLINES[0]}; if it is another, set discipline = "{DISCIPLINES[1]}" in a map'
                )
                return np.full(self._n, DISCIPLINES[0])
            for row in [row for row, kinds in enumerate(known) if len(kinds) != 1][:1]:
                self._sheet.mark(
                    row,
                    "unknown discipline, or players of different ones; "
                    f'set discipline = "{DISCIPLINES[0]}" or "{DISCIPLINES[1]}" in the map, or map a column',
                )
            return np.array([min((kind for kind in kinds if kind), default=DISCIPLINES[0]) for kinds in known])
        others = [row for row, kinds in enumerate(known) if kinds - {given[row]}]
        self._sheet.warn(others, "a player of the published matches, who plays another discipline there")
        return given
