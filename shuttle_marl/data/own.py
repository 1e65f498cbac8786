"""Import of a user's matches from a table of strokes, by a :class:`~shuttle_marl.data.words.ColumnMap`.

Nothing is repaired: every invalid value and every broken rule of the schema is reported with its line. What is improbable is a
warning (:mod:`shuttle_marl.data.inference`). What the file lacks is inferred where other values tell it, and marked.
"""

import dataclasses
import functools
import itertools
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl import __version__
from shuttle_marl.base.arrays import F64, I64, Array, Bools
from shuttle_marl.base.files import content_hash
from shuttle_marl.data import inference, readers, schema
from shuttle_marl.data.hands import area_inferred, hands_of, unknown_hands, with_hands
from shuttle_marl.data.inference import disciplines, hands_given, names_of_matches, players_of, spelled
from shuttle_marl.data.matches import copies, with_rules
from shuttle_marl.data.schema import RANGES, REASONS, Account, Cleaned, DataError, Outcome, Problem, shown
from shuttle_marl.data.sheet import Sheet, listed
from shuttle_marl.data.upstream import date_of, player_id
from shuttle_marl.data.words import COLUMNS, FAULTS, STOPS, WINNERS, WORDS, ColumnMap, Words
from shuttle_marl.game import court
from shuttle_marl.game.scoring import RULES, Rules, RulesName, Score
from shuttle_marl.game.stroke import N_SERVES, SHOTS

_BARE_SERVE: Final = WORDS["shot"].index("serve")
_SERVES: Final = (*range(N_SERVES), _BARE_SERVE)
_ENDINGS: Final = WORDS["ending"]
_LET: Final = _ENDINGS.index("let")
_UNFORCED, _FORCED = (_ENDINGS.index(word) for word in ("unforced-error", "forced-error"))
_FAULTS, _WINNERS = ([_ENDINGS.index(word) for word in words] for words in (FAULTS, WINNERS))
_REASON: Final = np.array([REASONS.index(word if word in REASONS else "unknown") for word in _ENDINGS])
_NOBODYS: Final = "the rally in which the match was stopped, which nobody won; expected"
_UNSAID: Final = REASONS.index("unknown")
_MOST_MATCHES: Final = 10_000
_SHORTEST: Final = min(rules.points for rules in RULES.values())


