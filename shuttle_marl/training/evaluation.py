"""Exact figures of a policy while it learns: odds against the opponents, the normalised score, exploitability."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from shuttle_marl.exact.known import best_odds, pair_odds
from shuttle_marl.exact.match import Odds, normalised_score
from shuttle_marl.exact.optimal import best_response
from shuttle_marl.exact.profile import InducedChain, evaluate_chains, induced
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.scorecard import REFERENCE

_TOLERANCE = 1e-5
"""Error bound of the values: far below what a figure of a learning curve can show."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Exact figures of a policy, means over the opponents where there are several.

    Attributes:
        rally_win: probability of winning a rally, both serving equally often.
        match_win: probability of winning a match, the first server drawn at random.
        normalised_score: 0 for ``bc``, 1 for the best response: the mean over the opponents of
            ``(J(pi) - J(bc)) / (J(best response) - J(bc))`` with J the probability of winning a rally, without those to whom
            ``bc`` is a best response already; None if it is one to all of them.
        exploitability: what the best response to the policy gains, as a value from 0 to 1; None if it was not asked for.
    """

    rally_win: float
    match_win: float
    normalised_score: float | None
    exploitability: float | None

    @property
    def score_text(self) -> str:
        """The normalised score in words."""
        return "no normalised score" if self.normalised_score is None else f"normalised score {self.normalised_score:.3f}"

    @property
    def exploitability_text(self) -> str:
        """The exploitability in words."""
        return "no exploitability" if self.exploitability is None else f"exploitability {self.exploitability:.3f}"


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
    def _scales(self) -> list[tuple[Odds, Odds]]:
        """For each opponent, the odds of ``bc`` and of the best response against it."""
        reference = pair_odds([(self._reference, opponent) for opponent in self._opponents])
        return list(zip(reference, best_odds(self._opponents), strict=True))

    @functools.cached_property
    def _chains(self) -> list[InducedChain]:
        return [_chain(opponent) for opponent in self._opponents]

    def _odds(self, own: InducedChain) -> list[Odds]:
        """Odds of a policy against each opponent."""
        return [evaluate_chains(own, chain, tolerance=_TOLERANCE).odds() for chain in self._chains]

    def evaluate(self, policy: TabulatedPolicy, *, exploitability: bool = True) -> Evaluation:
        """The figures of a policy.

        Args:
            policy: of the same game.
            exploitability: compute it too, which takes half of the time.
        """
        own = induced(policy)
        odds = self._odds(own)
        found = [
            normalised_score(o.rally, bc.rally, best.rally, error_bound=bc.error_bound + best.error_bound)
            for o, (bc, best) in zip(odds, self._scales, strict=True)
        ]
        scores = [score for score in found if score is not None]
        return Evaluation(
            rally_win=float(np.mean([o.rally for o in odds])),
            match_win=float(np.mean([o.match() for o in odds])),
            normalised_score=float(np.mean(scores)) if scores else None,
            exploitability=best_response(own, tolerance=_TOLERANCE).value.odds().value if exploitability else None,
        )


# Opponents are few, and the same ones in all runs of a study.
@functools.lru_cache(maxsize=2)
def _chain(opponent: TabulatedPolicy) -> InducedChain:
    return induced(opponent)
