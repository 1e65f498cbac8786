"""A method for robust-v0: perfect play of the game in which every outcome is the worst of the refits for the striker."""

import dataclasses
from typing import Any

import numpy as np

from shuttle_marl.exact import solve
from shuttle_marl.game.tabulated import TabulatedPolicy


def train(setting: Any) -> Any:
    """Returns a policy: an object with probabilities, a name, or a table as here."""
    games = [setting.game, *setting.refits]
    # The first threshold is the probability of a fault.
    fault = np.max([game.threshold[:, :1] for game in games], axis=0)
    worst = dataclasses.replace(setting.game, threshold=np.maximum(setting.game.threshold, fault))
    return TabulatedPolicy(game=setting.game, cumulative=solve(worst).policy[0].cumulative)
