"""Outlook of a match between two players: probabilities of winning rallies, games and the match, with their uncertainty."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from shuttle_marl.analysis.advice import NORMAL, TOLERANCE, Refitted, error_of
from shuttle_marl.arrays import F64
from shuttle_marl.exact import Odds, Sensitivity, sensitivity
from shuttle_marl.game.pairs import PairGame
from shuttle_marl.game.scoring import game_win_probability
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.skill import GROUPS, Skill

_STEP: Final = 1e-4


def slopes_by_group(found: Sensitivity, skill: Skill) -> list[F64]:
    """``[3, 7]`` for the strokes of each seat: derivatives by the general offset and those of the groups of shots."""

    def by_group(win: F64) -> F64:
        groups = np.stack([win[:, skill.group == group].sum(axis=1) for group in range(len(GROUPS))], axis=1)
        return np.concatenate([win.sum(axis=1, keepdims=True), groups], axis=1)

    return [by_group(win) for win in found.win]


def skill_error(pair: PairGame, slopes: Sequence[F64]) -> float:
    """Standard deviation of the probability of winning a rally by the uncertainty of both players' skill."""
    both = (pair.players, pair.players[::-1])
    variances = (pair.skill.variances(*names, pair.date) for names in both)
    return math.sqrt(sum(float((slope**2 * each).sum()) for slope, each in zip(slopes, variances, strict=True)))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Outlook:
    """Probabilities that the first player wins, each with its 90 % interval.

    Attributes:
        serving, receiving: a rally that the player serves, and receives.
        rally: a rally, both serving equally often.
        game, match: a game, and the match.
    """

    serving: Estimate
    receiving: Estimate
    rally: Estimate
    game: Estimate
    match: Estimate


def outlook(found: Refitted) -> Outlook:
    """Outlook of a pair; the intervals contain the uncertainty of the skill and of the game."""
    odds, refits = found.home.odds, [meeting.odds for meeting in found.refits]
    slopes = slopes_by_group(sensitivity(*found.home.policies, tolerance=TOLERANCE), found.pair.skill)
    skill = skill_error(found.pair, slopes)

    def estimate(figure: Callable[[Odds], float]) -> Estimate:
        def moved(by: float) -> Odds:
            return dataclasses.replace(odds, serving=odds.serving + by, receiving=odds.receiving + by)

        slope = (figure(moved(_STEP)) - figure(moved(-_STEP))) / (2 * _STEP)
        of_game = error_of([figure(each) for each in refits]) if len(refits) > 1 else 0.0
        width = NORMAL * math.hypot(slope * skill, of_game)
        value = figure(odds)
        return Estimate(value, max(0.0, value - width), min(1.0, value + width))

    return Outlook(
        serving=estimate(lambda o: o.serving),
        receiving=estimate(lambda o: o.receiving),
        rally=estimate(lambda o: o.rally),
        game=estimate(lambda o: float(game_win_probability(o.serving, o.receiving))),
        match=estimate(Odds.match),
    )