class Rallies:
    """Where each of the n rows of a sheet belongs; all attributes are ``[n]``.

    Attributes:
        fresh, first, last: whether a row begins a game, and begins and ends a rally.
        start, group: first row of the game, and number of the rally in the file, from 0.
        stopped: rows of rallies in which a match was stopped.
        reply: whether the next row is the next stroke.
        shot: shot types, -1 not known; ``inferred_serve``: whether the reply told that of a serve.
        ending: words for the ends of rallies, indices into those of the map.
    """

    def __init__(self, sheet: Sheet) -> None:
        self.sheet, self.match = sheet, names_of_matches(sheet)
        self.game, shot = _numbers(sheet, "game"), sheet.words("shot")
        known, match = np.unique(self.match, return_inverse=True)
        if len(known) > _MOST_MATCHES:
            raise DataError(sheet.path, f"{len(known):,} matches, more than {_MOST_MATCHES:,}; divide the file")
        self.fresh = inference.changes(match, self.game)
        self.start = np.flatnonzero(self.fresh)[np.cumsum(self.fresh) - 1]
        self.rally = self._of_game(_numbers(sheet, "rally")) if "rally" in sheet else self._numbered(shot)
        self.first = self.fresh | inference.changes(self.rally)
        self.last = np.r_[self.first[1:], True]
        self.group = np.cumsum(self.first) - 1
        if {"rally", "stroke", "seconds", "frame"} & sheet.map.columns.keys():
            rows = zip(*map(sheet.text, sheet.map.columns), strict=True)
            sheet.mark(1 + np.flatnonzero([a == b for a, b in itertools.pairwise(rows)]), "duplicate of the row before")
        self.stroke = self._strokes(shot)
        self.reply = np.r_[~self.first[1:] & (np.diff(self.stroke) == 1), False]
        self.inferred_serve = shot == _BARE_SERVE
        self.shot = np.where(self.inferred_serve, np.isin(self.following(shot), inference.LONG_REPLIES), shot)
        self.ending = sheet.words("ending", 0)
        stops = np.isin(self.ending, [_ENDINGS.index(word) for word in STOPS])
        self.stopped = np.isin(self.group, self.group[stops])
        ends = dict(zip(self.match.tolist(), self.group.tolist(), strict=True))  # last rally of each match
        for row in np.flatnonzero(stops).tolist():
            told = f"match {str(self.match[row])!r} was not finished: {_ENDINGS[self.ending[row]]}"
            sheet.notes += [told] if told not in sheet.notes else []
            if ends[self.match[row]] > self.group[row]:
                asked = "this ends a match, and rallies of it follow; remove them, or give the rally another ending"
                sheet.mark(row, f"ending {_ENDINGS[self.ending[row]]!r}; {asked}")
            self.ending[row] = _ENDINGS.index("unknown")
        self.player, self.opponent = players_of(sheet, self.match)

    def __len__(self) -> int:
        """Number of rallies."""
        return int(self.first.sum())

    def following(self, values: I64) -> I64:
        """``[n]`` values of the next strokes, -1 without one."""
        return np.where(self.reply, np.r_[values[1:], -1], -1)

    def wrong(self) -> Bools:
        """``[n]`` rows of the rallies with problems."""
        return np.isin(self.group, self.group[self.sheet.unreadable])

    def without_lets(self) -> Sheet | None:
        """The sheet without rallies that were replayed, which do not count as rallies of their games; None: there are none."""
        let = self.ending == _LET
        if not let.any():
            return None
        after_let = np.r_[False, let[:-1]]
        part = np.cumsum(self.first | after_let)  # the replay may have the same number
        kept = ~np.isin(part, part[let])
        counted = np.cumsum(~self.fresh & after_let & (np.diff(self.rally, prepend=0) > 0))
        number = self.rally - counted + counted[self.start]
        sheet = self.sheet.take(kept)
        if "rally" in sheet:
            sheet.columns[sheet.named("rally")] = tuple(map(str, number[kept].tolist()))
        return sheet

    def _of_game(self, number: I64) -> I64:
        """Numbers of rallies in their games, of those in a file that may run on through the games of a match."""
        later = np.flatnonzero(self.fresh & ~inference.changes(self.match))
        before = number[later - 1]
        if not len(later) or before.min() < _SHORTEST or (number[later] != before + 1).any():
            return number
        self.sheet.inferred = [*self.sheet.inferred, "rallies, from 1 in each game: in the file they run on through a match"]
        return number - np.where(np.isin(self.start, later), number[self.start - 1], 0)

    def _numbered(self, shot: I64) -> I64:
        """Numbers of rallies in their games: each begins with a serve, or after a pause."""
        sheet, begins, pause = self.sheet, np.isin(shot, _SERVES), ""
        if "seconds" in sheet:
            passed = np.diff(sheet.numbers("seconds"), prepend=np.nan)
            inference.check_tempo(sheet, passed[~(self.fresh | begins)])
            begins |= passed > inference.PAUSE
            pause = f", or after a pause of {inference.PAUSE:g} s"
        sheet.notes.append(f"where rallies begin: with each serve{pause}")
        number = np.cumsum(begins | self.fresh)
        return number - number[self.start] + 1

    def _strokes(self, shot: I64) -> I64:
        """Numbers of strokes in their rallies; in files of programs one is missing where a player strikes twice in a row."""
        sheet, n = self.sheet, len(shot)
        if "stroke" in sheet:
            return _numbers(sheet, "stroke")
        start = np.flatnonzero(self.first)[self.group]
        if sheet.strict:
            return np.arange(n) - start + 1
        player = np.array(sheet.text("player"))
        again = np.r_[False, player[1:] == player[:-1]]
        if twice := int((again & ~self.first).sum()):
            sheet.notes.append(f"a stroke is missing where a player strikes twice in a row: {twice:,} times")
        served = np.isin(shot, [-1, WORDS["shot"].index("unknown"), *_SERVES])
        step = np.cumsum(np.where(again, 2, 1))
        return step - step[start] + np.where(served[start], 1, 2)

    @functools.cached_property
    def side(self) -> I64:
        """``[n]`` 0 for strokes of who struck first in the game, 1 for the other player."""
        return (self.player != self.player[self.start]).astype(np.int64)

    @functools.cached_property
    def deciders(self) -> tuple[I64, I64, I64]:
        """``[R]`` side that won each rally by the column of winners; that serves next; and by these and endings; -1 not known."""
        told, serves, ending, striker = _winners(self), _serves_next(self), self.ending[self.last], self.side[self.last]
        by_ending = np.select([np.isin(ending, _FAULTS), np.isin(ending, _WINNERS)], [1 - striker, striker], serves)
        return told, serves, np.where(told < 0, by_ending, told)


