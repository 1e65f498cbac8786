"""Import of a user's matches from a table of strokes, by a :class:`~shuttle_marl.data.column_map.ColumnMap`.

Nothing is repaired: every invalid value and every broken rule of the schema is reported with its line. What is improbable is a
warning (:mod:`shuttle_marl.data.inference`). What the file lacks is inferred where other values tell it, and marked.
"""

import dataclasses
import hashlib
import itertools
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl import __version__
from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.data import inference, readers
from shuttle_marl.data.column_map import FAULTS, PLAYERS, WINNERS, WORDS, ColumnMap, nfc, plain
from shuttle_marl.data.hands import area_inferred, hands_of, unknown_hands, with_hands
from shuttle_marl.data.schema import DISCIPLINES, RANGES, REASONS, Account, Cleaned, Outcome, stroke_table, violations
from shuttle_marl.data.strict_csv import DataError, Problem, Sheet, grouped, shown
from shuttle_marl.data.upstream import discipline as discipline_of
from shuttle_marl.data.upstream import player_id
from shuttle_marl.data.words import Words
from shuttle_marl.game import court
from shuttle_marl.game.stroke import N_SERVES, SHOTS

_ABOVE: Final = [SHOTS.index(name) for name in ("clear", "drop", "smash", "half-smash", "net-kill")]
_ENDINGS: Final = WORDS["ending"]
_FAULTS, _WINNERS = ([_ENDINGS.index(word) for word in words] for words in (FAULTS, WINNERS))
_BARE_SERVE: Final = WORDS["shot"].index("serve")
_MAY_BE_EMPTY: Final = ("area", "ending", "height", "technique", "forced", "hand")
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


