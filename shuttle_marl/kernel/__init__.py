"""The game compiled by numba: batches of rallies, tabulated opponents, and tournaments.

Names are imported when first used, because numba takes longer to import than a command's help.
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.kernel.core import KernelError, struck
    from shuttle_marl.kernel.matches import Matches, MatchResults, play_matches, wrong_outcomes
    from shuttle_marl.kernel.players import Players, pack
    from shuttle_marl.kernel.rally import MatchBatch, RallyBatch
    from shuttle_marl.kernel.sampling import Assess, RallySampler, play_rallies

__all__ = [
    "Assess",
    "KernelError",
    "MatchBatch",
    "MatchResults",
    "Matches",
    "Players",
    "RallyBatch",
    "RallySampler",
    "pack",
    "play_matches",
    "play_rallies",
    "struck",
    "wrong_outcomes",
]

__getattr__, __dir__ = lazily(__name__)
