"""Recorded rallies: of a rally log, and of annotated matches."""

import datetime
import itertools
import threading
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl.base.errors import isolated, printable
from shuttle_marl.court import WatchError
from shuttle_marl.court.match import CourtRally, OnceCache, staging_key
from shuttle_marl.court.messages import RecordedMatch
from shuttle_marl.data import read_matches
from shuttle_marl.data.matches import RealRally, event, nearest_stroke, real_rallies
from shuttle_marl.data.schema import Outcome
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.features import hurry_of, marked_rows
from shuttle_marl.game.court import HANDS
from shuttle_marl.game.draws import stream
from shuttle_marl.game.pairs import game_of_people, looks_of
from shuttle_marl.game.recovery import position_of
from shuttle_marl.game.rules import FAULT, REASONS, WINNER, IllegalStrokeError
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.reports.rally import LogPlayers, Players, legal_states

_MAX_MATCHES: Final = 16


class People(NamedTuple):
    """The people who played a real rally, at seats 0 and 1; ``date``: of the match, None: unknown."""

    names: tuple[str, str]
    date: datetime.date | None


class LogRallies:
    """The rallies of a log, by number, from 0.

    Policies named by the log are resolved without running code, and used only if their table is the one that played.

    Raises:
        RecordingError: the log was played on another game.
    """

    def __init__(self, log: RallyLog, game: Game) -> None:
        self._log, self._game = log, game
        self._lock = threading.RLock()  # a log is one open file, and requests are answered by several threads
        self._players, self._games = LogPlayers(log, game), OnceCache(_MAX_MATCHES)
        self.title, self.count = printable(log.path.name), log.n_rallies
        self.matches: list[RecordedMatch] = []

    def rally(self, number: int) -> CourtRally:
        """A rally. Raises ShuttleError: the rally does not exist, or it cannot be shown."""
        with self._lock:
            found = self._log.rally(number)
            if not found.finished[0]:
                raise WatchError(f"the rally was cut off ({REASONS[found.reason[0]]}), so there is no end to show")
            header = self._log.files[self._log.file_of(number)].header
            rally = found.row(0, self._log.catalogue, header.rules).checked()
            try:
                legal_states(rally, self._game)
            except IllegalStrokeError as error:
                raise WatchError(str(error)) from error
            first, second = (self._log.policies[int(policy)] for policy in found.policy[0])
            match = self._log.file_of(number), int(found.pairing[0]), int(found.match[0])
            games: dict[int, tuple[int, int]] = self._games.get(match, lambda: self._log.points_of_games(number))
            finished = tuple(points for game, points in games.items() if game < sum(rally.games))
            return CourtRally.at(
                Score(points=rally.points, games=rally.games, finished=finished, server=rally.server, rules=header.rules),
                self._game,
                **{name: getattr(rally, name) for name in ("stroke", "hurried", "waited", "ending")},
                number=number,
                names=(printable(first.name), printable(second.name)),
                **looks_of(self._game, (first.name, second.name))._asdict(),
                key=staging_key(header, found),
            )

    def players(self, number: int) -> Players | None:
        """Policies of a rally; None: unknown."""
        with self._lock:
            found = self._players.of_rally(number)
        return None if found.value is None else found

    def match(self, number: int) -> tuple[int, int]:
        """Numbers of pairing and match of a rally."""
        with self._lock:
            found = self._log.rally(number)
        return int(found.pairing[0]), int(found.match[0])