def _numbers(sheet: Sheet, name: str) -> I64:
    """``[n]`` numbers of games, rallies or strokes; 1 without the column."""
    return sheet.integers(name, *RANGES[name], missing=1)


def results(rallies: Rallies) -> tuple[dict[str, Array], Array]:
    """``[n]`` outcome, reason, forced and points by column of the schema, and whether who serves next told the outcome."""
    sheet, ending, last = rallies.sheet, rallies.ending, rallies.last
    points = {name: sheet.bounded(name, *RANGES[name]) for name in ("points", "points_opponent")}
    winner, serves, known = rallies.deciders
    after, by_score = np.stack([*points.values()], axis=1), np.full(len(rallies), -1)
    after = np.where(rallies.side[:, None] == 0, after, after[:, ::-1])[rallies.first]
    if "score" in sheet:
        after, by_score = _by_score(rallies, known)
        both, rows = after[rallies.group], np.arange(len(sheet))
        points = {"points": both[rows, rallies.side], "points_opponent": both[rows, 1 - rallies.side]}
    before = np.r_[np.zeros((1, 2)), after[:-1]]
    before[rallies.fresh[rallies.first]] = 0
    risen = rallies.stopped[rallies.first] & (after > before).any(axis=1)
    sheet.warn(np.flatnonzero(last)[risen], f"points rise in {_NOBODYS} those before it")
    _fill(by_score, after, rallies, known)
    winner = np.where(winner < 0, by_score, winner)
    winner[rallies.stopped[rallies.first]] = -1  # nobody won it, whatever the points are
    won, by_server = _of_row(rallies, winner), _of_row(rallies, serves)
    fault, landed = np.isin(ending, _FAULTS), np.isin(ending, _WINNERS)
    undecided, unsaid = last & ~fault & ~landed, ending != _ENDINGS.index("unknown")
    inferred = undecided & ~rallies.stopped & (won < 0)
    if sheet.strict and ("ending" in sheet or "winner" in sheet) and "score" not in sheet:
        rows = np.flatnonzero(inferred & unsaid & ~rallies.wrong())
        sheet.mark(rows, "the last stroke of its rally has neither an ending nor a winner; use unknown if neither is known")
        inferred &= ~unsaid
    inferred &= by_server >= 0
    won = np.where(inferred, by_server, won)
    for row in np.flatnonzero(~last & (ending > 0)):
        sheet.mark(row, f"ending {_ENDINGS[ending[row]]!r} of a stroke that is not the last of its rally")
    for row in np.flatnonzero(last & ((fault & (won == 1)) | (landed & (won == 0)))):
        sheet.mark(row, f"ending {_ENDINGS[ending[row]]!r} contradicts who won the rally")
    by_winner = np.select([won == 1, won == 0], [Outcome.WINNER, Outcome.FAULT], Outcome.UNKNOWN)
    outcome = np.select([undecided, fault, landed], [by_winner, Outcome.FAULT, Outcome.WINNER], Outcome.RETURNED)
    if sheet.strict and "ending" in sheet:
        sheet.warn(undecided & unsaid & (won >= 0), "the last stroke of its rally has no ending, only a winner")
    if n := int((last & ~rallies.stopped & (outcome == Outcome.UNKNOWN)).sum()):
        sheet.doubt(f"who won is not known of {n} of {len(rallies)} rallies")
    forced = np.select([ending == _UNFORCED, ending == _FORCED], [0, 1], sheet.words("forced"))
    values: dict[str, Any] = {
        "outcome": outcome,
        "reason": np.where(rallies.stopped & last, REASONS.index("stopped"), np.where(undecided, _UNSAID, _REASON[ending])),
        "forced": np.ma.masked_where(forced < 0, forced == 1),
        **points,
    }
    return values, inferred


