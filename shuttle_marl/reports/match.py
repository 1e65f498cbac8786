"""The match report as figures: course, key moments, value of the strokes, and costly decisions.

:func:`match_report` computes a :class:`MatchReport` from the strokes of one match, annotated or recorded;
:mod:`shuttle_marl.reports.pages` writes it as a page.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
from scipy import special

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.data.matches import RealRally, game_ends, real_rallies, rules_of, winner_of
from shuttle_marl.data.schema import Outcome, rally_numbers
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.habits import Tally, plays_of, tally
from shuttle_marl.exact.fixed_point import Odds
from shuttle_marl.exact.odds import match_table
from shuttle_marl.game.pairs import game_of_people, people_of, without_skill
from shuttle_marl.game.scoring import Rules, Score
from shuttle_marl.game.shipped import RELIABLE, Estimate, factor_of, resolve_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.reports import habits as counts
from shuttle_marl.reports.rating import Rater, rater_of
from shuttle_marl.reports.summary import AnalysisError, hand_of, rally_table, with_hands_of_model, won_or_lost
from shuttle_marl.reports.value import NORMAL, Placed, calibrated, placed, stroke_values
from shuttle_marl.reports.waits import Wait, differences, waits
from shuttle_marl.reports.words import words

_TURN: Final = 0.1  # smallest change of the probability of winning a rally that is reported


@dataclasses.dataclass(frozen=True, kw_only=True)
class RallyRow:
    """A rally of the match; players are 0 and 1. ``decided``: number of the stroke before the last one that changed the
    probability of winning the rally most, from 1, with the player who struck it, its shot type, and the change for that player
    (None: not known, or less than a tenth)."""

    key: tuple[int, int]  # game and number of the rally in the data
    number: int  # of the rally in the match, by its points, from 1
    points: tuple[int, int]  # score before the rally
    games: tuple[int, int]  # games before it
    server: int  # player
    winner: int | None  # player; None: not recorded
    strokes: int
    ending: str  # one of `ENDINGS`
    last_shot: str  # shot type of the last stroke
    last_area: int  # its target area; -1: not known, as that of a fault
    given: tuple[str, int] | None  # shot type and target area of the stroke before it; None: there was none
    before: float  # probability that player 0 wins the match; NaN: an earlier game is not in the data
    after: float  # the same after the rally
    decided: tuple[int, int, str, float] | None
    seconds: float | None  # time of the rally in the video [s]; None: unknown

    @property
    def swing(self) -> float:
        """Change of the probability that player 0 wins the match."""
        return self.after - self.before


def _rallies(
    strokes: pa.Table, found: Sequence[RealRally], frame: pa.Table, added: F64, area: I64, chances_of: "Chances"
) -> list[RallyRow]:
    """Rallies with the probabilities of winning the match; ``found``, ``frame``: the rallies with the score, and their table;
    ``added``, ``area``: ``[N]`` value and target of each stroke; NaN and -1 where unknown."""
    column = {name: strokes[name].to_numpy(zero_copy_only=False) for name in ("player", "stroke", "shot", "clock")}
    out: list[RallyRow] = []
    for row, rally in zip(frame.to_pylist(), found, strict=True):
        start, end, winner, server = rally.rows[0], rally.rows[-1] + 1, rally.winner, rally.score.server
        chance, after = math.nan, math.nan
        if len(rally.score.finished) == rally.number[0] - 1:
            chance = chances_of.of(rally.score)
            after = chance if winner is None else chances_of.of(rally.score.after(winner))
        decided, own = None, added[start:end]
        striker = np.array([rally.players.index(name) for name in column["player"][start:end]])
        gain = np.nan_to_num(np.where(striker == winner, own, -own))[:-1]
        if winner is not None and len(gain) and gain.max() >= _TURN:
            k = int(gain.argmax())
            shot = SHOTS[int(column["shot"][start + k])]
            decided = (int(column["stroke"][start + k]), int(striker[k]), shot, float(own[k]))
        clock = column["clock"][start]
        out.append(
            RallyRow(
                key=rally.number,
                number=max(out[-1].number if out else 0, sum(map(sum, rally.score.finished)) + sum(rally.score.points)) + 1,
                points=rally.score.points,
                games=rally.score.games,
                server=server,
                winner=winner,
                strokes=row["length"],
                ending=str(row["ending"]),
                last_shot=SHOTS[row["last_shot"]],
                last_area=int(area[end - 1]),
                given=(SHOTS[int(column["shot"][end - 2])], int(area[end - 2])) if end - start > 1 else None,
                before=chance,
                after=after,
                decided=decided,
                seconds=None if clock is None or np.isnan(clock) else float(clock),
            )
        )
    return out


class Chances:
    """Probabilities that player 0 wins the match; ``odds``: of player 0, in every rally."""

    def __init__(self, odds: Odds, rules: Rules) -> None:
        self._odds, self._table = odds, match_table(odds.serving, odds.receiving, rules)

    def of(self, score: Score) -> float:
        """At a score; NaN at one that the rules do not allow."""
        if score.over:
            return float(score.games[0] > score.games[1])
        won, lost = self._table.get((*score.games, *score.points, score.server), (math.nan, math.nan))
        return lost + (won - lost) * (self._odds.receiving if score.server else self._odds.serving)


LENGTHS: Final = ((1, 3), (4, 7), (8, 12), (13, 9999))  # classes of rallies by number of strokes
MOMENTS: Final = 5
_OF_GAME: Final = 2
_MOST_CHOICES: Final = 5
_LATE: Final = 30  # number of the stroke in a rally after which players tire


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShotValue:
    """Points that the strokes of one shot type added for a player, beyond an average player."""

    player: int  # 0 or 1
    shot: str
    strokes: int  # number of strokes with a known value
    points: Estimate  # sum of the values, with its 90 % interval over rallies
    clear: bool = False  # whether the mean differs from 0 by more than chance, with a correction for the number of tests


@dataclasses.dataclass(frozen=True, kw_only=True)
class Won:
    """Rallies won of some: label, player, numbers, and the 90 % interval of the share. ``clear``: whether more or less than half
    were won by more than chance, with a correction for the number of tests."""

    label: str
    player: int
    rallies: int
    won: int
    low: float
    high: float
    clear: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Choice:
    """A costly decision."""

    player: int  # who decided
    rally: int  # index of the rally
    stroke: int  # number of the stroke in it, from 1
    incoming: int  # catalogue index of the incoming stroke, the number of strokes for a serve
    contact: int  # 0 below, 1 above the net
    hurried: bool  # whether the player was
    played: int  # catalogue index of the stroke
    better: int  # that of a better one
    cost: Estimate  # rallies won less than with what elite players choose there, per time, calibrated
    played_behind: float  # real strokes behind the one played
    better_behind: float  # those behind the better one
    times: int  # number of times that the player chose so in the match


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MatchReport:
    """Figures of a match report. Areas are named as in the game: *right* is the forehand side of who meets the shuttle there.

    Attributes:
        players: names of players 0 and 1; 0 strikes first.
        hands: of both, each one of :data:`~shuttle_marl.game.court.HANDS`; None: not known, played as right-handed.
        score: points of both in each game.
        inferred: games whose last rally is not in the data, and added by the rules.
        winner: of the match; None: it was not finished.
        page1: page 1, on both players.
        moments: indices of the rallies with the largest swings, largest first.
        values: value of the strokes by player and shot type.
        choices: costly decisions, most costly first.
        factor: share of predicted advantages that real matches realise; None: unknown.
        serving, lengths: rallies won by server and kind of serve, and by length.
        targets: ``[9]`` number of strokes of each player by target area.
        faults: by player, forced and unforced ones, where the data tell.
        changes: from game to game.
        waits: where both wait after their most frequent strokes; empty where positions are unknown.
        game: that of both players if the model knows them, else the average one.
    """

    match: str
    players: tuple[str, str]
    hands: tuple[str | None, str | None]
    score: tuple[tuple[int, int], ...]
    inferred: tuple[int, ...]
    winner: int | None
    page1: counts.Page1
    rules: Rules
    strokes: int
    rallies: Sequence[RallyRow]
    moments: Sequence[int]
    values: Sequence[ShotValue]
    choices: Sequence[Choice]
    refits: int
    factor: Estimate | None
    serving: Sequence[Won]
    lengths: Sequence[Won]
    targets: Sequence[F64]
    faults: Sequence[tuple[int, int]]
    changes: Sequence[counts.Change]
    waits: Sequence[Wait]
    game: Game

    def as_json(self) -> dict[str, Any]:
        """The figures as JSON."""
        figures: dict[str, Any] = counts.plain(
            {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "game"}
        )
        names = (*self.game.catalogue.names, None)
        for choice in figures["choices"]:
            choice |= {part: names[choice[part]] for part in ("incoming", "played", "better")}
        people = words().player(self.players[0]), words().player(self.players[1])
        return figures | {"page1": self.page1.as_json(lambda each: words().statement(each, people, match=True))}


def matches_in(strokes: pa.Table) -> list[str]:
    """Names of the matches of a table, in their order."""
    return list(strokes["match"].unique().to_pylist())


def match_report(
    strokes: pa.Table, *, game: Game | None = None, rules: Rules | None = None, odds: Odds | None = None
) -> MatchReport:
    """Compute a match report.

    Args:
        strokes: one match, of schema :data:`shuttle_marl.data.schema.STROKES`.
        game: game of the values; None: the shipped one.
        rules: of the match; None: those that the table carries, or else its scores tell.
        odds: of the first striker against the other player, for the course of the match; None: those of equal players, because
            what a model says of people has not foretold matches better than a coin.

    Raises:
        AnalysisError: the table does not have one match of two players.
        GameError: a file of the model is damaged.
    """
    match, players = _only_match(strokes)
    rules = rules or rules_of(strokes)[match]
    scored = [*real_rallies(strokes, {match: rules})]
    ends, winner = game_ends(scored), winner_of(scored)
    base = resolve_game(None) if game is None else game.seats[0].average
    if game is None or game.people is None:
        played = game_of_people(base, players, date_of(match))
    else:
        near, far = game.people.players
        played = game if players[0] == near else game.swapped if players[0] == far else None
    known_game = base if played is None else played
    average, rater = baselines.load(None, without_skill(known_game)), rater_of(known_game)
    # The strokes: hands, rallies and who won them, state and value of each.
    strokes = strokes if played is None else with_hands_of_model(strokes, people_of(played).skill)
    hands = hand_of(strokes, players[0]), hand_of(strokes, players[1])
    frame, rally, won = rally_table(strokes), rally_numbers(strokes), won_or_lost(strokes)
    found = placed(strokes, average.game)
    added = stroke_values(found, average)["value_added"]
    # What is counted of them.
    seat = (strokes["player"].to_numpy(zero_copy_only=False) == players[1]).astype(np.int64)
    plays = plays_of(found.rows)
    tallies = [tally(plays.take(seat == player)) for player in (0, 1)]
    waiting = waits(strokes, players)
    results = [counts.Results(plays, won, rally, seat == player, seat) for player in (0, 1)]
    compared = counts.options_of(results)
    said = [each for player in (0, 1) for each in _said(player, tallies, waiting)]
    said += [each for player in (0, 1) for each in counts.options(player, compared[player])]
    counted = counts.serves(strokes, frame, players[0]), counts.serves(strokes, frame, players[1])
    forced = [strokes["forced"].filter(pa.array(seat == player)).drop_null().to_numpy() for player in (0, 1)]
    changed = counts.changes(plays, seat, strokes["game"].to_numpy().astype(np.int64))
    # The match.
    even = Odds(serving=0.5, receiving=0.5, error_bound=0.0)
    rallies = _rallies(strokes, scored, frame, added, plays.area, Chances(odds or even, rules))
    # Only rallies that the striker lost count, each by how much it decided.
    stakes = np.array([[abs(row.swing) * (row.winner == 1 - player) for row in rallies] for player in (0, 1)])
    return MatchReport(
        match=match,
        players=players,
        hands=hands,
        score=tuple(points for points, *_ in ends.values()),
        inferred=tuple(game for game, (*_, added_by_rules) in ends.items() if added_by_rules),
        winner=winner,
        page1=counts.Page1(tuple(said), sum(map(len, compared)), counted),
        rules=rules,
        strokes=strokes.num_rows,
        rallies=rallies,
        moments=_moments(rallies),
        values=_values(added, plays.shot, seat, rally),
        choices=_costly(found, rater, seat, rally, stakes, results, counts.advised(said)),
        refits=rater.refits,
        factor=factor_of(average.game),
        serving=_serving(rallies, np.where(found.rows.stroke == 1, plays.shot, -1)[frame["first"].to_numpy()]),
        lengths=_lengths(rallies),
        targets=[each.targets for each in tallies],
        faults=[(int(known.sum()), int((~known).sum())) for known in forced],
        changes=changed,
        waits=waiting,
        game=known_game,
    )


def _only_match(strokes: pa.Table) -> tuple[str, tuple[str, str]]:
    """Name and players of the only match of a table; who strikes first is the first player. Raises AnalysisError: the table does
    not have one match of two players."""
    people = strokes["player"].unique().to_pylist()
    first = [strokes["player"][0].as_py(), strokes["opponent"][0].as_py()] if strokes.num_rows else []
    if len(matches_in(strokes)) != 1 or not set(people) <= set(first):
        found = f"{len(matches_in(strokes))} matches of {len(people)} players"
        raise AnalysisError(f"{found}: expected the strokes of one match of two")
    return str(strokes["match"][0].as_py()), (str(first[0]), str(first[1]))


def _said(player: int, tallies: Sequence[Tally], waiting: Sequence[Wait]) -> list[counts.Statement]:
    own, other = tallies[player], tallies[1 - player]
    more, ends = (
        [each for each in found if each.share > each.usual]
        for found in (counts.habits(own, other, dispersed=False), counts.endings(own, other))
    )
    return [*counts.sure(player, more, ends, differences(waiting, match=True)), *counts.answers(player, own)]


def _moments(rallies: Sequence[RallyRow]) -> list[int]:
    """The rallies with the largest swings, at least half of the largest. No more than two are of one game; else the end of a
    close game would take all places."""
    found: list[int] = []
    for i in sorted((i for i in range(len(rallies)) if not math.isnan(rallies[i].swing)), key=lambda i: -abs(rallies[i].swing)):
        large = not found or 2 * abs(rallies[i].swing) >= abs(rallies[found[0]].swing)
        if large and len(found) < MOMENTS and sum(rallies[k].key[0] == rallies[i].key[0] for k in found) < _OF_GAME:
            found.append(i)
    return found


def _values(added: F64, shot: I64, seat: I64, rally: I64) -> list[ShotValue]:
    """Value added by player and shot type; strokes of a rally depend on each other, so intervals are over rallies."""
    found: list[ShotValue] = []
    p: list[float] = []
    for player in (0, 1):
        for kind, name in enumerate(SHOTS):
            mine = np.flatnonzero((seat == player) & (shot == kind) & np.isfinite(added))
            if len(mine) < RELIABLE:
                continue
            sums = np.bincount(np.unique(rally[mine], return_inverse=True)[1], added[mine])
            # One more fault or winner, which costs or gains half a rally, could have happened where none did.
            total, error = float(added[mine].sum()), float(np.sqrt((sums**2).sum() + 0.25))
            points = Estimate(total, total - NORMAL * error, total + NORMAL * error)
            found.append(ShotValue(player=player, shot=name, strokes=len(mine), points=points))
            p.append(float(2 * special.ndtr(-abs(total) / error)))
    return [dataclasses.replace(each, clear=bool(mark)) for each, mark in zip(found, counts.discoveries(p), strict=True)]


def _won(label: str, player: int, rallies: int, won: int) -> Won:
    low, high = counts.interval(won / rallies, rallies)
    return Won(label=label, player=player, rallies=rallies, won=won, low=low, high=high)


def _serving(rallies: Sequence[RallyRow], serve: I64) -> list[Won]:
    """Rallies won by each player as server, by kind of serve (-1: not known), and as receiver."""
    out = []
    for player in (0, 1):
        decided = [(i, row) for i, row in enumerate(rallies) if row.winner is not None]
        served = [(i, row) for i, row in decided if row.server == player]
        groups = {
            "serving": served,
            **{SHOTS[kind]: [each for each in served if serve[each[0]] == kind] for kind in (0, 1)},
            "receiving": [each for each in decided if each[1].server != player],
        }
        for label, some in groups.items():
            if some:
                out.append(_won(label, player, len(some), sum(row.winner == player for _, row in some)))
    return out


def _lengths(rallies: Sequence[RallyRow]) -> list[Won]:
    out = []
    for low, high in LENGTHS:
        some = [row for row in rallies if row.winner is not None and low <= row.strokes <= high]
        if some:
            label = f"{low}\N{EN DASH}{high}" if high < LENGTHS[-1][1] else f"{low}+"
            out.append(_won(label, 0, len(some), sum(row.winner == 0 for row in some)))
    # Binomial tests of one half.
    clear = counts.discoveries(
        [min(1.0, 2 * float(special.bdtr(min(each.won, each.rallies - each.won), each.rallies, 0.5))) for each in out]
    )
    return [dataclasses.replace(each, clear=bool(mark)) for each, mark in zip(out, clear, strict=True)]


def _costly(
    found: Placed,
    rater: Rater,
    seat: I64,
    rally: I64,
    stakes: F64,
    results: Sequence[counts.Results],
    before: Sequence[counts.Advised],
) -> list[Choice]:
    """The strokes of a match that are marked ``?!``, ``?`` or ``??`` and lose most, one of a kind, none against the results of
    the match or other advice (``before``). The better stroke has the technique of the stroke played, which follows from where the
    striker stands; strokes late in a rally are left out, because the game knows no fatigue.

    ``seat``, ``rally``: ``[N]`` striker and rally of each stroke; ``stakes``: ``[2, rallies]`` what each rally is worth to each
    player, by which costs are ordered, 0: not costly; ``results``: rallies that each player won."""
    # Where a fault was aimed at is not recorded.
    row = np.flatnonzero((found.rank >= 0) & (found.rows.outcome != Outcome.FAULT))
    state, number = found.state[row], found.rows.stroke[row]
    rated = rater.rated(state)
    position = rated.start + found.rank[row]
    incoming, contact, stroke = rater.game.incoming(state), rater.game.contact(state), rated.stroke[position]
    bad = np.array(["?" in mark for mark in rated.marks], dtype=np.bool_)[position]
    who = seat[row]
    stake = stakes[who, rally[row]]
    catalogue = rater.game.catalogue
    technique = catalogue.technique[rated.stroke]
    fair = (technique == technique[position][rated.row]) & (rated.behind >= RELIABLE)
    fair &= ~counts.is_short(catalogue.shot, catalogue.area)[rated.stroke]
    alike = np.where(fair, rated.change, -np.inf)
    better = rated.largest(alike)
    bad &= (stake > 0) & (number <= _LATE) & (alike[better] > rated.change[position])
    seen: set[tuple[int, int, int]] = set()
    out, told = list[Choice](), [*before]
    for k in np.flatnonzero(bad)[np.argsort((rated.change[position] * stake)[bad], kind="stable")].tolist():
        place, best = int(position[k]), int(better[k])
        what = (int(who[k]), int(rated.shot[place]), int(rated.shot[best]))
        if what in seen or len(out) == _MOST_CHOICES:
            continue
        good, worse = ((int(catalogue.shot[one]), int(catalogue.area[one])) for one in (rated.stroke[best], stroke[k]))
        here, late = counts.SERVING, bool(found.rows.hurried[row[k]] == 1)
        if incoming[k] < len(catalogue):  # as the page names it
            here = counts.Situation(int(catalogue.shot[incoming[k]]), int(catalogue.area[incoming[k]]), int(contact[k]), late)
        advice = counts.Advised(what[0], here, good, worse)
        if not advice.agrees(results[what[0]], told):
            continue
        told.append(advice)
        seen.add(what)
        same = (who == who[k]) & (incoming == incoming[k]) & (contact == contact[k]) & (stroke == stroke[k])
        out.append(
            Choice(
                player=what[0],
                rally=int(rally[row[k]]),
                stroke=int(number[k]),
                incoming=int(incoming[k]),
                contact=int(contact[k]),
                hurried=here.hurried,
                played=int(stroke[k]),
                better=int(rated.stroke[best]),
                cost=calibrated(-rated.refits[:, place], rater.factor),
                played_behind=float(rated.behind[place]),
                better_behind=float(rated.behind[best]),
                times=int(same.sum()),
            )
        )
    return out
