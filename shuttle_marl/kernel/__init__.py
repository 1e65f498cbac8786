"""The game compiled to machine code: rallies by the thousand, against tabulated opponents, and whole tournaments.

Names are imported when first used, because numba takes longer to import than a command's help.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from shuttle_marl.kernel.checks import KernelError
    from shuttle_marl.kernel.core import Players, pack
    from shuttle_marl.kernel.lockstep import Matches, MatchResults
    from shuttle_marl.kernel.match_versus import MatchVersusBatch
    from shuttle_marl.kernel.matches import play_matches
    from shuttle_marl.kernel.rally import RallyBatch, Tally
    from shuttle_marl.kernel.sampling import Distinct, RallySampler, play_rallies
    from shuttle_marl.kernel.versus import VersusBatch

__all__ = [
    "Distinct",
    "KernelError",
    "MatchResults",
    "MatchVersusBatch",
    "Matches",
    "Players",
    "RallyBatch",
    "RallySampler",
    "Tally",
    "VersusBatch",
    "pack",
    "play_matches",
    "play_rallies",
]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "checks": ("KernelError",),
        "core": ("Players", "pack"),
        "lockstep": ("MatchResults", "Matches"),
        "match_versus": ("MatchVersusBatch",),
        "matches": ("play_matches",),
        "rally": ("RallyBatch", "Tally"),
        "sampling": ("Distinct", "RallySampler", "play_rallies"),
        "versus": ("VersusBatch",),
    },
)