def _winners(rallies: Rallies) -> I64:
    """``[R]`` side that won each rally by the column of winners, -1 not known."""
    sheet, winner_of = rallies.sheet, dict[int, str]()
    names = spelled(sheet, "winner") if "winner" in sheet else ()
    for row, name in enumerate(names):
        both = (rallies.player[row], rallies.opponent[row])
        if name and rallies.stopped[row] and rallies.last[row]:
            sheet.warn([row], f"winner {shown(name)} of {_NOBODYS} no winner")
        if not name or rallies.stopped[row] or both[0] == both[1]:  # the last is reported already
            continue
        if player_id(name) not in both:
            sheet.mark(row, f"winner {shown(name)}; expected one of the players, {' or '.join(both)}")
        elif winner_of.setdefault(int(rallies.group[row]), player_id(name)) != player_id(name):
            sheet.mark(row, f"{shown(name)} contradicts another winner of this rally")
    starters = rallies.player[rallies.start[rallies.first]]
    return np.array([int(winner_of[r] != name) if r in winner_of else -1 for r, name in enumerate(starters)])


def _servers(rallies: Rallies) -> Array:
    return np.where(rallies.stroke % 2 == 1, rallies.player, rallies.opponent)[rallies.first]


def _serves_next(rallies: Rallies) -> I64:
    """``[R]`` side that serves in the next rally, because it won, also in the next game; -1 not known."""
    first = np.flatnonzero(rallies.first)
    fresh, rally, game = rallies.fresh[first], rallies.rally[first], rallies.game[first]
    same = rallies.match[first][1:] == rallies.match[first][:-1]
    followed = same & np.where(fresh[1:], (np.diff(game) == 1) & (rally[1:] == 1), np.diff(rally) == 1)
    starter = rallies.player[rallies.start[first]][:-1]
    return np.r_[np.where(followed, _servers(rallies)[1:] != starter, -1), -1].astype(np.int64)


def _of_row(rallies: Rallies, winner: I64) -> I64:
    """``[n]`` 1 if the striker is of the side that won, 0 if not, -1 unknown."""
    of_row = winner[rallies.group]
    return np.where(of_row < 0, -1, of_row == rallies.side)


def _by_score(rallies: Rallies, told: I64) -> tuple[F64, I64]:
    """``[R, 2]`` points after each rally by the score, NaN not known, and ``[R]`` who won it; ``told``: by other values."""
    sheet, first = rallies.sheet, np.flatnonzero(rallies.first)
    new_match, starters = inference.changes(rallies.match), rallies.player[rallies.start[first]]
    of_match = np.flatnonzero(new_match)[np.cumsum(new_match) - 1][first]
    began = (rallies.player[of_match] != starters).astype(np.int64)
    match, scores = np.unique(rallies.match[first], return_inverse=True)[1], _scores(sheet, rallies)
    server = (_servers(rallies) != starters).astype(np.int64)
    after, winner, reading = inference.winners_by_score(scores, rallies.fresh[first], server, told, began, match)
    if reading:
        sheet.notes.append(reading)
    else:
        sheet.add("the score does not tell whose points are first, or whether it is that before the rally; add a winner")
    known = ~np.isnan(scores[:, 0])
    falls = (np.diff(rallies.start[first][known]) == 0) & (np.diff(scores[known].sum(axis=1)) < 0)
    if "game" not in sheet and falls.any():
        sheet.add("the score falls, so there are several games: number them in a column")
    return after, winner


