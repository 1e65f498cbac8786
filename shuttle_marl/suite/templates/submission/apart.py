"""A method for rounds of exploit and equilibrium, which sees what it plays alone: it plays at random, and then what won most.

It runs apart from shuttle_marl, with Python, NumPy and this folder.
"""

from typing import Any

import numpy as np


def train(setting: Any) -> Any:
    """Learn within the budget of strokes; returns an object with probabilities, and positions where they are hidden."""
    n, rng = setting.mask.shape[1], np.random.default_rng(setting.seed)
    worth, state = np.zeros(n), setting.reset(256)
    alone = len(setting.feasible) > 0 and not setting.opponents  # positions count as strokes
    for _ in range(setting.budget // (512 if alone else 256)):
        strokes = np.where(setting.mask[state], rng.random((256, n)), -1).argmax(axis=1)
        waits, places = setting.waits, np.zeros(256, dtype=np.int64)
        if len(setting.feasible):
            places = np.where(setting.feasible[state], rng.random((256, 9)), -1).argmax(axis=1)
        state, reward, _ = setting.step(np.where(waits, n + places, strokes), *((places,) if alone else ()))
        np.add.at(worth, strokes[~waits], reward[~waits])
    return Player(worth)


class Player:
    """The legal stroke that won most, and every feasible position equally often."""

    def __init__(self, worth: Any) -> None:
        self.worth = worth

    def probabilities(self, _observation: Any, mask: Any) -> Any:
        """``[S, n]`` probabilities of the strokes in all states."""
        return np.eye(mask.shape[1])[np.where(mask, self.worth, -np.inf).argmax(axis=1)]

    def positions(self, _observation: Any, feasible: Any) -> Any:
        """``[S, 9]`` probabilities of the positions in all states."""
        return feasible / np.maximum(feasible.sum(axis=1, keepdims=True), 1)
