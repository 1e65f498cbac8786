"""The player without an idea: every legal stroke is as likely as any other."""

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.policy import States


class UniformPolicy:
    """Uniform over the legal strokes: the floor that every policy has to beat."""

    def probabilities(self, states: States) -> npt.NDArray[np.float64]:
        """``[B, n]`` one over the number of legal strokes."""
        mask = states.mask
        p: npt.NDArray[np.float64] = mask / mask.sum(axis=1, keepdims=True)
        return p
