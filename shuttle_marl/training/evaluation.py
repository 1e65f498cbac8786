"""How good a policy is, exactly, while it learns: odds against the opponents, the normalised score, exploitability."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from shuttle_marl import exact
from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.scorecard import REFERENCE

_TOLERANCE = 1e-5
"""Error bound of the values: far below what a figure of a learning curve can show."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Exact figures of a policy, means over the opponents where there are several.

    Attributes:
        rally_win: chance to win a rally, both serving equally often.
        match_win: chance to win a match, the first serve drawn by lot.
        normalised_score: 0 for ``bc``, 1 for the best response: the mean over the opponents of
            ``(J(pi) - J(bc)) / (J(best response) - J(bc))`` with J the chance to win a rally.
        exploitability: what the best response to the policy gains, as a value from 0 to 1.
    """

    rally_win: float
    match_win: float
    normalised_score: float
    exploitability: float


class Evaluator:
    """Evaluates policies against fixed opponents; solves what does not depend on the policy once.

    Args:
        game: the tables.
        opponents: tabulated.
    """

    def __init__(self, game: Game, opponents: Sequence[TabulatedPolicy]) -> None:
        self._opponents = opponents
        self._reference = tabulate(resolve(REFERENCE, game), game, REFERENCE)

    @functools.cached_property
    def _scales(self) -> list[tuple[float, float]]:
        """For each opponent, the chance of ``bc`` and of the best response to win a rally against it."""
        return [(self._rally(self._reference, o), exact.best_response(o).value.odds().rally) for o in self._opponents]

    def _rally(self, policy: TabulatedPolicy, opponent: TabulatedPolicy) -> float:
        return exact.evaluate(policy, opponent, tolerance=_TOLERANCE).odds().rally

    def evaluate(self, policy: TabulatedPolicy) -> Evaluation:
        """The figures of a policy."""
        odds = [exact.evaluate(policy, opponent, tolerance=_TOLERANCE).odds() for opponent in self._opponents]
        scores = [(o.rally - bc) / (best - bc) for o, (bc, best) in zip(odds, self._scales, strict=True)]
        return Evaluation(
            rally_win=float(np.mean([o.rally for o in odds])),
            match_win=float(np.mean([o.match() for o in odds])),
            normalised_score=float(np.mean(scores)),
            exploitability=exact.best_response(policy, tolerance=_TOLERANCE).value.odds().value,
        )
