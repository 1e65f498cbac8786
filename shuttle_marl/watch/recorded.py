"""Recorded rallies: of a rally log, and of annotated matches."""

import abc
import dataclasses
import datetime
import itertools
import threading
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import I64
from shuttle_marl.base.errors import printable
from shuttle_marl.data import read_matches
from shuttle_marl.data.schema import Outcome
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.hurried import hurry_of, marked_rows
from shuttle_marl.game.court import HANDS, seen_by, steps_between
from shuttle_marl.game.draws import stream
from shuttle_marl.game.pairs import game_of_people, looks_of
from shuttle_marl.game.recovery import position_of
from shuttle_marl.game.rules import FAULT, WINNER, IllegalStrokeError
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.stroke import N_SERVES
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.reports.rally import LogPlayers, Players, legal_states
from shuttle_marl.scene.rally_report import staging_key
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.match import CourtRally
from shuttle_marl.watch.messages import RecordedMatch
from shuttle_marl.watch.policies import OnceCache

_MAX_MATCHES: Final = 16
_FAR: Final = 1000
"""Distance of a stroke of another shot type; larger than any of area and technique."""


class People(NamedTuple):
    """The people who played a real rally."""

    names: tuple[str, str]
    """At seats 0 and 1."""
    date: datetime.date | None
    """Of the match; None: unknown."""


class Recorded(abc.ABC):
    """Rallies by number, from 0.

    Attributes:
        matches: the annotated matches; none of a log.
    """

    title: str
    count: int
    matches: list[RecordedMatch]

    @abc.abstractmethod
    def rally(self, number: int) -> CourtRally:
        """A rally.

        Raises:
            ShuttleError: the rally does not exist, or it cannot be shown.
        """

    @abc.abstractmethod
    def match(self, number: int) -> str | tuple[int, int]:
        """Match of a rally: its name in annotated matches, or numbers of pairing and match of a log."""

    def players(self, number: int) -> Players | None:  # noqa: ARG002
        """Policies of a rally; None: unknown."""
        return None

    def people(self, number: int) -> People | None:  # noqa: ARG002
        """The people who played a real rally; None: policies played."""
        return None


class LogRallies(Recorded):
    """The rallies of a log.

    Policies named by the log are resolved without running code, and used only if their table is the one that played.

    Raises:
        RecordingError: the log cannot be read, or was played on another game.
    """

    def __init__(self, path: Path, game: Game) -> None:
        self._log, self._game = RallyLog(path), game
        self._lock = threading.RLock()  # a log is one open file, and requests are answered by several threads
        self._players, self._games = LogPlayers(self._log, game), OnceCache(_MAX_MATCHES)
        self.title, self.count, self.matches = printable(path.name), self._log.n_rallies, []

    def rally(self, number: int) -> CourtRally:
        """A rally; see :class:`Recorded`."""
        with self._lock:
            return self._rally(number)

    def _rally(self, number: int) -> CourtRally:
        found = self._log.rally(number)
        header = self._log.files[self._log.file_of(number)].header
        rally = found.row(0, self._log.catalogue, header.rules).checked()
        try:
            legal_states(rally, self._game)
        except IllegalStrokeError as error:
            raise WatchError(f"rally {number + 1}: {error}") from error
        first, second = (self._log.policies[int(policy)] for policy in found.policy[0])
        match = int(found.pairing[0]), int(found.match[0])
        games: dict[int, tuple[int, int]] = self._games.get(match, lambda: self._log.points_of_games(*match))
        finished = tuple(points for game, points in games.items() if game < sum(rally.games))
        return CourtRally.at(
            Score(points=rally.points, games=rally.games, finished=finished, server=rally.server, rules=header.rules),
            catalogue=self._game.catalogue,
            stroke=rally.stroke,
            hurried=rally.hurried,
            waited=rally.waited,
            ending=rally.ending,
            number=number,
            names=(printable(first.name), printable(second.name)),
            **looks_of(self._game, (first.name, second.name))._asdict(),
            key=staging_key(header, found),
        )

    def players(self, number: int) -> Players | None:
        """Players of a rally; see :class:`Recorded`."""
        with self._lock:
            found = self._players.of_rally(number)
        return None if found.value is None else found

    def match(self, number: int) -> tuple[int, int]:
        """Numbers of pairing and match of a rally."""
        with self._lock:
            found = self._log.rally(number)
        return int(found.pairing[0]), int(found.match[0])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class _Annotated:
    players: tuple[str, str]
    score: Score
    rows: I64


