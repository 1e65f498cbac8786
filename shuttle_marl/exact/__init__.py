"""Exact values of the game: minimax, best responses, exploitability, cross-play, regret, visits. See ``docs/exact.md``.

Names are imported when first used, because the solvers need numba, which takes longer to import than a command's help.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from shuttle_marl.exact.contraction import TOLERANCE
    from shuttle_marl.exact.errors import ExactError
    from shuttle_marl.exact.match import least_gain
    from shuttle_marl.exact.minimax import Solution, solve
    from shuttle_marl.exact.occupancy import Visits, visits
    from shuttle_marl.exact.odds import Odds
    from shuttle_marl.exact.pairwise import Crossplay, crossplay
    from shuttle_marl.exact.profile import ProfileValue, evaluate
    from shuttle_marl.exact.regret import Regret, policy_regret
    from shuttle_marl.exact.response import Exploitability, Response, best_response, nash_conv

__all__ = [
    "TOLERANCE",
    "Crossplay",
    "ExactError",
    "Exploitability",
    "Odds",
    "ProfileValue",
    "Regret",
    "Response",
    "Solution",
    "Visits",
    "best_response",
    "crossplay",
    "evaluate",
    "least_gain",
    "nash_conv",
    "policy_regret",
    "solve",
    "visits",
]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "contraction": ("TOLERANCE",),
        "pairwise": ("Crossplay", "crossplay"),
        "errors": ("ExactError",),
        "match": ("least_gain",),
        "minimax": ("Solution", "solve"),
        "odds": ("Odds",),
        "profile": ("ProfileValue", "evaluate"),
        "regret": ("Regret", "policy_regret"),
        "response": ("Exploitability", "Response", "best_response", "nash_conv"),
        "occupancy": ("Visits", "visits"),
    },
)
