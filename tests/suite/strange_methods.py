"""Methods as a stranger writes them, in a file without this package."""

import pathlib
import socket
from typing import Any

import numpy as np
import pytest


def learner(setting: Any) -> Any:
    """Plays the budget, and counts which stroke wins; positions are the first feasible ones."""
    n, rng = setting.mask.shape[1], np.random.default_rng(setting.seed)
    state = setting.reset(64)
    assert setting.observation[state].shape == (64, 60)
    if setting.opponents:
        assert (setting.reset(64) != state).any(), "each reset has other luck"
    worth, state = np.zeros(n), setting.reset(64)
    together = len(setting.feasible) > 0 and not setting.opponents
    for _ in range(setting.budget // (128 if together else 64)):
        places = setting.feasible[state].argmax(axis=1) if len(setting.feasible) else np.zeros(64, np.int64)
        strokes = np.array([rng.choice(np.flatnonzero(mask)) for mask in setting.mask[state]])
        actions = np.where(setting.waits, n + places, strokes)
        alone = (places,) if together else ()
        waits = setting.waits
        state, reward, _ = setting.step(actions, *alone)
        np.add.at(worth, strokes[~waits], reward[~waits])
    with pytest.raises(RuntimeError, match="used up"):
        setting.step(actions, *alone)
    return Best(worth)


class Best:
    def __init__(self, worth: Any) -> None:
        self.worth = worth

    def probabilities(self, observation: Any, mask: Any) -> Any:
        best = np.where(mask, self.worth, -np.inf).argmax(axis=1)
        return np.eye(mask.shape[1])[best]


def imports(setting: Any) -> Any:
    import shuttle_marl

    return shuttle_marl


def opens(setting: Any) -> Any:
    return pathlib.Path("PACKAGE", "__init__.py").read_text(encoding="utf-8")


def calls_out(setting: Any) -> Any:
    return socket.create_connection(("192.0.2.1", 80), timeout=5)


def writes(setting: Any) -> Any:
    return pathlib.Path(__file__).write_text("", encoding="utf-8")