def import_matches(path: Path, columns: Path | None = None) -> Cleaned:
    """Import matches.

    Args:
        path: file of a format of :mod:`shuttle_marl.data.readers`.
        columns: column map, a TOML file; None: the columns are those that the words of the header mean.

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


def _imported(path: Path, columns: Path | None, given: ColumnMap, reading: readers.Reading) -> Cleaned:
    sheet = reading.sheet
    mapped = dataclasses.replace(given.filled(sheet), source=given.source or reading.source)
    sheet.require(mapped.columns.values())
    told = list(sheet.warnings)  # of the reader
    sheet.warnings.clear()
    if unread := [repr(name) for name in sheet.header if name and name not in mapped.columns.values()]:
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
            advice = (str(path),) if columns is None else (str(path), "--columns", str(columns))
            raise DataError.of(sorted(sheet.problems, key=lambda found: found.line or 0), advice=advice)
        told += sheet.problems
        broken += int(wrong.sum())
        sheet = sheet.without(wrong)
    strokes, hands = with_hands(strokes, path)
    strokes = _seen_by_left_handers(strokes)
    dropped = {
        "empty row": sheet.empty,
        "no stroke": sheet.others,
        "let": lets,
        "broken rally": broken,
        "unknown shot type": len(sheet) - strokes.num_rows,
    }
    unknown = int((strokes["area"].is_null().to_numpy() & (strokes["outcome"].to_numpy() != Outcome.FAULT)).sum())
    lost = [f"areas of strokes without a known reply: {unknown:,} of {strokes.num_rows:,}"] if unknown else []
    found = sorted([*told, *sheet.warnings], key=lambda problem: problem.line or 0)
    return Cleaned(
        strokes=strokes,
        account=Account.of(strokes, total=reading.sheet.total, rallies=rallies, dropped=dropped),
        files=(path,),
        warnings=tuple(str(problem) for problem in grouped(found)),
        provenance={
            "source": mapped.source,
            "format": reading.format,
            "file": path.name,
            "sha256": hashlib.sha256(sheet.content).hexdigest(),
            "inferred": [*reading.inferred, *own.inferred(strokes), *hands],
            "lost": [*reading.lost, *lost, *unknown_hands(strokes)],
            "imported_by": f"shuttle_marl {__version__}",
        },
    )


def _seen_by_left_handers(strokes: pa.Table) -> pa.Table:
    """The table with the inferred areas, which are where right-handers meet the shuttle, mirrored for left-handed receivers."""
    left = [name for name, player in hands_of(strokes).items() if player.hand == court.HANDS.index("left")]
    mirrored = area_inferred(strokes) & pc.is_in(strokes["opponent"], pa.array(left, pa.string())).to_numpy()
    area, position = strokes["area"].combine_chunks(), strokes.schema.get_field_index("area")
    filled = pa.array(court.mirrored(area.fill_null(0).to_numpy(zero_copy_only=False)))
    return strokes.set_column(position, strokes.schema.field("area"), pc.if_else(mirrored, filled, area))


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
        self._fresh = inference.changes(match, self._game)
        self._start = np.flatnonzero(self._fresh)[np.cumsum(self._fresh) - 1]  # of the game
        self._rally = self._number("rally", 1) if "rally" in mapped.columns else self._numbered(shot)
        self._first = self._fresh | inference.changes(self._rally)
        self._group = np.cumsum(self._first) - 1
        self.rallies = int(self._first.sum())
        self._names: dict[str, str] = {}
        self._alike: dict[str, str] = {}
        inference.warn_alike(sheet, self._alike, self._match.tolist(), "match")
        if {"rally", "stroke", "seconds", "frame"} & mapped.columns.keys():
            rows = zip(*map(sheet.text, mapped.columns.values()), strict=True)
            sheet.mark(1 + np.flatnonzero([a == b for a, b in itertools.pairwise(rows)]), "duplicate of the row before")
        self._stroke = self._strokes(shot)
        self._reply = np.r_[~self._first[1:] & (np.diff(self._stroke) == 1), False]
        self._marks["shot"] = shot == _BARE_SERVE
        self._shot = np.where(self._marks["shot"], np.isin(self._following(shot), inference.LONG_REPLIES), shot)
        self._ending = self._code("ending", 0)

    def _following(self, values: I64) -> I64:
        """``[n]`` values of the next strokes, -1 without one."""
        return np.where(self._reply, np.r_[values[1:], -1], -1)

    def _numbered(self, shot: I64) -> I64:
        """Numbers of rallies in their games: each begins with a serve, or after a pause."""
        begins = np.isin(shot, [*range(N_SERVES), _BARE_SERVE])
        if "seconds" in self._map.columns:
            begins |= np.diff(self._sheet.numbers(self._map.columns["seconds"]), prepend=np.nan) > inference.PAUSE
        self._notes.append(f"where rallies begin: with each serve, or after a pause of {inference.PAUSE:g} s")
        number = np.cumsum(begins | self._fresh)
        return number - number[self._start] + 1

    def _strokes(self, shot: I64) -> I64:
        """Numbers of strokes in their rallies; in files of programs one is missing where a player strikes twice in a row."""
        if "stroke" in self._map.columns:
            return self._number("stroke", 1)
        start = np.flatnonzero(self._first)[self._group]
        if self._strict:
            return np.arange(self._n) - start + 1
        player = np.array(self._sheet.text(self._map.columns["player"]))
        again = np.r_[False, player[1:] == player[:-1]]
        if twice := int((again & ~self._first).sum()):
            self._notes.append(f"a stroke is missing where a player strikes twice in a row: {twice:,} times")
        served = np.isin(shot, [-1, *range(N_SERVES), WORDS["shot"].index("unknown"), _BARE_SERVE])
        step = np.cumsum(np.where(again, 2, 1))
        return step - step[start] + np.where(served[start], 1, 2)

    def wrong(self) -> Bools:
        """``[n]`` rows of the rallies with problems."""
        return np.isin(self._group, self._group[self._sheet.unreadable])

    def without_lets(self) -> Sheet | None:
        """The sheet without rallies that were replayed, which do not count as rallies of their games; None: there are none."""
        let = self._ending == _ENDINGS.index("let")
        if not let.any():
            return None
        after_let = np.r_[False, let[:-1]]
        part = np.cumsum(self._first | after_let)  # the replay may have the same number
        kept = ~np.isin(part, part[let])
        counted = np.cumsum(~self._fresh & after_let & (np.diff(self._rally, prepend=0) > 0))
        number = self._rally - counted + counted[self._start]
        sheet = self._sheet.without(~kept)
        if "rally" in self._map.columns:
            sheet.columns[self._map.columns["rally"]] = tuple(map(str, number[kept].tolist()))
        return sheet

    def inferred(self, strokes: pa.Table) -> list[str]:
        """Sentences on what was inferred, with the numbers of kept strokes."""
        words = strokes["inferred"].fill_null("").to_pylist()
        counts = {text: sum(name in word.split() for word in words) for name, text in INFERRED.items()}
        return [*self._notes, *(f"{text}: {n:,} of {strokes.num_rows:,} strokes" for text, n in counts.items() if n)]

    def table(self) -> pa.Table:
        """The strokes of known types of the rallies without unreadable rows."""
        sheet, shot, ending = self._sheet, self._shot, self._ending
        player, opponent = self._players()
        points = self._points()
        technique = self._code("technique", -1)
        landed = self._areas(points["landing"])
        met, share = inference.areas_met(self._following(shot), self._following(technique))
        guessed = (landed < 0) & (met >= 0)
        scored, after = self._scores(player)
        outcome, reason = self._outcomes(player, opponent, scored)
        forced = self._code("forced", -1)
        for word, code in (("unforced-error", 0), ("forced-error", 1)):
            forced = np.where(ending == _ENDINGS.index(word), code, forced)
        discipline = self._disciplines(player, opponent)
        height = self._code("height", -1)
        unsaid = (height < 0) & ~((shot >= 0) & (shot < N_SERVES))
        self._marks |= {"technique": technique < 0, "area": guessed, "height": unsaid}
        sure = np.full(self._n, np.nan)
        if "confidence" in self._map.columns:
            sure = sheet.numbers(self._map.columns["confidence"])
            for row in np.flatnonzero((sure < 0) | (sure > 1)):
                sheet.mark(row, f"{self._map.columns['confidence']} {sure[row]:g}; expected 0 to 1")
        names = [name for name in INFERRED if name in self._marks]
        marks = zip(*(self._marks[name] for name in names), strict=True)
        landing_x, landing_y = points["landing"].T.astype(np.float32)
        columns: dict[str, Any] = {
            "match": self._match,
            "source": np.full(self._n, self._map.source),
            "discipline": discipline,
            "game": self._game,
            "rally": self._rally,
            "stroke": self._stroke,
            "player": player,
            "opponent": opponent,
            "hand": np.ma.masked_less(self._hands(player), 0),
            "shot": shot,
            "height": np.where(height >= 0, height, np.isin(shot, _ABOVE)),
            "technique": np.maximum(technique, 0),
            "area": np.ma.masked_less(np.where(guessed, met, landed), 0),
            "in_court": np.ma.masked_where(np.isnan(landing_y), court.in_court(landing_x, landing_y)),
            "clock": self._optional("seconds", "clock"),
            "frame": self._optional("frame", "frame"),
            "outcome": outcome,
            "reason": reason,
            "points": self._optional("points", "points"),
            "points_opponent": self._optional("points_opponent", "points_opponent"),
            **after,
            "forced": np.ma.masked_where(forced < 0, forced == 1),
            "confidence": np.where(guessed, np.where(np.isnan(sure), 1.0, sure) * share, sure),
            "inferred": [" ".join(itertools.compress(names, row)) or None for row in marks],
        }
        inference.compare(sheet, self._map.columns, columns, points, self._code("side", 0))
        # An unreadable row would cause false problems of the other rows of its rally.
        known = np.flatnonzero((shot < len(SHOTS)) & ~self.wrong())
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

    def _optional(self, name: str, field: str) -> F64:
        """``[n]`` whole numbers, NaN where there is none."""
        if name not in self._map.columns:
            return np.full(self._n, np.nan)
        values = self._sheet.numbers(self._map.columns[name])
        low, high = RANGES[field]
        # Times may have fractions, which the table does not keep.
        fine = (values >= low) & (values <= high) & ((name == "seconds") | (values == np.floor(values)))
        for row in np.flatnonzero(~fine & ~np.isnan(values)):
            self._sheet.mark(row, f"{self._map.columns[name]} {values[row]:g}; expected a whole number from {low} to {high}")
        return np.where(fine, np.floor(values), np.nan)

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
        inference.warn_alike(self._sheet, self._alike, names, "player")
        return np.array([player_id(value) for value in names], dtype=object)

    def _hands(self, player: npt.NDArray[Any]) -> I64:
        """Hands of the column, -1 not given; a player has one."""
        hand, of_player = self._code("hand", -1), dict[str, int]()
        for row in np.flatnonzero(hand >= 0):
            if of_player.setdefault(player[row], hand[row]) != hand[row]:
                self._sheet.mark(row, f"{player[row]} is {court.HANDS[hand[row]]}-handed here, and not above; expected one hand")
        return np.array([of_player.get(name, -1) for name in player])

    def _points(self) -> dict[str, F64]:
        """``[n, 2]`` points in the striker's frame, NaN missing."""
        sign = np.ones(self._n)
        if self._map.coordinates == "court":
            sign = np.where(self._code("side", 0) == 1, -1.0, 1.0)
        points = {}
        for name in inference.POINTS:
            columns = [self._map.columns.get(f"{name}_{axis}") for axis in "xy"]
            values = [np.full(self._n, np.nan) if column is None else self._sheet.numbers(column) for column in columns]
            points[name] = np.stack(values, axis=1) * sign[:, None]
            inference.check_scale(self._sheet, name, points[name])
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

    def _scores(self, player: npt.NDArray[Any]) -> tuple[I64, dict[str, F64]]:
        """``[n]`` 1 if the striker won the rally by the score, or by who serves next, 0 if not, -1 unknown; points after it."""
        first = np.flatnonzero(self._first)
        last, fresh = np.r_[first[1:], self._n] - 1, self._fresh[first]
        side = (player != player[self._start]).astype(np.int64)
        server = np.where(self._stroke[first] % 2 == 1, side[first], 1 - side[first])
        after: dict[str, F64] = {}
        winner = np.full(len(first), -1)
        following = np.where(np.r_[fresh[1:], True], -1, np.r_[server[1:], -1])  # who won serves next
        if "score" in self._map.columns:
            fault, won_by = (np.isin(self._ending[last], group) for group in (_FAULTS, _WINNERS))
            told = np.select([fault, won_by], [1 - side[last], side[last]], following)
            scores: list[tuple[int, int] | None] = [None] * len(first)
            for row, text in enumerate(self._sheet.text(self._map.columns["score"])):
                if text.strip() and (score := inference.read_score(text)) is None:
                    self._sheet.mark(row, f"score {shown(text)}; expected points such as 5-3 (did a spreadsheet make it a date?)")
                elif text.strip():
                    if scores[self._group[row]] not in (None, score):
                        self._sheet.warn([row], inference.OTHER_SCORE)
                    scores[self._group[row]] = score
            points, won, reading = inference.winners_by_score(scores, fresh, server.tolist(), told.tolist())
            self._notes.append(reading)
            winner = np.array(won)
            both = np.array([(np.nan, np.nan) if pair is None else pair for pair in points])[self._group]
            rows = np.arange(self._n)
            after = {"points": both[rows, side], "points_opponent": both[rows, 1 - side]}
        elif not {"ending", "winner"} & self._map.columns.keys():
            winner = following
            self._marks["outcome"] = np.isin(np.arange(self._n), last[winner >= 0])
        of_row = winner[self._group]
        return np.where(of_row < 0, -1, of_row == side), after

    def _outcomes(self, player: npt.NDArray[Any], opponent: npt.NDArray[Any], scored: I64) -> tuple[I64, I64]:
        """Outcome and reason of each stroke, from the endings and winners of rallies."""
        last, ending = np.r_[self._first[1:], True], self._ending
        for row in np.flatnonzero(~last & (ending > 0)):
            self._sheet.mark(row, f"ending {_ENDINGS[ending[row]]!r} of a stroke that is not the last of its rally")
        won = self._won(player, opponent)
        won = np.where(won < 0, scored, won)
        fault, winner = np.isin(ending, _FAULTS), np.isin(ending, _WINNERS)
        for row in np.flatnonzero(last & ((fault & (won == 1)) | (winner & (won == 0)))):
            self._sheet.mark(row, f"ending {_ENDINGS[ending[row]]!r} contradicts who won the rally")
        undecided = last & ~fault & ~winner
        by_winner = np.select([won == 1, won == 0], [Outcome.WINNER, Outcome.FAULT], Outcome.UNKNOWN)
        outcome = np.select([undecided, fault, winner], [by_winner, Outcome.FAULT, Outcome.WINNER], Outcome.RETURNED)
        unsaid = undecided & (ending != _ENDINGS.index("unknown"))
        if self._strict and "ending" in self._map.columns:
            rows = np.flatnonzero(unsaid & (won >= 0))
            self._sheet.warn(rows, "the last stroke of its rally has no ending, only a winner")
        if self._strict and {"ending", "winner"} & self._map.columns.keys():
            rows = np.flatnonzero(unsaid & (won < 0) & ~self.wrong())
            text = "the last stroke of its rally has neither an ending nor a winner; use unknown if neither is known"
            self._sheet.mark(rows, text)
        reason = np.array([REASONS.index(word if word in REASONS else "unknown") for word in _ENDINGS])[ending]
        return outcome, np.where(undecided, REASONS.index("unknown"), reason)

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

    def _disciplines(self, player: npt.NDArray[Any], opponent: npt.NDArray[Any]) -> npt.NDArray[Any]:
        known = [{discipline_of(a), discipline_of(b)} - {None} for a, b in zip(player, opponent, strict=True)]
        if "discipline" in self._map.columns:
            given = np.array(DISCIPLINES)[np.maximum(self._code("discipline", -1), 0)]
        elif self._map.discipline:
            given = np.full(self._n, self._map.discipline)
        elif self._map.guessed and not any(known):
            self._notes.append(
                f'the discipline: {DISCIPLINES[0]}; if it is another, set discipline = "{DISCIPLINES[1]}" in a map'
            )
            return np.full(self._n, DISCIPLINES[0])
        else:
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
