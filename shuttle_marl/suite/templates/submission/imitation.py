"""A method for imitate-v0: frequencies of strokes after each incoming stroke."""

from typing import Any

import numpy as np


class Imitator:
    """Learns from strokes of people."""

    def fit(self, strokes: Any) -> Any:
        """Learn from the training matches; returns a policy."""
        game = strokes.game
        played = np.full((game.n_strokes + 1, game.n_strokes), 0.1)
        np.add.at(played, (game.incoming(strokes.state), game.pair_stroke[strokes.pair]), 1)
        return Frequencies(played)


class Frequencies:
    """Legal strokes in proportion to their frequencies."""

    def __init__(self, played: Any) -> None:
        self.played = played

    def probabilities(self, states: Any) -> Any:
        """One row of probabilities of all strokes for each state."""
        weight = self.played[states.incoming] * states.mask
        return weight / weight.sum(axis=1, keepdims=True)
