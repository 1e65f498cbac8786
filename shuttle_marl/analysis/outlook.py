"""Outlook of a match between two players: probabilities of winning rallies, games and the match, with their uncertainty."""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from shuttle_marl.analysis.advice import NORMAL, TOLERANCE, Refitted, error_of
from shuttle_marl.base.arrays import F64
from shuttle_marl.exact import Odds, Sensitivity, sensitivity
from shuttle_marl.game.pairs import people_of
from shuttle_marl.game.scoring import game_win_probability
from shuttle_marl.game.shipped import Estimate, read_model_card
from shuttle_marl.game.skill import COMPONENTS, GROUPS, Skill
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy


def slopes_by_group(found: Sensitivity, skill: Skill) -> list[F64]:
    """``[3, 7]`` for the strokes of each seat: derivatives by the general offset and those of the groups of shots."""

    def by_group(win: F64) -> F64:
        groups = np.stack([win[:, skill.group == group].sum(axis=1) for group in range(len(GROUPS))], axis=1)
        return np.concatenate([win.sum(axis=1, keepdims=True), groups], axis=1)

    return [by_group(win) for win in found.win]


def skill_error(pair: Game, slopes: Sequence[F64]) -> float:
    """Standard deviation of the probability of winning a rally by the uncertainty of both players' skill."""
    people = people_of(pair)
    both = (people.players, people.players[::-1])
    variances = (people.skill.variances(*names, people.date) for names in both)
    return math.sqrt(sum(float((slope**2 * each).sum()) for slope, each in zip(slopes, variances, strict=True)))


def form_error(pair: Game, slopes: Sequence[F64]) -> float:
    """Standard deviation of the probability of winning a rally by the form of both players on a day.

    The model card has it as the effect of each side of a match on each component; 0 in models whose card does not.
    """
    card = read_model_card(people_of(pair).origin.folder)
    sides = [card.get("skill", {}).get("deviations", {}).get(name, {}).get("side", 0.0) for name in COMPONENTS]
    return math.sqrt(sum(float((slope[:, 0] ** 2 * np.square(sides)).sum()) for slope in slopes))


_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)


def spread_of(odds: Odds, deviation: float) -> tuple[list[Odds], F64]:
    """Odds that differ by a normal deviation of both probabilities, as points with weights."""

    def moved(by: float) -> Odds:
        serving, receiving = (min(1.0, max(0.0, p + by)) for p in (odds.serving, odds.receiving))
        return dataclasses.replace(odds, serving=serving, receiving=receiving)

    points, weights = spread(deviation)
    return [moved(by) for by in points.tolist()], weights


def spread(deviation: float) -> tuple[F64, F64]:
    """Points and weights of a normal deviation (Gauss-Hermite)."""
    if not deviation:
        return np.zeros(1), np.ones(1)
    return deviation * _NODES, np.asarray(_WEIGHTS / _WEIGHTS.sum())


@dataclasses.dataclass(frozen=True, kw_only=True)
class Outlook:
    """Probabilities that the first player wins, each with its 90 % interval.

    Attributes:
        serving, receiving: a rally that the player serves, and receives.
        rally: a rally, both serving equally often.
        game, match: a game, and the match.
        deviation: standard deviation of the probability of winning a rally, over which all of them are means.
    """

    serving: Estimate
    receiving: Estimate
    rally: Estimate
    game: Estimate
    match: Estimate
    deviation: float


def prior(pair: Game, first: TabulatedPolicy, second: TabulatedPolicy, odds: Odds) -> tuple[list[Odds], F64]:
    """Prior of the odds of two players before a match, with the uncertainty of skill and form."""
    slopes = slopes_by_group(sensitivity(first, second, tolerance=TOLERANCE), people_of(pair).skill)
    return spread_of(odds, math.hypot(skill_error(pair, slopes), form_error(pair, slopes)))


def outlook(found: Refitted) -> Outlook:
    """Outlook of a pair.

    Probabilities are means over the form of the day; the intervals contain the uncertainty of the skill and of the game.
    """
    odds, refits = found.home.odds, [meeting.odds for meeting in found.refits]
    slopes = slopes_by_group(sensitivity(*found.home.policies, tolerance=TOLERANCE), people_of(found.pair).skill)
    skill, form = skill_error(found.pair, slopes), form_error(found.pair, slopes)
    of_game = error_of([each.rally for each in refits]) if len(refits) > 1 else 0.0
    width, deviation = NORMAL * math.hypot(skill, of_game), math.hypot(form, skill, of_game)

    def estimate(figure: Callable[[Odds], float]) -> Estimate:
        def mean(about: Odds, deviation: float) -> float:
            points, weights = spread_of(about, deviation)
            return float(weights @ [figure(each) for each in points])

        def shifted(by: float) -> float:
            moved = dataclasses.replace(odds, serving=odds.serving + by, receiving=odds.receiving + by)
            return mean(moved, form)

        return Estimate(mean(odds, deviation), max(0.0, shifted(-width)), min(1.0, shifted(width)))

    return Outlook(
        serving=estimate(lambda o: o.serving),
        receiving=estimate(lambda o: o.receiving),
        rally=estimate(lambda o: o.rally),
        game=estimate(lambda o: float(game_win_probability(o.serving, o.receiving))),
        match=estimate(Odds.match),
        deviation=deviation,
    )
