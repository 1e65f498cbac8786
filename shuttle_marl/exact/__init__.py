"""Exact values: minimax, robust and regularised play, best responses, cross-play, regret, holes, visits. See ``docs/exact.md``.

Names are imported when first used, because the solvers need numba, which takes longer to import than a command's help.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from shuttle_marl.exact.away import Spread
    from shuttle_marl.exact.fixed_point import TOLERANCE, ExactError
    from shuttle_marl.exact.losses import Hole, Holes, holes
    from shuttle_marl.exact.match import Odds, least_gain
    from shuttle_marl.exact.occupancy import Visits, visits
    from shuttle_marl.exact.optimal import (
        Exploitability,
        Regret,
        Response,
        RobustSolution,
        Solution,
        best_response,
        nash_conv,
        policy_regret,
        solve,
        solve_robust,
    )
    from shuttle_marl.exact.profile import Crossplay, PairPolicy, ProfileValue, StatePolicy, crossplay, evaluate
    from shuttle_marl.exact.soft import SoftSolution, solve_soft

__all__ = [
    "TOLERANCE",
    "Crossplay",
    "ExactError",
    "Exploitability",
    "Hole",
    "Holes",
    "Odds",
    "PairPolicy",
    "ProfileValue",
    "Regret",
    "Response",
    "RobustSolution",
    "SoftSolution",
    "Solution",
    "Spread",
    "StatePolicy",
    "Visits",
    "best_response",
    "crossplay",
    "evaluate",
    "holes",
    "least_gain",
    "nash_conv",
    "policy_regret",
    "solve",
    "solve_robust",
    "solve_soft",
    "visits",
]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "away": ("Spread",),
        "fixed_point": ("TOLERANCE", "ExactError"),
        "losses": ("Hole", "Holes", "holes"),
        "match": ("Odds", "least_gain"),
        "occupancy": ("Visits", "visits"),
        "optimal": (
            "Exploitability",
            "Regret",
            "Response",
            "RobustSolution",
            "Solution",
            "best_response",
            "nash_conv",
            "policy_regret",
            "solve",
            "solve_robust",
        ),
        "profile": ("Crossplay", "PairPolicy", "ProfileValue", "StatePolicy", "crossplay", "evaluate"),
        "soft": ("SoftSolution", "solve_soft"),
    },
)
