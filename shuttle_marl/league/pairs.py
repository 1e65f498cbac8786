"""Predictions of the rallies and matches between all players of a discipline, each pair in its own game, with imitated policies,
solved exactly; beside real results.

The interval of a prediction contains the uncertainty of the players' skill: the posterior deviations of the offsets, by the
derivatives of the result (:mod:`shuttle_marl.exact.occupancy`). It does not contain that of the average game, nor the form of
the day.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.exact import Odds, sensitivity
from shuttle_marl.game.pairs import COMPONENTS, GROUPS, Day, Skill, load_skill, pair_game, people_of
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.shipped import Profile, model_folder
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.baselines import imitation
from shuttle_marl.policy.registry import tabulated
from shuttle_marl.reports.summary import AnalysisError, met

_NORMAL: Final = 1.959964
_TOLERANCE: Final = 1e-6
_REASONS: Final = 8
_SIDES: Final = ("strokes", "strokes received")
GENERAL: Final = "general"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Prediction:
    """Prediction of one pair, from the side of the first player.

    Attributes:
        rally_low, rally_high: its 95 % interval over the uncertainty of the skill.
        match_low, match_high: its 95 % interval.
        reasons: the offsets of both players with the largest effects, in points of 100 rallies; positive for the first player.
        rallies, rallies_won: real rallies between the two, and those that the first player won; 0 without data.
        matches, matches_won: the same of matches.
    """

    players: tuple[str, str]  # names
    hash: str  # hash of the game of the pair
    rally_win: float  # probability of winning a rally, both serving equally often
    rally_low: float
    rally_high: float
    match_win: float  # probability of winning a match
    match_low: float
    match_high: float
    reasons: dict[str, float]
    rallies: int = 0
    rallies_won: int = 0
    matches: int = 0
    matches_won: int = 0


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlayerRow:
    """A player in the table of predictions.

    Attributes:
        rally_win, match_win: mean probabilities of winning against all others.
    """

    name: str
    since: str  # day of the skill in ISO 8601
    strokes: int  # strokes of the player in the data of the model
    rally_win: float
    match_win: float


def players_of(discipline: Profile, game: str = "default", some: Sequence[str] = ()) -> list[str]:
    """Players of a discipline whose skill a model has; ``some``: these alone, in this order; empty: all.

    Raises:
        GameError: the model has no skill, or not of all these players.
        AnalysisError: fewer than two players, one given twice, or one of the other discipline.
    """
    skill = load_skill(model_folder(game))
    wrong = [name for name in some if skill.discipline_of(name) != discipline or some.count(name) > 1]
    if wrong or len(some) == 1:
        raise AnalysisError(f"--players {' '.join(some)}: expected two or more, each once, who play {discipline}'s singles")
    names = [*some] or [name for name in skill.players if skill.discipline_of(name) == discipline]
    if len(names) < 2:
        raise AnalysisError(f"--pairs {discipline}: the model has {len(names)} players of that discipline; a pair needs two")
    return names


def predict_pairs(
    players: Sequence[str], *, game: str = "default", date: Day = None, policy: str | None = None, rules: Rules = BWF
) -> Iterator[Prediction]:
    """Predict the result of each of the ``N (N - 1) / 2`` pairs of players.

    Args:
        date: day of the skill; None: the last one known.
        policy: name of the policy of all players; None: each imitated (``bc:NAME``), or ``bc`` where the model has no choices of
            the player.
        rules: of the matches.

    Raises:
        GameError: a player is unknown, or two are not of one discipline.
        PolicyError: the policy does not exist.
    """
    pairs = itertools.combinations(players, 2)
    return in_threads(lambda names: predict(pair_game(*names, date=date, game=game), policy, rules), pairs)


def predict(pair: Game, policy: str | None = None, rules: Rules = BWF) -> Prediction:
    """Predict the result of one pair; arguments and errors as for :func:`predict_pairs`."""
    people = people_of(pair)
    names = [policy or imitation(player, tables) for player, tables in zip(people.players, pair.seats, strict=True)]
    first, second = (tabulated(name, seat)[0] for name, seat in zip(names, pair.seats, strict=True))
    found, skill = sensitivity(first, second, tolerance=_TOLERANCE), people.skill
    odds, slopes = found.value.odds(), [_by_group(win, skill) for win in found.win]
    both = (people.players, people.players[::-1])
    variances = (skill.variances(*who, people.date) for who in both)
    width = _NORMAL * math.sqrt(sum(float((slope**2 * each).sum()) for slope, each in zip(slopes, variances, strict=True)))
    return Prediction(
        players=people.players,
        hash=pair.hash,
        rally_win=odds.rally,
        rally_low=max(0.0, odds.rally - width),
        rally_high=min(1.0, odds.rally + width),
        match_win=odds.match(rules),
        match_low=_moved(odds, -width).match(rules),
        match_high=_moved(odds, width).match(rules),
        reasons=_reasons(pair, slopes),
    )


def _by_group(win: F64, skill: Skill) -> F64:
    """``[3, 7]`` derivatives by the general offset and those of the groups of shots."""
    groups = np.stack([win[:, skill.group == group].sum(axis=1) for group in range(len(GROUPS))], axis=1)
    return np.concatenate([win.sum(axis=1, keepdims=True), groups], axis=1)


def _moved(odds: Odds, by: float) -> Odds:
    serving, receiving = (min(1.0, max(0.0, p + by)) for p in (odds.serving, odds.receiving))
    return dataclasses.replace(odds, serving=serving, receiving=receiving)


def _reasons(pair: Game, slopes: Sequence[F64]) -> dict[str, float]:
    """Points in 100 rallies by player, component, role and group, the largest ones; to first order."""
    names, people = (GENERAL, *GROUPS), people_of(pair)
    found: dict[str, float] = {}
    for seat, slope in enumerate(slopes):
        for role, player in enumerate((people.players[seat], people.players[1 - seat])):
            if player not in people.skill.players:
                continue
            points = 100 * slope * people.skill.offset[people.skill.knot(player, people.date), :, role]
            for component, group in np.ndindex(points.shape):
                what = f"{player}: {COMPONENTS[component]} of {_SIDES[role]}, {names[group]}"
                found[what] = round(float(points[component, group]), 3)
    return dict(sorted(found.items(), key=lambda each: -abs(each[1]))[:_REASONS])


def with_results(predictions: Sequence[Prediction], strokes: pa.Table) -> list[Prediction]:
    """Predictions beside the real results of a table of strokes of schema :data:`shuttle_marl.data.schema.STROKES`."""
    found = [(each, met(strokes, *each.players)) for each in predictions]
    return [
        dataclasses.replace(
            each, rallies=real.points, rallies_won=real.points_won, matches=real.matches, matches_won=real.matches_won
        )
        for each, real in found
    ]


def ranked(players: Sequence[str], predictions: Sequence[Prediction], game: str = "default", date: Day = None) -> list[PlayerRow]:
    """The players by their mean probability of winning a match against all others, best first."""
    skill = load_skill(model_folder(game))

    def mean(name: str, what: str) -> float:
        mine = [each for each in predictions if name in each.players]
        return float(np.mean([getattr(each, what) if each.players[0] == name else 1 - getattr(each, what) for each in mine]))

    rows = [
        PlayerRow(
            name=name,
            since=str(skill.since(name, date)),
            strokes=int(skill.strokes[skill.index(name)]),
            rally_win=mean(name, "rally_win"),
            match_win=mean(name, "match_win"),
        )
        for name in players
    ]
    return sorted(rows, key=lambda row: -row.match_win)