def nearest_stroke(game: Game, state: int, shot: int, technique: int, area: int | None, receiver: str = "right") -> int:
    """The legal stroke nearest to an annotated one: by shot type, then technique, then area.

    Args:
        area: as the receiver sees it; None: not known.
        receiver: hand of the receiver.
    """
    legal, catalogue = game.legal_strokes(state), game.catalogue
    distance = _FAR * (catalogue.shot[legal] != shot) + 10.0 * (catalogue.technique[legal] != technique)
    if area is not None:
        distance = distance + steps_between(catalogue.area[legal].astype(int), seen_by(receiver, area))
    return int(legal[int(distance.argmin())])


class RealRallies(Recorded):
    """The rallies of annotated matches, as strokes of the game.

    An annotated stroke is shown as the nearest legal stroke: same contact, then shot type, technique and area. Who was hurried
    says the table, or else the index of the model. Flight times and landing points are staged as for every rally. A player whose
    hand is not known plays with the right one.

    Args:
        path: a stroke table, or a folder with the raw files.
        strokes: the strokes, if they are read already.

    Raises:
        DataError: it cannot be read.
        WatchError: it holds no whole rally.
    """

    def __init__(self, path: Path, game: Game, strokes: pa.Table | None = None) -> None:
        table = read_matches(path) if strokes is None else strokes
        self._game = game
        self._columns = {name: table[name].combine_chunks().to_numpy(zero_copy_only=False) for name in table.column_names}
        rows = marked_rows(table, hurry_of(game.seats[0]))
        self._columns["hurried"] = rows.hurried > 0
        self._columns["waited"] = np.where(np.isfinite(rows.waiting).all(axis=1), position_of(*rows.waiting.T), -1)
        hand = self._columns["hand"]
        self._hands = {str(self._columns["player"][row]): HANDS[int(hand[row])] for row in np.flatnonzero(~np.isnan(hand))}
        self._rallies = list(self._found())
        if not self._rallies:
            raise WatchError(f"{printable(str(path))}: holds no whole rally")
        self.title, self.count = printable(path.name), len(self._rallies)
        names = [self.match(number) for number in range(self.count)]
        firsts = [number for number in range(self.count) if number == 0 or names[number] != names[number - 1]]
        self.matches = [self._described(first, end) for first, end in itertools.pairwise([*firsts, self.count])]

    def _described(self, first: int, end: int) -> RecordedMatch:
        name, last = self.match(first), self._rallies[end - 1]
        players, date = last.players, date_of(name)
        # Every rally but the last one is a point of a score.
        played = sum(map(sum, last.score.finished)) + sum(last.score.points) + 1
        return RecordedMatch(
            first=first,
            title=printable(_event(name, players)),
            names=(printable(players[0]), printable(players[1])),
            date=None if date is None else date.isoformat(),
            missing=max(0, played - (end - first)),
        )

    def numbers(self, match: str) -> dict[tuple[int, int], int]:
        """Numbers of the rallies of a match, by their game and number in the data."""
        column = self._columns
        starts = [found.rows[0] for found in self._rallies]
        return {
            (int(column["game"][row]), int(column["rally"][row])): number
            for number, row in enumerate(starts)
            if column["match"][row] == match
        }

    def people(self, number: int) -> People | None:
        """The people who played; see :class:`Recorded`."""
        return People(self._at(number).players, date_of(self.match(number)))

    def match(self, number: int) -> str:
        """Name of the match of a rally.

        Raises:
            WatchError: the rally does not exist.
        """
        return str(self._columns["match"][self._at(number).rows[0]])

    def _game_of(self, number: int) -> Game:
        """The tables in which a rally is valued: those of its two people, whose hands may differ, if the model knows them."""
        people = self.people(number)
        known = None if people is None else game_of_people(self._game, people.names, people.date)
        return self._game if known is None else known.seats[0]

    def _at(self, number: int) -> _Annotated:
        if not 0 <= number < self.count:
            raise WatchError(f"no rally {number + 1}: there are {self.count:,}")
        return self._rallies[number]

    def rally(self, number: int) -> CourtRally:
        """A rally; see :class:`Recorded`."""
        found, column = self._at(number), self._columns
        strokes: list[int] = []
        state, game = ROOT, self._game_of(number)
        first, second = (self._hands.get(player, "right") for player in found.players)
        waited = column["waited"][found.rows]
        athlete = "female" if column["discipline"][found.rows[0]] == "WS" else "male"
        for row in found.rows.tolist():
            if strokes:
                arrivals = game.arrivals(game.pair(state, np.array(strokes[-1:])))[0]
                state = int(arrivals[2 * int(column["hurried"][row]) + int(column["height"][row])])
            shot, technique, area = (column[name][row] for name in ("shot", "technique", "area"))
            receiver = (second, first)[(found.score.server + len(strokes)) % 2]
            strokes.append(
                nearest_stroke(game, state, int(shot), int(technique), None if np.isnan(area) else int(area), receiver)
            )
        return CourtRally.at(
            found.score,
            catalogue=game.catalogue,
            stroke=np.array(strokes, dtype=np.int64),
            hurried=column["hurried"][found.rows],
            waited=None if game.recovery is None or (waited < 0).any() else waited,
            ending=FAULT if column["outcome"][found.rows[-1]] == Outcome.FAULT else WINNER,
            number=number,
            names=(printable(found.players[0]), printable(found.players[1])),
            hands=(first, second),
            athletes=(athlete, athlete),
            key=int(stream(0, number)[0] >> np.uint64(1)),
        )

    def _found(self) -> list[_Annotated]:
        """Whole rallies: from a serve to a stroke that ended them, none missing. Seat 0 is who strikes first in a match."""
        column = self._columns
        if not len(column["rally"]):
            return []
        changes = [column[name][1:] != column[name][:-1] for name in ("match", "game", "rally")]
        starts = np.flatnonzero(np.r_[True, np.logical_or.reduce(changes)])
        out: list[_Annotated] = []
        match, seats = "", ("", "")
        finished: tuple[tuple[int, int], ...] = ()
        points, game = (0, 0), 0
        for first, end in zip(starts, np.r_[starts[1:], len(column["rally"])], strict=True):
            striker = str(column["player"][first])
            if column["match"][first] != match:
                match, seats = str(column["match"][first]), (striker, str(column["opponent"][first]))
                finished, points, game = (), (0, 0), int(column["game"][first])
            elif column["game"][first] != game:
                finished, points, game = (*finished, points), (0, 0), int(column["game"][first])
            server, rows = seats.index(striker), np.arange(first, end)
            after = np.array([column["points"][first], column["points_opponent"][first]])
            known = not np.isnan(after).any()
            if known:  # otherwise they are those of the rally before
                points = int(after[server]), int(after[1 - server])
            ended = int(column["outcome"][end - 1])
            serves = column["stroke"][first] == 1 and column["shot"][first] < N_SERVES
            if serves and (np.diff(column["stroke"][rows]) == 1).all() and ended in (Outcome.FAULT, Outcome.WINNER):
                winner = (server + len(rows) - (ended == Outcome.WINNER)) % 2
                before = [max(0, points[seat] - (known and seat == winner)) for seat in (0, 1)]
                games = [sum(ends[seat] > ends[1 - seat] for ends in finished) for seat in (0, 1)]
                score = Score(points=(before[0], before[1]), games=(games[0], games[1]), finished=finished, server=server)
                out.append(_Annotated(players=seats, score=score, rows=rows))
        return out


def _event(match: str, players: tuple[str, str]) -> str:
    """Name of a match without its players: ``KOREA OPEN 2019 Final`` of ``Kento_MOMOTA_CHOU_Tien_Chen_KOREA_OPEN_2019_Final``."""
    words, names = match.replace("_", " ").split(), tuple(map(_letters, players))
    ends = [k for k in range(2, len(words)) if _letters("".join(words[:k])) in ("".join(names), "".join(names[::-1]))]
    return " ".join(words[ends[0] if ends else 0 :])


def _letters(text: str) -> str:
    return "".join(filter(str.isalnum, text.casefold()))
