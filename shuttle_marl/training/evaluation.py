"""Exact evaluation of learning policies."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Final

import numpy as np

from shuttle_marl.exact.match import Odds, normalised_score
from shuttle_marl.exact.odds import best_odds, pair_odds
from shuttle_marl.exact.optimal import best_response
from shuttle_marl.exact.profile import InducedChain, evaluate, evaluate_chains, induced
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.scorecard import REFERENCE

_TOLERANCE: Final = 1e-5
"""Error bound of the values, far below the resolution of a learning curve."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Exact figures of a policy, averaged over its opponents.

    Attributes:
        rally_win: probability of winning a rally, averaged over both servers.
        match_win: probability of winning a match with a random first server.
        normalised_score: ``(J(pi) - J(bc)) / (J(best response) - J(bc))``, with J the probability of winning a rally; opponents
            to whom ``bc`` is a best response are left out, None if there are no others.
        exploitability: gain of a best response to the policy, from 0 to 1; None if it was not computed.
    """

    rally_win: float
    match_win: float
    normalised_score: float | None
    exploitability: float | None

    @property
    def score_text(self) -> str:
        """The normalised score, as text."""
        return "no normalised score" if self.normalised_score is None else f"normalised score {self.normalised_score:.3f}"

    @property
    def exploitability_text(self) -> str:
        """The exploitability, as text."""
        return "no exploitability" if self.exploitability is None else f"exploitability {self.exploitability:z.3f}"


class Evaluator:
    """Evaluates policies against fixed opponents; what does not depend on the policy is solved once."""

    def __init__(self, game: Game, opponents: Sequence[TabulatedPolicy]) -> None:
        self._opponents = opponents
        self._reference = tabulate(resolve(REFERENCE, game), game)

    @functools.cached_property
    def _scales(self) -> list[tuple[Odds, Odds]]:
        """Odds of ``bc`` and of the best response against each opponent."""
        reference = pair_odds([(self._reference, opponent) for opponent in self._opponents])
        return list(zip(reference, best_odds(self._opponents), strict=True))

    @functools.cached_property
    def _chains(self) -> list[InducedChain]:
        return [_chain(opponent) for opponent in self._opponents]

    def evaluate(self, policy: TabulatedPolicy, *, exploitability: bool = True) -> Evaluation:
        """Evaluate a policy of the same game; ``exploitability`` takes half of the time."""
        known: TabulatedPolicy | InducedChain
        if policy.game.recovery is None:
            known = own = induced(policy)
            odds = [evaluate_chains(own, chain, tolerance=_TOLERANCE).odds() for chain in self._chains]
        else:  # where the opponent waits changes the chain
            known, odds = policy, [evaluate(policy, opponent, tolerance=_TOLERANCE).odds() for opponent in self._opponents]
        normalised = [
            normalised_score(o.rally, bc.rally, best.rally, error_bound=bc.error_bound + best.error_bound)
            for o, (bc, best) in zip(odds, self._scales, strict=True)
        ]
        scores = [score for score in normalised if score is not None]
        return Evaluation(
            rally_win=float(np.mean([o.rally for o in odds])),
            match_win=float(np.mean([o.match() for o in odds])),
            normalised_score=float(np.mean(scores)) if scores else None,
            exploitability=best_response(known, tolerance=_TOLERANCE).value.odds().value if exploitability else None,
        )


# The runs of a study share their few opponents.
@functools.lru_cache(maxsize=2)
def _chain(opponent: TabulatedPolicy) -> InducedChain:
    return induced(opponent)