def _fill(winner: I64, points: F64, rallies: Rallies, told: I64) -> None:
    """Fill in winners ``[R]`` that are not known: two known scores tell who won between them where one player did."""
    start, since = np.zeros(2), list[int]()
    for r, (fresh, after) in enumerate(zip(rallies.fresh[rallies.first], points, strict=True)):
        start, since = (np.zeros(2), [r]) if fresh else (start, [*since, r])
        if not np.isnan(after).any():
            known = np.where(winner[since] < 0, told[since], winner[since])
            gained = after - start - [(known == who).sum() for who in (0, 1)]
            if gained.min() == 0 and gained.sum() == (known < 0).sum():
                winner[np.array(since)[known < 0]] = int(gained[1] > 0)
            start, since = after, []


def _scores(sheet: Sheet, rallies: Rallies) -> F64:
    """``[R, 2]`` the score of each rally as it stands there, NaN without one."""
    scores = np.full((len(rallies), 2), np.nan)
    for row, text in enumerate(sheet.text("score")):
        if text.strip() and (score := inference.read_score(text)) is None:
            sheet.mark(row, f"score {shown(text)}; expected points such as 5-3 (did a spreadsheet make it a date?)")
        elif text.strip():
            if (np.abs(scores[rallies.group[row]] - score) > 0).any():
                sheet.warn([row], inference.OTHER_SCORE)
            scores[rallies.group[row]] = score
    return scores


_ABOVE: Final = [SHOTS.index(name) for name in ("clear", "drop", "smash", "half-smash", "net-kill")]
_COUNTED, _GAME = "rally (counted)", "game (counted)"
INFERRED: Final = {
    "shot": "whether serves are short, from the replies",
    "height": "contact heights, from the shot types",
    "technique": "techniques, taken as forehand",
    "area": "areas, from the next strokes; their confidence is a column",
    "outcome": "who won the rallies, from who serves next",
}
_SHOWN: Final = 30


def import_matches(path: Path, columns: Path | None = None, rules: RulesName | None = None) -> Cleaned:
    """Import matches.

    Args:
        path: file of a format of :mod:`shuttle_marl.data.readers`.
        columns: column map, a TOML file; None: the columns are those that the words of the header mean.
        rules: of the matches; None: those of the map, or else those that the scores tell.

    Raises:
        DataError: an unreadable file, invalid values, or broken rules; with the number of rows that were read.
    """
    given = ColumnMap() if columns is None else ColumnMap.read(columns)
    given = dataclasses.replace(given, rules=rules or given.rules)
    sheet = readers.read(path, given)
    try:
        return clean(sheet, given)
    except DataError as error:
        error.rows = sheet.total
        raise


