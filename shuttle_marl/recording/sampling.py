"""Which rallies are recorded: ``--record all|sample:N|none``."""

import dataclasses
import re
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.game import draws
from shuttle_marl.recording.schema import Rallies, RecordingError

if TYPE_CHECKING:
    from shuttle_marl.recording.header import LogHeader

_SAMPLE_KEY: Final = 0x53414D504C45
"""Sets the lots of the sample apart from the draws of the game; "SAMPLE" in ASCII."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sampling:
    """Which rallies are recorded.

    Whole matches are drawn by lot, so that their scores can be followed; matches that share their draws (two in a league,
    with the seats swapped) are in the sample together. The lot depends on the seed, the pairing and the number of the match
    alone, never on what happens in it, on batches or on threads.

    Attributes:
        every: record one match in so many: 1 all, 0 none.
    """

    every: int = 1

    @classmethod
    def parse(cls, text: str) -> "Sampling":
        """Read ``all``, ``none``, or ``sample:N`` with N from 1 on.

        Raises:
            RecordingError: anything else.
        """
        if text in ("all", "none"):
            return cls(every=int(text == "all"))
        found = re.fullmatch(r"sample:([1-9]\d{0,17})", text)
        if found is None:
            raise RecordingError(f"--record {text}: expected all, none, or sample:N to record one match in N")
        return cls(every=int(found[1]))

    def __str__(self) -> str:
        return {0: "none", 1: "all"}.get(self.every, f"sample:{self.every}")

    def of(self, header: "LogHeader", rallies: Rallies) -> Rallies:
        """The rallies that are recorded."""
        if self.every == 1 or not len(rallies):
            return rallies
        return rallies.select(self.keeps(header, rallies.pairing, rallies.match))

    def keeps(
        self, header: "LogHeader", pairing: npt.NDArray[np.integer], match: npt.NDArray[np.integer]
    ) -> npt.NDArray[np.bool_]:
        """``[R]`` whether matches are recorded, by the number of their pairing and in their pairing."""
        if self.every <= 1:
            return np.full(len(match), self.every == 1)
        keys = np.array(header.pairings, dtype=np.uint64)[pairing]
        lot = draws.stream(header.seed, _SAMPLE_KEY, keys, match.astype(np.int64) // header.matches_per_draw)
        chosen: npt.NDArray[np.bool_] = lot % np.uint64(self.every) == 0
        return chosen
