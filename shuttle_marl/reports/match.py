"""The match report: what decided a match, as figures.

:func:`match_report` computes a :class:`MatchReport` from the strokes of one match, annotated or recorded.
:mod:`shuttle_marl.reports` writes it as a page.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
from scipy import stats

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.habits import Plays, plays_of_strokes, tally
from shuttle_marl.exact.match import Odds
from shuttle_marl.game.pairs import game_of_people, people_of, without_skill
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.shipped import RELIABLE, Estimate, factor_of, resolve_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.reports.brief import Brief, brief, is_short, won_or_lost
from shuttle_marl.reports.course import Chances, RallyRow, rallies_of, rally_numbers, score_of
from shuttle_marl.reports.habits import Habit, difference_error, discoveries, habits, interval, with_discoveries
from shuttle_marl.reports.rating import rated_strokes, rater_of
from shuttle_marl.reports.scouting import hand_of, plain, with_hands_of_model
from shuttle_marl.reports.summary import AnalysisError, rally_table
from shuttle_marl.reports.value import NORMAL, add_values, calibrated
from shuttle_marl.reports.waits import Wait, waits

LENGTHS: Final = ((1, 3), (4, 7), (8, 12), (13, 9999))
"""Classes of rallies by number of strokes."""
MOMENTS: Final = 5
_OF_GAME: Final = 2
"""Most key moments of a game."""
_MOST_CHOICES: Final = 5
_LATE: Final = 30
"""Number of the stroke in a rally after which players tire."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShotValue:
    """Points that the strokes of one shot type added for a player, beyond an average player.

    Attributes:
        player: 0 or 1.
        strokes: number of strokes with a known value.
        points: sum of the values, with its 90 % interval over rallies.
        clear: whether the mean differs from 0 by more than chance, with a correction for the number of tests.
    """

    player: int
    shot: str
    strokes: int
    points: Estimate
    clear: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Won:
    """Rallies won of some: label, player, numbers, and the 90 % interval of the share.

    ``clear``: whether more or less than half were won by more than chance, with a correction for the number of tests.
    """

    label: str
    player: int
    rallies: int
    won: int
    low: float
    high: float
    clear: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Heat:
    """Targets of a player in won and in lost rallies: ``[9]`` counts, and areas that differ by more than chance."""

    player: int
    won: tuple[float, ...]
    lost: tuple[float, ...]
    clear: tuple[int, ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Change:
    """A habit of a player in one game that differs from the same player's other games."""

    player: int
    game: int
    habit: Habit


@dataclasses.dataclass(frozen=True, kw_only=True)
class Choice:
    """A costly decision.

    Attributes:
        player: who decided; ``rally``: index of the rally; ``stroke``: number of the stroke in it, from 1.
        incoming: catalogue index of the incoming stroke, the number of strokes for a serve; ``contact``: 0 below, 1 above.
        played, better: catalogue indices of the stroke and of a better one.
        cost: rallies won less than with what elite players choose there, per time, calibrated: the change of the live court.
        played_behind, better_behind: real strokes behind both.
        times: number of times that the player chose so in the match.
    """

    player: int
    rally: int
    stroke: int
    incoming: int
    contact: int
    played: int
    better: int
    cost: Estimate
    played_behind: float
    better_behind: float
    times: int


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MatchReport:
    """Figures of a match report. Areas are named as in the game: *right* is the forehand side of who meets the shuttle there.

    Attributes:
        players: names of players 0 and 1; 0 strikes first.
        hands: of both, each one of :data:`~shuttle_marl.game.court.HANDS`; None: not known, played as right-handed.
        score: points of both in each game.
        inferred: games whose last rally is not in the data, and added by the rules.
        briefs: page 1 for each player.
        moments: indices of the rallies with the largest swings, largest first.
        values: value of the strokes by player and shot type.
        choices: costly decisions, most costly first.
        factor: share of predicted advantages that real matches realise; None: unknown.
        serving, lengths: rallies won by server and kind of serve, and by length.
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
    briefs: Sequence[Brief]
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
    heat: Sequence[Heat]
    faults: Sequence[tuple[int, int]]
    changes: Sequence[Change]
    waits: Sequence[Wait]
    game: Game

    def as_json(self) -> dict[str, Any]:
        """The figures as JSON."""
        figures: dict[str, Any] = plain({f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "game"})
        names = (*self.game.catalogue.names, None)
        for choice in figures["choices"]:
            choice |= {part: names[choice[part]] for part in ("incoming", "played", "better")}
        return figures


def matches_in(strokes: pa.Table) -> list[str]:
    """Names of the matches of a table, in their order."""
    return list(strokes["match"].unique().to_pylist())


def match_report(strokes: pa.Table, *, game: Game | None = None, rules: Rules = BWF, odds: Odds | None = None) -> MatchReport:
    """Compute a match report.

    Args:
        strokes: one match, of schema :data:`shuttle_marl.data.schema.STROKES`.
        game: game of the values; None: the shipped one.
        odds: of the first striker against the other player, for the course of the match; None: those of equal players, because
            what a model says of people has not foretold matches better than a coin.

    Raises:
        AnalysisError: the table does not have one match of two players.
        GameError: a file of the model is damaged.
    """
    people = tuple(strokes["player"].unique().to_pylist())
    first = [strokes["player"][0].as_py(), strokes["opponent"][0].as_py()] if strokes.num_rows else []
    if len(matches_in(strokes)) != 1 or not set(people) <= set(first):
        raise AnalysisError(
            f"{len(matches_in(strokes))} matches of {len(people)} players: expected the strokes of one match of two"
        )
    players = (str(first[0]), str(first[1]))
    match = str(strokes["match"][0].as_py())
    base = resolve_game(None) if game is None else game.seats[0].average
    if game is None or game.people is None:
        played = game_of_people(base, players, date_of(match))
    else:
        near, far = game.people.players
        played = game if players[0] == near else game.swapped if players[0] == far else None
    if played is not None:
        strokes = with_hands_of_model(strokes, people_of(played).skill)
    known_game = base if played is None else played
    average = baselines.load(None, without_skill(known_game))
    valued = add_values(strokes, average)
    plays = plays_of_strokes(strokes)
    rallies = rallies_of(
        valued, plays.area, players, rules, Chances(odds or Odds(serving=0.5, receiving=0.5, error_bound=0.0), rules)
    )
    score, inferred = score_of(rallies, rules)
    seat = (strokes["player"].to_numpy(zero_copy_only=False) == players[1]).astype(np.int64)
    won = won_or_lost(strokes)
    # Only rallies that the striker lost count, each by how much it decided.
    stakes = np.array([[abs(row.swing) * (row.winner == 1 - player) for row in rallies] for player in (0, 1)])
    choices, refits = _costly(strokes, known_game, seat, stakes)
    tallies = [tally(plays.take(seat == player)) for player in (0, 1)]
    return MatchReport(
        match=match,
        players=players,
        hands=(hand_of(strokes, players[0]), hand_of(strokes, players[1])),
        score=score,
        inferred=inferred,
        briefs=[brief(tallies[1 - player], tallies[player], plays, won, seat == player, seat != player) for player in (0, 1)],
        rules=rules,
        strokes=strokes.num_rows,
        rallies=rallies,
        moments=_moments(rallies),
        values=_values(valued, seat),
        choices=choices,
        refits=refits,
        factor=factor_of(average.game),
        serving=_serving(rallies, plays, strokes),
        lengths=_lengths(rallies),
        heat=[_heat(plays, seat == player, won, player) for player in (0, 1)],
        faults=[_faults(strokes, seat == player) for player in (0, 1)],
        changes=_changes(plays, seat, strokes),
        waits=waits(strokes, players),
        game=known_game,
    )


def _moments(rallies: Sequence[RallyRow]) -> list[int]:
    """The rallies with the largest swings, at least half of the largest.

    No more than two are of one game; else the end of a close game would take all places.
    """
    found: list[int] = []
    for i in sorted((i for i, row in enumerate(rallies) if row.winner is not None), key=lambda i: -abs(rallies[i].swing)):
        counts = not found or 2 * abs(rallies[i].swing) >= abs(rallies[found[0]].swing)
        if counts and len(found) < MOMENTS and sum(rallies[k].key[0] == rallies[i].key[0] for k in found) < _OF_GAME:
            found.append(i)
    return found


def _faults(strokes: pa.Table, own: Bools) -> tuple[int, int]:
    known = strokes["forced"].filter(pa.array(own)).drop_null().to_numpy()
    return int(known.sum()), int((~known).sum())


def _values(valued: pa.Table, seat: I64) -> list[ShotValue]:
    """Value added by player and shot type; strokes of a rally depend on each other, so intervals are over rallies."""
    added = valued["value_added"].to_numpy(zero_copy_only=False)
    shot = valued["shot"].to_numpy().astype(np.int64)
    rally = rally_numbers(valued)
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
            p.append(float(2 * stats.norm.sf(abs(total) / error)))
    return [dataclasses.replace(each, clear=bool(mark)) for each, mark in zip(found, discoveries(p), strict=True)]


def _won(label: str, player: int, rallies: int, won: int) -> Won:
    low, high = interval(won / rallies, rallies)
    return Won(label=label, player=player, rallies=rallies, won=won, low=low, high=high)


def _serving(rallies: Sequence[RallyRow], plays: Plays, strokes: pa.Table) -> list[Won]:
    """Rallies won by each player as server, by kind of serve, and as receiver."""
    first = rally_table(strokes)["first"].to_numpy()
    serve = np.where(strokes["stroke"].to_numpy()[first] == 1, plays.shot[first], -1)
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
    clear = discoveries([float(stats.binomtest(each.won, each.rallies).pvalue) for each in out])
    return [dataclasses.replace(each, clear=bool(mark)) for each, mark in zip(out, clear, strict=True)]


def _heat(plays: Plays, mine: Bools, won: F64, player: int) -> Heat:
    counts = [tally(plays.take(mine & (won == result))).targets for result in (1.0, 0.0)]
    n = [max(1.0, float(count.sum())) for count in counts]
    error = difference_error(counts[0], n[0], counts[1], n[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        z = np.nan_to_num((counts[0] / n[0] - counts[1] / n[1]) / error)
    clear = np.flatnonzero(discoveries((2 * stats.norm.sf(np.abs(z))).tolist()))
    won_of, lost_of = (tuple(float(x) for x in count) for count in counts)
    return Heat(player=player, won=won_of, lost=lost_of, clear=tuple(int(area) for area in clear))


def _changes(plays: Plays, seat: I64, strokes: pa.Table) -> list[Change]:
    """Habits that differ between the games of a player by more than chance, each in the game where it differs most."""
    game = strokes["game"].to_numpy().astype(np.int64)
    found: list[tuple[int, int, Habit]] = []
    for player in (0, 1):
        for number in np.unique(game).tolist():
            mine = seat == player
            one, others = plays.take(mine & (game == number)), plays.take(mine & (game != number))
            if len(one) and len(others):
                found += [(player, number, habit) for habit in habits(tally(one), tally(others), dispersed=False)]
    marked = with_discoveries([habit for *_, habit in found])
    clear = [Change(player=p, game=n, habit=habit) for (p, n, _), habit in zip(found, marked, strict=True) if habit.clear]
    clear.sort(key=lambda each: -each.habit.p)
    most = {(each.player, each.habit.kind, each.habit.about, each.habit.answer): each for each in clear}
    return sorted(most.values(), key=lambda each: each.habit.p)


def _costly(strokes: pa.Table, game: Game, seat: I64, stakes: F64) -> tuple[list[Choice], int]:
    """The strokes of a match that are marked ``?!``, ``?`` or ``??`` and lose most, one of a kind, and the number of refits.

    The better stroke has the technique of the stroke played, which follows from where the striker stands. Strokes late in a rally
    are left out: the game knows no fatigue.

    Args:
        stakes: ``[2, rallies]`` what each rally is worth to each player, by which costs are ordered; 0: not costly.
    """
    rater = rater_of(game)
    found = rated_strokes(strokes, rater)
    rated, position = found.rated, found.position
    incoming, contact, stroke = rater.game.incoming(found.state), rater.game.contact(found.state), rated.stroke[position]
    bad = np.array(["?" in mark for mark in rated.marks])[position]
    rally, number, who = rally_numbers(strokes), strokes["stroke"].to_numpy().astype(np.int64), seat[found.row]
    stake = stakes[who, rally[found.row]]
    catalogue = game.seats[0].catalogue
    technique = catalogue.technique[rated.stroke]
    fair = (technique == technique[position][rated.row]) & (rated.behind >= RELIABLE)
    fair &= ~is_short(catalogue.shot, catalogue.area)[rated.stroke]
    alike = np.where(fair, rated.change, -np.inf)
    better = np.array([s + part.argmax() for s, part in zip(rated.start, np.split(alike, rated.start[1:]), strict=True)])
    bad &= (stake > 0) & (number[found.row] <= _LATE) & (alike[better] > rated.change[position])
    seen: set[tuple[int, int, int]] = set()
    out: list[Choice] = []
    for k in np.flatnonzero(bad)[np.argsort((rated.change[position] * stake)[bad], kind="stable")].tolist():
        place, best = int(position[k]), int(better[k])
        what = (int(who[k]), int(rated.shot[place]), int(rated.shot[best]))
        if what in seen or len(out) == _MOST_CHOICES:
            continue
        seen.add(what)
        same = (who == who[k]) & (incoming == incoming[k]) & (contact == contact[k]) & (stroke == stroke[k])
        out.append(
            Choice(
                player=what[0],
                rally=int(rally[found.row[k]]),
                stroke=int(number[found.row[k]]),
                incoming=int(incoming[k]),
                contact=int(contact[k]),
                played=int(stroke[k]),
                better=int(rated.stroke[best]),
                cost=calibrated(-rated.refits[:, place], rater.factor),
                played_behind=float(rated.behind[place]),
                better_behind=float(rated.behind[best]),
                times=int(same.sum()),
            )
        )
    return out, rater.refits