def clean(sheet: Sheet, given: ColumnMap) -> Cleaned:
    """Check and convert the table of a reader. Rallies that were replayed are dropped; of a file that users cannot correct also
    those with a problem, which is a warning."""
    path, total, rules = sheet.path, sheet.total, cast("RulesName", given.rules) or None
    sheet.map = _mapped(sheet, given)
    sheet.require(sheet.map.columns.values())
    if rules is None and len(named := {*_rules_of(sheet)}) == 1:
        (rules,) = named
        sheet.map = dataclasses.replace(sheet.map, rules=rules or "")
    told, sheet.warnings = sheet.warnings, []
    read = {"source": sheet.map.source, "format": sheet.format, "file": path.name, "sha256": content_hash(sheet.content)}
    unread = [name for name in sheet.header if name and name not in sheet.map.columns.values()]
    told += [Problem(path, words) for words in listed("columns that the map does not name are not read", unread)]
    broken, most, lets, notes, counted = 0, 0, 0, list[str](), list[str]()
    while True:
        rallies = Rallies(sheet)
        if (played := rallies.without_lets()) is not None:
            lets += len(sheet) - len(played)
            sheet = played
            continue
        if (divided := _numbered_games(rallies, rules)) is not None:
            sheet, counted, doubts = divided
            told += [Problem(path, words) for words in doubts]
            continue
        strokes = _strokes_of(sheet, rallies)
        most = max(most, len(rallies))
        if not sheet.problems:
            break
        wrong = rallies.wrong()
        of_file = any(problem.line is None for problem in sheet.problems)
        if sheet.strict or of_file or wrong.all() or not wrong.any():
            advice = (str(path),) if given.file is None else (str(path), "--columns", str(given.file))
            raise DataError.of(sorted(sheet.problems, key=lambda found: found.line or 0), advice=advice)
        told += sheet.problems
        broken += int(wrong.sum())
        sheet.columns[_COUNTED] = tuple(map(str, rallies.rally.tolist()))  # the others keep their numbers
        sheet.map = dataclasses.replace(sheet.map, columns={**sheet.map.columns, "rally": _COUNTED})
        notes = notes or sheet.notes
        sheet = sheet.take(~wrong)
    strokes, hands = with_hands(strokes, path)
    strokes = _seen_by_left_handers(strokes)
    dropped = {
        "empty row": sheet.empty,
        "no stroke": sheet.others,
        "let": lets,
        "broken rally": broken,
        "unknown shot type": len(sheet) - strokes.num_rows,
    }
    lost = [*sheet.lost]
    unknown = int((strokes["area"].is_null().to_numpy() & (strokes["outcome"].to_numpy() != Outcome.FAULT)).sum())
    if unknown:
        lost.append(f"areas of strokes without a known reply: {unknown:,} of {strokes.num_rows:,}")
    names = strokes["match"].unique().to_pylist()
    undated = [name for name in names if date_of(name) is None]
    if undated and len(names) > 1:
        lost.append(f"a date in the names of {len(undated)} of {len(names)} matches, which count in the order of the table")
    strokes, unsure = with_rules(strokes, path, rules)
    told += [Problem(path, words) for words in (*copies(strokes), *unsure)]
    found = sorted([*told, *sheet.warnings], key=lambda problem: problem.line or 0)
    return Cleaned(
        strokes=strokes,
        account=Account.of(strokes, rallies=most, strokes=total, dropped=dropped),
        files=(path,),
        warnings=tuple(str(problem) for problem in schema.grouped(found)),
        provenance={
            **read,
            "inferred": [*dict.fromkeys((*sheet.inferred, *notes, *counted, *sheet.notes, *_inferred(strokes), *hands))],
            "lost": [*lost, *unknown_hands(strokes)],
            "imported_by": f"shuttle_marl {__version__}",
        },
    )


def _mapped(sheet: Sheet, given: ColumnMap) -> ColumnMap:
    """The map of a sheet: the one of the user; without columns, with those that the words of its header mean."""
    given = dataclasses.replace(given, source=given.source or sheet.source)
    if given.columns:
        return given
    words = Words("column", sheet.header)
    found: dict[str, str] = {name: name for name in sheet.header if name in COLUMNS}
    for name in sheet.header:
        meaning = words.meaning(name)
        if meaning is not None and name not in COLUMNS:
            found.setdefault(meaning, name)
    if "shot" not in found and "stroke" in found and not any(map(str.isdigit, sheet.columns[found["stroke"]])):
        found["shot"] = found.pop("stroke")
    if "technique" not in found and "hand" in found:
        told = set(sheet.columns[found["hand"]])
        if any(map(Words("technique", told).meaning, told)):
            found["technique"] = found.pop("hand")
    try:
        return dataclasses.replace(given.with_columns(found), guessed=True)
    except ValueError as error:
        header = ", ".join(map(repr, sheet.header[:_SHOWN]))
        raise DataError(sheet.path, f"{error}, or map your headers with --columns; the header is {header}") from error


