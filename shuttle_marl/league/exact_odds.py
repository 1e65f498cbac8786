"""Exact figures of the entrants of a tournament: the limits of its samples after infinitely many matches."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy
from shuttle_marl.league.entrants import Entrant

Floats = npt.NDArray[np.float64]

_DECIMALS: Final = 6
"""Figures are rounded to so many decimals, far above their error bound, so that files have the same bytes on every machine."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class ExactOdds:
    """Exact figures of N entrants; NaN for one without a table: it reads the score, or it forfeits.

    Attributes:
        names: the entrants.
        match: ``[N, N]`` probability that the entrant of the row wins a match against that of the column, the first server
            drawn at random.
        exploitability: ``[N]`` what the best response to an entrant gains, as a value from 0 to 1.
        normalised_score: ``[N]`` 0 for ``bc``, 1 for the best response to it, by rallies won against ``bc``; NaN for all if the
            game has no ``bc``.
        problem: why there are no figures at all; empty if there are.
    """

    names: tuple[str, ...]
    match: Floats
    exploitability: Floats
    normalised_score: Floats
    problem: str = ""

    def share(self, name: str, opponents: Sequence[str]) -> float:
        """Expected share of the matches won against those of the opponents that have a table; NaN without any."""
        shares = self.match[self.names.index(name), [self.names.index(other) for other in opponents]]
        known = shares[~np.isnan(shares)]
        return float(known.mean()) if len(known) else float("nan")

    def pair(self, names: tuple[str, str]) -> float:
        """Probability that the first of two entrants wins a match; NaN if one has no table."""
        return float(self.match[self.names.index(names[0]), self.names.index(names[1])])


def exact_odds(game: Game, entrants: Sequence[Entrant]) -> ExactOdds:
    """Solve every pair of entrants, and the best response to each."""
    from shuttle_marl.exact import ExactError  # noqa: PLC0415  numba

    blank = ExactOdds(
        names=tuple(entrant.name for entrant in entrants),
        match=np.full((len(entrants), len(entrants)), np.nan),
        exploitability=np.full(len(entrants), np.nan),
        normalised_score=np.full(len(entrants), np.nan),
    )
    tables = {i: entrant.table for i, entrant in enumerate(entrants) if entrant.table is not None}
    try:
        return _fill(blank, game, tables) if tables else blank
    except ExactError as error:
        return dataclasses.replace(blank, problem=str(error))


def _fill(blank: ExactOdds, game: Game, tables: Mapping[int, TabulatedPolicy]) -> ExactOdds:
    from shuttle_marl.exact import crossplay, nash_conv  # noqa: PLC0415  numba
    from shuttle_marl.policy.scorecard import Scorer  # noqa: PLC0415  numba

    at, policies = list(tables), list(tables.values())
    try:
        scorer = Scorer(game)
    except PolicyError:
        scorer = None  # a game without behaviour-cloned players
    odds = crossplay(policies if scorer is None else [*policies, scorer.reference])
    match, exploitability, normalised = blank.match.copy(), blank.exploitability.copy(), blank.normalised_score.copy()
    match[np.ix_(at, at)] = odds.match()[: len(at), : len(at)]
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        exploitability[at] = [found.exploitability for found in threads.map(nash_conv, policies)]
    if scorer is not None:
        scores = [scorer.normalised(float(share)) for share in odds.rally[: len(at), -1]]
        normalised[at] = [np.nan if score is None else score for score in scores]
    # Adding 0 turns a rounded -0.0 into 0.0.
    match, exploitability, normalised = (np.round(x, _DECIMALS) + 0.0 for x in (match, exploitability, normalised))
    return dataclasses.replace(blank, match=match, exploitability=exploitability, normalised_score=normalised)
