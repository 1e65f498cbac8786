"""The game compiled to machine code: rallies by the thousand, against tabulated opponents, and whole tournaments."""

from shuttle_marl.kernel.core import KernelError
from shuttle_marl.kernel.matches import Matches, Played, play_matches
from shuttle_marl.kernel.rally import RallyBatch, Tally
from shuttle_marl.kernel.rows import IllegalStrokeError
from shuttle_marl.kernel.versus import VersusBatch

__all__ = [
    "IllegalStrokeError",
    "KernelError",
    "Matches",
    "Played",
    "RallyBatch",
    "Tally",
    "VersusBatch",
    "play_matches",
]
