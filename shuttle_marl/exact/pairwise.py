"""Everybody against everybody, exactly: what a round robin would show after infinitely many matches."""

import dataclasses
import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from shuttle_marl.exact.contraction import TOLERANCE
from shuttle_marl.exact.errors import ExactError
from shuttle_marl.exact.induced import check_same_layout, induced
from shuttle_marl.exact.profile import evaluate_chains
from shuttle_marl.game.scoring import BWF, Rules, match_win_probability
from shuttle_marl.game.table import TabulatedPolicy

Floats = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Crossplay:
    """The odds of N policies against each other.

    Attributes:
        serving: ``[N, N]`` chance that the policy of the row wins a rally that it serves against the policy of the column.
        error_bound: every chance is within this of the true one.
    """

    serving: Floats
    error_bound: float

    @property
    def receiving(self) -> Floats:
        """``[N, N]`` chance that the policy of the row wins a rally that the policy of the column serves."""
        return 1 - self.serving.T

    @property
    def rally(self) -> Floats:
        """``[N, N]`` chance that the policy of the row wins a rally, both serving equally often."""
        return (self.serving + self.receiving) / 2

    def match(self, rules: Rules = BWF) -> Floats:
        """``[N, N]`` chance that the policy of the row wins a match, the first serve drawn by lot."""
        return match_win_probability(self.serving, self.receiving, rules=rules)


def crossplay(
    policies: Sequence[TabulatedPolicy], *, tolerance: float = TOLERANCE, progress: Callable[[], object] | None = None
) -> Crossplay:
    """The exact odds of every pair of policies, each against itself too.

    Pairs are solved on all cores; which core solves a pair never changes its odds.

    Args:
        policies: N policies of games with the same layout.
        tolerance: largest error bound of a value that is good enough.
        progress: called whenever one of the ``N (N + 1) / 2`` pairs is solved.

    Raises:
        ExactError: there is no policy, two games have different layouts, or play may go on for ever.
    """
    if not policies:
        raise ExactError("crossplay of no policies: give one or more")
    for policy in policies[1:]:
        check_same_layout(policies[0].game, policy.game)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        chains = list(threads.map(induced, policies))
        pairs = list(itertools.combinations_with_replacement(range(len(policies)), 2))

        def serve_odds(pair: tuple[int, int]) -> tuple[float, float, float]:
            value = evaluate_chains(chains[pair[0]], chains[pair[1]], tolerance=tolerance)
            return value.odds(0).serving, value.odds(1).serving, value.odds().error_bound

        serving = np.empty((len(policies), len(policies)))
        bound = 0.0
        for (i, j), (first, second, error) in zip(pairs, threads.map(serve_odds, pairs), strict=True):
            serving[i, j], serving[j, i] = first, second
            bound = max(bound, error)
            if progress is not None:
                progress()
    return Crossplay(serving=serving, error_bound=bound)
