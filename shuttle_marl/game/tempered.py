"""A policy made sharper or flatter: temperature and greedy play."""

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.policy import Policy, PolicyError, States, checked_probabilities, reads_score


@dataclasses.dataclass(frozen=True, eq=False)
class TemperedPolicy:
    """Chances of ``base`` raised to 1 / temperature and normalised; temperature 0 plays the likeliest stroke.

    Of several likeliest strokes, temperature 0 plays the one that comes first in the catalogue. A stroke that the base
    never plays is never played.

    Attributes:
        base: the policy that is sharpened (temperature below 1) or flattened (above 1).
        temperature: finite and not negative.
    """

    base: Policy
    temperature: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.temperature) and self.temperature >= 0):
            raise PolicyError(f"temperature {self.temperature!r}: expected a finite number, 0 (greedy) or above")

    @property
    def reads_score(self) -> bool:
        """Whether the base reads the score."""
        return reads_score(self.base)

    def probabilities(self, states: States) -> npt.NDArray[np.float64]:
        """``[B, n]`` tempered chances.

        Raises:
            PolicyError: the base returned no distribution over the legal strokes.
        """
        p = checked_probabilities(self.base, states, type(self.base).__name__)
        best = p.max(axis=1, keepdims=True)
        if self.temperature == 0:
            greedy = np.zeros_like(p)
            greedy[np.arange(len(p)), p.argmax(axis=1)] = 1.0
            return greedy
        with np.errstate(under="ignore"):
            weight = (p / best) ** (1 / self.temperature)  # the best stroke keeps weight 1, so nothing overflows
        tempered: npt.NDArray[np.float64] = weight / weight.sum(axis=1, keepdims=True)
        return tempered
