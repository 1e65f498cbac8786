"""Exact values: minimax, robust and regularised play, best responses, cross-play, regret, holes, visits. See ``docs/exact.md``.

Names are imported when first used, because the solvers need numba, which takes longer to import than a command's help.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.exact.fixed_point import TOLERANCE, ExactError, Odds, ProfileValue
    from shuttle_marl.exact.occupancy import Hole, Holes, Regret, Visits, holes, policy_regret, visits
    from shuttle_marl.exact.odds import Crossplay, crossplay, least_gain
    from shuttle_marl.exact.optimal import (
        Equilibrium,
        Exploitability,
        Response,
        Solution,
        best_response,
        nash_conv,
        restricted_response,
        solve,
        solve_robust,
        solve_soft,
    )
    from shuttle_marl.exact.profile import PairPolicy, StatePolicy, evaluate, moved

__all__ = [
    "TOLERANCE",
    "Crossplay",
    "Equilibrium",
    "ExactError",
    "Exploitability",
    "Hole",
    "Holes",
    "Odds",
    "PairPolicy",
    "ProfileValue",
    "Regret",
    "Response",
    "Solution",
    "StatePolicy",
    "Visits",
    "best_response",
    "crossplay",
    "evaluate",
    "holes",
    "least_gain",
    "moved",
    "nash_conv",
    "policy_regret",
    "restricted_response",
    "solve",
    "solve_robust",
    "solve_soft",
    "visits",
]

__getattr__, __dir__ = lazily(__name__)