def _numbered_games(rallies: Rallies, rules: RulesName | None) -> tuple[Sheet, list[str], list[str]] | None:
    """The sheet with the games that the rules and the winners give, sentences on them, and doubts; None: each match has one."""
    sheet = rallies.sheet
    if {"game", "score", "points"} & sheet.map.columns.keys():
        return None
    first, winner = np.flatnonzero(rallies.first), rallies.deciders[2]
    fresh, number = rallies.fresh[first], rallies.rally[first]
    matches = np.split(winner, np.flatnonzero(fresh)[1:])
    names: list[RulesName] = [*RULES] if rules is None else [rules]
    courses = {name: [_course(won, RULES[name]) for won in matches] for name in names}
    longest = max(map(len, matches))
    usual: RulesName = rules or "21"
    unsure = bool(np.any(~fresh[1:] & ((winner[:-1] < 0) | (np.diff(number) != 1))))
    if not any(scores[-1].finished for scores, _ in courses[usual]) or (unsure and longest <= 2 * RULES[usual].cap - 1):
        return None
    ends = {name: [end for _, end in of_matches] for name, of_matches in courses.items()}
    possible = [name for name in names if None not in ends[name]]
    finished = [any(of_match) for of_match in zip(*ends.values(), strict=True)]  # by some rules
    best = [name for name in possible if all(end or not some for end, some in zip(ends[name], finished, strict=True))]
    usually = [name for name in ("21", "15", "11") if name in best] or best
    if unsure or len(usually) != 1:
        why = "who won some rallies is not known" if unsure else f"by {', '.join(usually) or 'all rules'} they differ"
        why = "their numbers begin again" if np.any(~fresh[1:] & (np.diff(number) < 0)) else why
        sheet.add(f"{longest} rallies are more than one game, and {why}: number the games in a column game, or give --rules")
        return None
    scores = [score for before, _ in courses[usually[0]] for score in before]
    games, played = np.array([[sum(each.games), sum(map(sum, each.finished))] for each in scores])[rallies.group].T
    for column, values in ((_GAME, games + 1), (_COUNTED, rallies.rally - played)):
        sheet.columns[column] = tuple(map(str, values.tolist()))
    sheet.map = dataclasses.replace(sheet.map, columns={**sheet.map.columns, "game": _GAME, "rally": _COUNTED})
    told = f"games, numbered by the rules {usually[0]}: {int((games + 1)[rallies.first & (games > 0)].max(initial=1))} in a match"
    others = [] if usually[0] == "21" else [name for name in possible if name != usually[0]]
    doubts = [f"{told}; by {', '.join(others)} a match is not finished: name them with --rules"] if others else []
    return sheet.take(np.ones(len(sheet), dtype=bool)), [told], doubts


def _course(winners: I64, rules: Rules) -> tuple[list[Score], bool | None]:
    """Scores before the rallies of a match, and whether it may be over after them; None: it goes on after its end; ``winners``:
    side that won each rally, -1 not known."""
    scores = [Score(rules=rules)]
    for side in winners.tolist():
        scores.append(scores[-1].after(side) if side >= 0 else scores[-1])
    *before, after = scores
    ends = [after, *(after.after(side) for side in (0, 1) if winners[-1] < 0)]
    return before, None if before[-1].over else any(end.over for end in ends)


def _rules_of(sheet: Sheet) -> list[RulesName | None]:
    """Rules that a column gives; None: those that the scores tell."""
    return [[*RULES, None][code] for code in sheet.words("rules")]


def _seen_by_left_handers(strokes: pa.Table) -> pa.Table:
    """The table with the inferred areas, which are where right-handers meet the shuttle, mirrored for left-handed receivers."""
    left = [name for name, player in hands_of(strokes).items() if player.hand == court.HANDS.index("left")]
    mirrored = area_inferred(strokes) & pc.is_in(strokes["opponent"], pa.array(left, pa.string())).to_numpy()
    area = strokes["area"].combine_chunks()
    filled = pa.array(court.mirrored(area.fill_null(0).to_numpy(zero_copy_only=False)))
    return schema.changed(strokes, "area", pc.if_else(mirrored, filled, area))


