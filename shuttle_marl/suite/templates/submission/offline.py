"""A method for offline-v1: the strokes that won most of the rallies of the log, after each incoming stroke."""

from typing import Any, ClassVar

import numpy as np


class Learner:
    """Sees its own transitions alone; without ``track``, the strokes of both players."""

    track: ClassVar[str] = "own"

    def fit(self, data: Any) -> Any:
        """Learn from the log; returns a policy."""
        n = data.game.n_strokes
        won, played = np.full((2, n + 1, n), 2.0), np.full((2, n + 1, n), 5.0)
        cell = (data.game.contact(data.state), data.game.incoming(data.state), data.stroke)
        np.add.at(won, cell, data.won)
        np.add.at(played, cell, 1)
        return Greedy(won / played)


class Greedy:
    """The legal stroke with the largest fraction of rallies won."""

    def __init__(self, worth: Any) -> None:
        self.worth = worth

    def probabilities(self, states: Any) -> Any:
        """One row of probabilities of all strokes for each state."""
        best = np.where(states.mask, self.worth[states.contact, states.incoming], -1).argmax(axis=1)
        return np.eye(states.game.n_strokes)[best]
