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
from shuttle_marl.data.schema import DISCIPLINES, STROKES
from shuttle_marl.data.upstream import date_of
from shuttle_marl.dynamics.habits import NONE, Plays, Tally, load_habits, plays_of_strokes, tally
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.pairs import AVERAGE, Day, Skill, load_skill, pair_game
from shuttle_marl.game.shipped import PROFILES, RELIABLE, Estimate, factor_of, model_folder, resolve_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines
from shuttle_marl.reports.advice import Advice, Meeting, Refitted, advise, refitted
from shuttle_marl.reports.habits import (
    Brief,
    Ending,
    Habit,
    Option,
    brief,
    endings,
    habits,
    interval,
    is_short,
    plain,
)
from shuttle_marl.reports.summary import (
    AnalysisError,
    Met,
    hand_of,
    met,
    with_hands_of_model,
    won_or_lost,
)
from shuttle_marl.reports.waits import Wait, waits

PIECES: Final = 5
LEAST_EACH: Final = 0.01  # smaller gains per time, in rallies won, are of no use on court
ATTACKS: Final = ("smash", "half-smash", "net-kill")
EARNED: Final = 0.4
"""Share of the log-odds of a rally that a forecast keeps: the lower end of the 95 % interval of their slope on cross fits, .43,
rounded down (``calibration`` of ``python -m experiments.pairs --cross 4``)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Known:
    """Data about a player in the model.

    Attributes:
        strokes, matches: in the data of the model.
        since: day of the estimate of the skill; None: unknown player, who counts as the average one.
        hand: one of :data:`~shuttle_marl.game.court.HANDS`; None: not known, played as right-handed.
        imitated: whether the model has the player's own choices; else those of the average player are used.
    """

    name: str
    strokes: int
    matches: int
    since: datetime.date | None
    hand: str | None
    imitated: bool


@dataclasses.dataclass(frozen=True, kw_only=True)
class Realised:
    """Results of an advised shot type in annotated matches of the discipline.

    Attributes:
        strokes, won: how often it was played in its situation, and how many of these rallies its striker won.
        low, high: 90 % interval of the share.
        others, others_won: the same of all other strokes in the situation.
    """

    strokes: int
    won: int
    low: float
    high: float
    others: int
    others_won: int

    @property
    def confirms(self) -> bool:
        """Whether it won at least as often as the others."""
        return self.won * self.others >= self.others_won * self.strokes


class Form(NamedTuple):
    """Figures of a player in one dated match: shares of rallies won, and of strokes that were faults, winners and attacks."""

    day: datetime.date
    against: str
    rallies: int
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
        refits: number of refits behind the intervals.
        factor: share of predicted advantages that real matches realise; None: not known for this model.
        brief: page 1.
        rally: share of rallies that the player wins by the skill of both, no larger than such forecasts have earned.
        met: results of the two in the annotated matches; None without.
        season: figures of the opponent over dated matches.
        habits, endings: how the opponent plays beside other players of the discipline.
        targets: ``[9]`` shares of the opponent's strokes by target area; ``targets_usual``: of the others.
        target_strokes: number of strokes behind the targets.
        seen: strokes and matches of the opponent in the annotated matches; None: habits are those of the model's matches.
        waits: where both wait after their most frequent strokes, the player (0) and the opponent (1); empty without known
            positions.
        recent: the opponent's last match in the data beside the earlier ones; empty without two matches.
        beside: name of another opponent, and the habits of this one beside that one; None: not asked for.
        advice: strokes to play against the opponent, largest gain first.
        realised: their results in annotated matches, in the same order; empty without data.
        pair: the game, for staging examples.
        home: both players imitated in it.
    """

    player: Known | None
    opponent: Known
    discipline: str
    model: tuple[str, str]
    refits: int
    factor: Estimate | None
    brief: Brief
    rally: float | None
    met: Met | None
    season: Sequence[Form]
    habits: Sequence[Habit]
    endings: Sequence[Ending]
    targets: F64
    targets_usual: F64
    target_strokes: float
    seen: tuple[int, int] | None
    waits: Sequence[Wait]
    recent: Sequence[Habit]
    beside: tuple[str, Sequence[Habit]] | None
    advice: Sequence[Advice]
    realised: Sequence[Realised]
    pair: Game | None
    home: Meeting | None

    def renamed(self, name_of: Callable[[str], str]) -> "ScoutingReport":
        """The report with other names of player and opponents."""
        player = None if self.player is None else dataclasses.replace(self.player, name=name_of(self.player.name))
        opponent = dataclasses.replace(self.opponent, name=name_of(self.opponent.name))
        season = [form._replace(against=name_of(form.against)) for form in self.season]
        return dataclasses.replace(self, player=player, opponent=opponent, season=season)

    def as_json(self) -> dict[str, Any]:
        """The figures as JSON."""
        skipped = ("pair", "home", "advice")
        names = () if self.pair is None else self.pair.catalogue.names
        figures = {
            field.name: plain(getattr(self, field.name)) for field in dataclasses.fields(self) if field.name not in skipped
        }
        listed = []
        for advice in self.advice:
            shot, area, contact = advice.situation
            incoming = {
                "shot": SHOTS[shot] if shot >= 0 else None,
                "area": AREAS[area] if area >= 0 else None,
                "above": bool(contact),
            }
            own = {"stroke": names[advice.stroke], "usual": names[advice.usual], "situation": incoming}
            listed.append({**plain(dataclasses.replace(advice, states=np.zeros(0, np.int64))), **own})
        return {**figures, "advice": listed}


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
    """The players of a model, most strokes first.

    Raises:
        GameError: the model has no skill of players.
    """
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
    opponent: str,
    player: str | None = None,
    *,
    beside: str | None = None,
    model: str = "default",
    date: Day = None,
    data: pa.Table | None = None,
) -> ScoutingReport:
    """Compute a scouting report.

    Args:
        opponent: who is described.
        player: who is to win against the opponent; None: profile of the opponent alone.
        beside: another opponent, whose habits are shown beside; None: no second opponent.
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
    player, beside = (None if name is None else _as_known(name, known_names) for name in (player, beside))
    discipline = _discipline(skill, [name for name in (opponent, player, beside) if name is not None], strokes)
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
    plays, won = plays_of_strokes(strokes), won_or_lost(strokes)
    striker, receiver = (strokes[name].to_numpy(zero_copy_only=False) for name in ("player", "opponent"))
    mine, against = striker == opponent, receiver == opponent

    def tallies(name: str) -> tuple[Tally, Tally]:
        """Of a player and of the others."""
        which = striker == name
        return (tally(plays.take(which)), tally(plays.take(~which))) if which.any() else load_habits(folder)[name]

    own, others = tallies(opponent)
    page = brief(own, None if player is None else tallies(player)[0], plays, won, against, mine, ~against)
    found = None if player is None else refitted(pair(player, opponent))
    # A player whom the model does not know is an average one there, whom no advice would concern.
    advised, evidence = list[Advice](), list[Realised]()
    if found is not None and {opponent, player} <= set(skill.players):
        advised, evidence = _advised(found, plays, won, page.donts, counted=data is not None)
    return ScoutingReport(
        player=people[1],
        opponent=people[0],
        discipline=discipline,
        model=(model, pair(opponent, AVERAGE).hash if found is None else found.pair.hash),
        refits=0 if found is None else len(found.refits),
        factor=factor_of(resolve_game(model)),
        brief=page,
        rally=None if found is None else float(earned(np.array(found.home.value.odds().rally))),
        met=None if data is None or player is None else met(strokes, player, opponent),
        season=season(strokes, plays, opponent),
        habits=habits(own, others),
        endings=endings(own, others),
        targets=own.targets / max(1.0, own.targets.sum()),
        targets_usual=others.targets / max(1.0, others.targets.sum()),
        target_strokes=float(own.targets.sum()),
        seen=(int(mine.sum()), len(strokes.filter(mine)["match"].unique())) if mine.any() else None,
        waits=waits(strokes, (player or "", opponent)),
        recent=_recent(plays.take(mine), strokes.filter(mine)),
        beside=None if beside is None else (beside, habits(own, tallies(beside)[0])),
        advice=advised,
        realised=evidence,
        pair=None if found is None else found.pair,
        home=None if found is None else found.home,
    )


def _advised(
    found: Refitted, plays: Plays, won: F64, donts: Sequence[Option], *, counted: bool
) -> tuple[list[Advice], list[Realised]]:
    """Pieces of advice that gain enough; where strokes are counted only those that these confirm, with what they brought."""
    catalogue = found.pair.catalogue
    kinds = np.stack([catalogue.shot, catalogue.area], axis=1).tolist()
    advised: list[Advice] = []
    evidence: list[Realised] = []
    for advice in advise(found, most=2 * PIECES):
        kind = kinds[advice.stroke]
        if len(advised) == PIECES or advice.expected.value < LEAST_EACH * advice.often or is_short(*kind):
            continue
        if counted:
            real = _realised(plays, won, advice, kind[0])
            if real is None or not real.confirms or any(each.covers(*kind) for each in donts):
                continue
            evidence.append(real)
        advised.append(advice)
    return advised, evidence


def _realised(plays: Plays, won: F64, advice: Advice, kind: int) -> Realised | None:
    """Result of an advised shot type in annotated matches; None with too few strokes."""
    shot, area, contact = advice.situation
    there = plays.incoming == NONE if shot < 0 else (plays.incoming == shot) & (plays.met == area) & (plays.contact == contact)
    there &= np.isfinite(won)
    # By shot type, because where a fault was aimed at is not recorded.
    played = there & (plays.shot == kind)
    n, others = int(played.sum()), there & ~played
    if n < RELIABLE:
        return None
    wins = int(won[played].sum())
    low, high = interval(wins / n, n)
    return Realised(strokes=n, won=wins, low=low, high=high, others=int(others.sum()), others_won=int(won[others].sum()))


def _recent(plays: Plays, strokes: pa.Table) -> list[Habit]:
    names = strokes["match"].unique().to_pylist()
    if len(names) < 2:
        return []
    # Matches without a date are in the order of the table.
    last = max(enumerate(names), key=lambda each: (date_of(each[1]) or datetime.date.min, each[0]))[1]
    which = strokes["match"].to_numpy(zero_copy_only=False) == last
    return habits(tally(plays.take(which)), tally(plays.take(~which)))


def _as_known(name: str, known: Sequence[str]) -> str:
    """The player that a name means as people type it: ``Viktor Axelsen``, ``AXELSEN Viktor`` or ``viktor-axelsen``."""

    def words(text: str) -> list[str]:
        return sorted(text.casefold().replace("-", " ").replace("_", " ").split())

    return name if name in known else next((each for each in known if words(each) == words(name)), name)


def _discipline(skill: Skill, names: Sequence[str], strokes: pa.Table) -> str:
    """The discipline that all players share.

    Raises:
        AnalysisError: they share none, or one is unknown.
    """
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
            return Estimate(count / n, *interval(count / n, n)) if n else Estimate(math.nan, math.nan, math.nan)

        n = int(mine.sum())
        ends = (share(float(each[mine].sum()), n) for each in (plays.fault, plays.winner, attack))
        found.append(Form(day, against, result.rallies, share(result.rallies_won, result.rallies), n, *ends))
    return sorted(found)