class RealRallies:
    """The rallies of annotated matches, as strokes of the game, by number, from 0.

    An annotated stroke is shown as the nearest legal stroke: same contact, then shot type, technique and area. Who was hurried
    says the table, or else the index of the model. A player whose hand is not known plays with the right one.

    Args:
        path: a stroke table, or a folder with the raw files.
        strokes: the strokes, if they are read already.

    Raises:
        DataError: it cannot be read.
        WatchError: it holds no whole rally.
    """

    def __init__(self, path: Path, game: Game, strokes: pa.Table | None = None) -> None:
        table = read_matches(path) if strokes is None else strokes
        self._game, self._rallies = game, [found for found in real_rallies(table) if found.whole]
        if not self._rallies:
            raise WatchError(f"{printable(str(path))}: holds no whole rally")
        rows = marked_rows(table, hurry_of(game.seats[0]))
        self._hurried = rows.hurried > 0
        self._waited = np.where(np.isfinite(rows.waiting).all(axis=1), position_of(*rows.waiting.T), -1)
        names = ("height", "shot", "technique", "area", "discipline")
        self._columns = {name: table[name].to_numpy(zero_copy_only=False) for name in names}
        known = table.filter(pc.is_valid(table["hand"]))
        self._hands = {name: HANDS[hand] for name, hand in zip(*(known[n].to_pylist() for n in ("player", "hand")), strict=True)}
        self.title, self.count = printable(path.name), len(self._rallies)
        parts = itertools.groupby(enumerate(self._rallies), key=lambda numbered: numbered[1].match)
        self.matches = [_described(list(part)) for _, part in parts]

    def numbers(self, match: str) -> dict[tuple[int, int], int]:
        """Numbers of the rallies of a match, by their game and number in the data."""
        return {found.number: number for number, found in enumerate(self._rallies) if found.match == match}

    def people(self, number: int) -> People:
        """The people who played a rally."""
        found = self._at(number)
        return People(found.players, date_of(found.match))

    def match(self, number: int) -> str:
        """Name of the match of a rally. Raises WatchError: the rally does not exist."""
        return self._at(number).match

    def _at(self, number: int) -> RealRally:
        if not 0 <= number < self.count:
            raise WatchError(f"no rally {number + 1}: there are {self.count:,}")
        return self._rallies[number]

    def rally(self, number: int) -> CourtRally:
        """A rally. Raises WatchError: the rally does not exist."""
        found, column = self._at(number), self._columns
        # The tables of the two people, whose hands may differ, if the model knows them.
        pair = game_of_people(self._game, found.players, date_of(found.match))
        state, game, strokes = ROOT, self._game if pair is None else pair.seats[0], list[int]()
        first, second = (self._hands.get(player, "right") for player in found.players)
        hurried, waited = self._hurried[found.rows], self._waited[found.rows]
        for row in found.rows.tolist():
            if strokes:
                arrivals = game.arrivals(game.pair(state, np.array(strokes[-1:])))[0]
                state = int(arrivals[2 * int(self._hurried[row]) + int(column["height"][row])])
            shot, technique, area = (column[name][row] for name in ("shot", "technique", "area"))
            receiver = (second, first)[(found.score.server + len(strokes)) % 2]
            strokes.append(
                nearest_stroke(game, state, int(shot), int(technique), None if np.isnan(area) else int(area), receiver)
            )
        athlete = "female" if column["discipline"][found.rows[0]] == "WS" else "male"
        return CourtRally.at(
            found.score,
            game,
            stroke=np.array(strokes, dtype=np.int64),
            hurried=hurried,
            waited=waited,
            ending=FAULT if found.ended == Outcome.FAULT else WINNER,
            number=number,
            names=(_name(found.players[0]), _name(found.players[1])),
            hands=(first, second),
            athletes=(athlete, athlete),
            key=int(stream(0, number)[0] >> np.uint64(1)),
        )


Recorded = LogRallies | RealRallies  # recorded rallies by number, from 0; ``matches``: the annotated ones


def _name(player: str) -> str:
    return isolated(printable(player))


def _described(rallies: list[tuple[int, RealRally]]) -> RecordedMatch:
    (first, _), (_, last) = rallies[0], rallies[-1]
    date = date_of(last.match)
    # Every rally but the last one is a point of a score.
    played = sum(map(sum, last.score.finished)) + sum(last.score.points) + 1
    return RecordedMatch(
        first=first,
        title=printable(event(last.match, last.players)),
        names=(_name(last.players[0]), _name(last.players[1])),
        date=None if date is None else date.isoformat(),
        missing=max(0, played - len(rallies)),
    )