def _strokes_of(sheet: Sheet, rallies: Rallies) -> pa.Table:
    shot, point = rallies.shot, _points(sheet)
    technique, height = sheet.words("technique"), sheet.words("height")
    landed = _areas(sheet, point["landing"])
    met, share = inference.areas_met(rallies.following(shot), rallies.following(technique))
    guessed = (landed < 0) & (met >= 0)
    result, won_by_server = results(rallies)
    marks = {
        "shot": rallies.inferred_serve,
        "height": (height < 0) & ~((shot >= 0) & (shot < N_SERVES)),
        "technique": technique < 0,
        "area": guessed,
        "outcome": won_by_server,
    }
    sure = sheet.bounded("confidence", 0, 1, whole=False)
    landing_x, landing_y = point["landing"].T.astype(np.float32)
    values: dict[str, Any] = {
        "source": np.full(len(sheet), sheet.map.source),
        "discipline": disciplines(sheet, rallies.player, rallies.opponent),
        "rules": _rules_of(sheet),
        **{name: getattr(rallies, name) for name in ("match", "game", "rally", "stroke", "player", "opponent", "shot")},
        "hand": np.ma.masked_less(hands_given(sheet, rallies.player), 0),
        "height": np.where(height >= 0, height, np.isin(shot, _ABOVE)),
        "technique": np.maximum(technique, 0),
        "area": np.ma.masked_less(np.where(guessed, met, landed), 0),
        "in_court": np.ma.masked_where(np.isnan(landing_y), court.in_court(landing_x, landing_y)),
        "clock": np.floor(sheet.bounded("seconds", *RANGES["clock"], whole=False)),
        "frame": sheet.bounded("frame", *RANGES["frame"]),
        **result,
        "confidence": np.where(guessed, np.where(np.isnan(sure), 1.0, sure) * share, sure),
        "inferred": [" ".join(itertools.compress(marks, row)) or None for row in zip(*marks.values(), strict=True)],
    }
    inference.compare(sheet, values, point, rallies.fresh, rallies.first)
    # An unreadable row would cause false problems of the other rows of its rally.
    known = np.flatnonzero((shot < len(SHOTS)) & ~rallies.wrong())
    if not len(known) and not sheet.problems:
        raise DataError(sheet.path, "no stroke of a known shot type")
    strokes = schema.stroke_table(values, point).take(pa.array(known))
    for violation in schema.violations(strokes):
        sheet.mark(known[violation.rows], f"expected: {violation.rule}")
    return strokes


def _points(sheet: Sheet) -> dict[str, F64]:
    """``[n, 2]`` points in the striker's frame, NaN missing."""
    sign = np.where(sheet.words("side") == 1, -1.0, 1.0) if sheet.map.coordinates == "court" else np.ones(len(sheet))
    found = {}
    for name in inference.POINTS:
        found[name] = np.stack([sheet.numbers(f"{name}_{axis}") for axis in "xy"], axis=1) * sign[:, None]
        inference.check_scale(sheet, name, found[name])
    return found


def _areas(sheet: Sheet, landing: F64) -> I64:
    """``[n]`` areas of the landing points, or of the column where there is none."""
    computed = court.area_of(*landing.astype(np.float32).T).astype(np.int64)
    if "area" not in sheet:
        return computed
    named = sheet.words("area")
    if sheet.map.areas_seen_by == "striker":
        named = np.where(named < 0, -1, named + 2 - 2 * (named % 3))
    differ = (computed >= 0) & (named >= 0) & (computed != named)
    sheet.warn(differ, f"{sheet.named('area')} is not the area of the landing point, which is used")
    return np.where(computed >= 0, computed, named)


def _inferred(strokes: pa.Table) -> list[str]:
    words = strokes["inferred"].fill_null("").to_pylist()
    counts = {text: sum(name in word.split() for word in words) for name, text in INFERRED.items()}
    return [f"{text}: {n:,} of {strokes.num_rows:,} strokes" for text, n in counts.items() if n]
