"""Exact values of the game: minimax, best responses, exploitability, cross-play, regret, visits. See ``docs/exact.md``.

Names are imported when first used, because the solvers need numba, which takes longer to import than a command's help.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from shuttle_marl.exact.fixed_point import TOLERANCE, ExactError
    from shuttle_marl.exact.match import Odds, least_gain
    from shuttle_marl.exact.occupancy import Visits, visits
    from shuttle_marl.exact.optimal import (
        Exploitability,
        Regret,
        Response,
        Solution,
        best_response,
        nash_conv,
        policy_regret,
        solve,
    )
    from shuttle_marl.exact.profile import Crossplay, PairPolicy, ProfileValue, StatePolicy, crossplay, evaluate

__all__ = [
    "TOLERANCE",
    "Crossplay",
    "ExactError",
    "Exploitability",
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
    "least_gain",
    "nash_conv",
    "policy_regret",
    "solve",
    "visits",
]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "fixed_point": ("TOLERANCE", "ExactError"),
        "match": ("Odds", "least_gain"),
        "occupancy": ("Visits", "visits"),
        "optimal": ("Exploitability", "Regret", "Response", "Solution", "best_response", "nash_conv", "policy_regret", "solve"),
        "profile": ("Crossplay", "PairPolicy", "ProfileValue", "StatePolicy", "crossplay", "evaluate"),
    },
)
