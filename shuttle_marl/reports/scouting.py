"""The scouting report: what is known about playing against an opponent, as figures.

:func:`scout` computes a :class:`ScoutingReport` from a model alone, and says more where annotated matches are given.
:mod:`shuttle_marl.reports` writes it as a page.
"""

import dataclasses
import datetime
import difflib
import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from scipy.special import expit, logit

from shuttle_marl.base.arrays import F64
from shuttle_marl.data.schema import DISCIPLINES, STROKES, rally_numbers
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.features import hurry_of, marked_rows
from shuttle_marl.dynamics.habits import Plays, load_habits, plays_of, tally
from shuttle_marl.exact.odds import pair_odds
from shuttle_marl.game.pairs import AVERAGE, Day, Skill, load_skill, pair_game, people_of
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.shipped import PROFILES, Estimate, model_folder, resolve_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.reports import habits as counts
from shuttle_marl.reports.summary import AnalysisError, Met, hand_of, met, rally_table, with_hands_of_model, won_or_lost
from shuttle_marl.reports.value import TOLERANCE
from shuttle_marl.reports.waits import Stand, Wait, differences, stands, waits
from shuttle_marl.reports.words import words

ATTACKS: Final = ("smash", "half-smash", "net-kill")
EARNED: Final = 0.4
"""Share of the log-odds of a rally that a forecast keeps: the lower end of the 95 % interval of their slope on cross fits, .43,
rounded down (``calibration`` of ``python -m experiments.pairs --cross 4``)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Known:
    """Data about a player in the model."""

    name: str
    strokes: int  # in the data of the model
    matches: int  # in the data of the model
    since: datetime.date | None  # day of the estimate of the skill; None: unknown player, who counts as the average one
    hand: str | None  # one of `HANDS`; None: not known, played as right-handed
    imitated: bool  # whether the model has the player's own choices; else those of the average player are used


class Form(NamedTuple):
    """Figures of a player in one dated match: shares of points won, and of strokes that were faults, winners and attacks."""

    day: datetime.date
    against: str
    points: int
    won: Estimate
    strokes: int
    fault: Estimate
    winner: Estimate
    attack: Estimate


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ScoutingReport:
    """Figures of a scouting report. Areas are named as in the game: *right* is the forehand side of who meets the shuttle there.

    Attributes:
        player: who is to win; None: profile of the opponent alone.
        opponent: who is described.
        discipline: ``men`` or ``women``.
        model: name or folder of the model, and hash of the game.
        page1: page 1, on the player (0) and the opponent (1).
        options: shot types that were played to the opponent, each beside the others in its situation; None without matches.
        rally: share of rallies that the player wins by the skill of both, no larger than such forecasts have earned.
        met: results of the two in the annotated matches; None without.
        season: figures of the opponent over dated matches.
        habits, endings: how the opponent plays beside other players of the discipline.
        targets: ``[9]`` shares of the opponent's strokes by target area; ``targets_usual``: of the others.
        target_strokes: number of strokes behind the targets.
        seen: strokes and matches of the opponent in the annotated matches; None: habits are those of the model's matches.
        waits: where both wait after their most frequent strokes, the player (0) and the opponent (1); empty without known
            positions.
        stands: where the opponent stands after the three most frequent strokes, in the matches or else in those of the model.
        recent: the opponent's last match in the data beside the earlier ones; empty without two matches.
        pair: the game of both, for staging examples.
    """

    player: Known | None
    opponent: Known
    discipline: str
    model: tuple[str, str]
    page1: counts.Page1
    options: Sequence[counts.Option] | None
    rally: float | None
    met: Met | None
    season: Sequence[Form]
    habits: Sequence[counts.Habit]
    endings: Sequence[counts.Habit]
    targets: F64
    targets_usual: F64
    target_strokes: float
    seen: tuple[int, int] | None
    waits: Sequence[Wait]
    stands: Sequence[Stand]
    recent: Sequence[counts.Habit]
    pair: Game | None

    def renamed(self, name_of: Callable[[str], str]) -> "ScoutingReport":
        """The report with other names of player and opponents."""
        player = self.player and dataclasses.replace(self.player, name=name_of(self.player.name))
        opponent = dataclasses.replace(self.opponent, name=name_of(self.opponent.name))
        season = [form._replace(against=name_of(form.against)) for form in self.season]
        return dataclasses.replace(self, player=player, opponent=opponent, season=season)

    def as_json(self) -> dict[str, Any]:
        """The figures as JSON."""
        figures = {
            field.name: counts.plain(getattr(self, field.name)) for field in dataclasses.fields(self) if field.name != "pair"
        }
        names = "" if self.player is None else words().player(self.player.name), words().player(self.opponent.name)
        return figures | {"page1": self.page1.as_json(lambda each: words().statement(each, names, match=False))}


@dataclasses.dataclass(frozen=True, kw_only=True)
class ListedPlayer:
    """A player who can be scouted: strokes and matches in the data of the model, day of the last estimate."""

    name: str
    discipline: str
    strokes: int
    matches: int
    last: datetime.date
    imitated: bool


def players_of(model: str = "default") -> list[ListedPlayer]:
    """The players of a model, most strokes first. Raises GameError: the model has no skill of players."""
    folder = model_folder(model)
    skill, imitated_ones = load_skill(folder), baselines.clones(folder).players
    listed = [
        ListedPlayer(
            name=name,
            discipline=str(skill.discipline_of(name)),
            strokes=int(skill.strokes[i]),
            matches=int(skill.matches[i]),
            last=skill.since(name) or datetime.date.min,
            imitated=name in imitated_ones,
        )
        for i, name in enumerate(skill.players)
    ]
    return sorted(listed, key=lambda each: (-each.strokes, each.name))


def scout(
    opponent: str, player: str | None = None, *, model: str = "default", date: Day = None, data: pa.Table | None = None
) -> ScoutingReport:
    """Compute a scouting report.

    Args:
        opponent: who is described.
        player: who is to win against the opponent; None: profile of the opponent alone.
        date: day of the skill; None: the last one known.
        data: annotated matches, for counted habits and results; None: the model alone.

    Raises:
        AnalysisError: the opponent is neither in the model nor in the data, or plays another discipline than the player.
        GameError: the model has no skill of players.
    """
    folder, strokes = model_folder(model), STROKES.empty_table() if data is None else data
    skill, clones = load_skill(folder), baselines.clones(folder).players
    known_names = [*skill.players, *strokes["player"].unique().to_pylist()]
    opponent = _as_known(opponent, known_names)
    player = None if player is None else _as_known(player, known_names)
    discipline = _discipline(skill, [name for name in (opponent, player) if name is not None], strokes)
    strokes = with_hands_of_model(strokes, skill)

    def known(name: str) -> Known:
        hand = hand_of(strokes, name)
        if name not in skill.players:
            return Known(name=name, strokes=0, matches=0, since=None, hand=hand, imitated=False)
        i = skill.index(name)
        return Known(
            name=name,
            strokes=int(skill.strokes[i]),
            matches=int(skill.matches[i]),
            since=skill.since(name, date),
            hand=hand or skill.hand_of(name),
            imitated=name in clones,
        )

    def pair(*names: str) -> Game:
        first, second = (name if name in skill.players else AVERAGE for name in names)
        return pair_game(first, second, date=date, discipline=discipline, game=model)

    people = known(opponent), None if player is None else known(player)
    strokes = strokes.filter(pa.compute.equal(strokes["discipline"], DISCIPLINES[PROFILES.index(discipline)]))
    plays, won = plays_of(marked_rows(strokes, hurry_of(resolve_game(model)))), won_or_lost(strokes)
    striker, receiver = (strokes[name].to_numpy(zero_copy_only=False) for name in ("player", "opponent"))
    mine, against = striker == opponent, receiver == opponent

    # The opponent and the others, in the matches or else in those of the model.
    own, others = (tally(plays.take(mine)), tally(plays.take(~mine))) if mine.any() else load_habits(folder)[opponent]
    told, ends, waiting = counts.habits(own, others), counts.endings(own, others), waits(strokes, (player or "", opponent))
    number = np.unique(striker.astype(str), return_inverse=True)[1]
    compared = (
        counts.options_of([counts.Results(plays, won, rally_numbers(strokes), against, number)])[0] if against.any() else None
    )
    said = (
        *counts.sure(1, told, ends, differences(waiting, match=False)),
        *counts.answers(1, own),
        *counts.options(0, compared or ()),
    )
    counted = counts.serves(strokes, rally_table(strokes), opponent) if mine.any() else None
    found = None if player is None else pair(player, opponent)
    odds = None if found is None else pair_odds([imitated(found)], tolerance=TOLERANCE)[0]
    return ScoutingReport(
        player=people[1],
        opponent=people[0],
        discipline=discipline,
        model=(model, (pair(opponent, AVERAGE) if found is None else found).hash),
        page1=counts.Page1(said, None if compared is None else len(compared), (None, counted)),
        options=compared,
        rally=None if odds is None else float(earned(np.array(float(odds.rally)))),
        met=None if data is None or player is None else met(strokes, player, opponent),
        season=season(strokes, plays, opponent),
        habits=told,
        endings=ends,
        targets=own.targets / max(1.0, own.targets.sum()),
        targets_usual=others.targets / max(1.0, others.targets.sum()),
        target_strokes=float(own.targets.sum()),
        seen=(int(mine.sum()), len(strokes.filter(mine)["match"].unique())) if mine.any() else None,
        waits=waiting,
        stands=stands(own, [each for each in waiting if each.player == 1]),
        recent=_recent(plays.take(mine), strokes.filter(mine)),
        pair=found,
    )


def imitated(pair: Game) -> tuple[TabulatedPolicy, TabulatedPolicy]:
    """Both players of a pair as they are imitated: by their own choices where the model has them, else as the average player."""
    first, second = (
        baselines.load(player if player in baselines.players(game) else None, game)
        for player, game in zip(people_of(pair).players, pair.seats, strict=True)
    )
    return first, second


def _recent(plays: Plays, strokes: pa.Table) -> list[counts.Habit]:
    names = strokes["match"].unique().to_pylist()
    if len(names) < 2:
        return []
    # Matches without a date are in the order of the table.
    last = max(enumerate(names), key=lambda each: (date_of(each[1]) or datetime.date.min, each[0]))[1]
    which = strokes["match"].to_numpy(zero_copy_only=False) == last
    return counts.habits(tally(plays.take(which)), tally(plays.take(~which)))


def _as_known(name: str, known: Sequence[str]) -> str:
    """The player that a name means as people type it: ``Viktor Axelsen``, ``AXELSEN Viktor`` or ``viktor-axelsen``."""

    def words(text: str) -> list[str]:
        return sorted(text.casefold().replace("-", " ").replace("_", " ").split())

    return name if name in known else next((each for each in known if words(each) == words(name)), name)


def _discipline(skill: Skill, names: Sequence[str], strokes: pa.Table) -> str:
    """The discipline that all players share. Raises AnalysisError: they share none, or one is unknown."""
    kinds = {}
    for name in names:
        if name in skill.players:
            kinds[name] = skill.discipline_of(name)
        elif len(rows := strokes.filter(pa.compute.equal(strokes["player"], name))):
            kinds[name] = PROFILES[DISCIPLINES.index(rows["discipline"][0].as_py())]
        else:
            close = difflib.get_close_matches(name, skill.players, n=3, cutoff=0.4)
            hint = f"; did you mean {', '.join(close)}?" if close else ""
            raise AnalysisError(f"no strokes of the player {name!r} in the model or the data{hint} (`--list` lists all players)")
    if len(set(kinds.values())) != 1:
        raise AnalysisError(f"{' and '.join(f'{name} plays {kind}' for name, kind in kinds.items())}: expected one discipline")
    return str(next(iter(kinds.values())))


def earned(rally: F64) -> F64:
    """Probabilities of winning a rally, reduced to what they were worth in matches that nobody fitted; any shape."""
    return np.asarray(expit(EARNED * logit(rally)))


def season(strokes: pa.Table, plays: Plays, player: str) -> list[Form]:
    """Figures of a player in each dated match, in their order."""
    match, who = (strokes[name].to_numpy(zero_copy_only=False).astype(object) for name in ("match", "player"))
    attack = np.isin(plays.shot, [SHOTS.index(name) for name in ATTACKS]).astype(np.float64)
    found = []
    for name in strokes["match"].unique().to_pylist():
        mine, day = (match == name) & (who == player), date_of(name)
        if day is None or not mine.any():
            continue
        against = strokes["opponent"][int(mine.argmax())].as_py()
        result = met(strokes.filter(pa.array(match == name)), player, against)

        def share(count: float, n: int) -> Estimate:
            return Estimate(count / n, *counts.interval(count / n, n)) if n else Estimate(math.nan, math.nan, math.nan)

        n = int(mine.sum())
        ends = (share(float(each[mine].sum()), n) for each in (plays.fault, plays.winner, attack))
        found.append(Form(day, against, result.points, share(result.points_won, result.points), n, *ends))
    return sorted(found)
