"""Methods as a stranger writes them, in a file without this package."""

import os
import pathlib
import subprocess
import sys
from typing import Any

import numpy as np
import pytest


class First:
    """Plays a legal stroke, the first or, with a sign, the last one."""

    def act(self, observation: Any, mask: Any) -> Any:
        return int(np.flatnonzero(mask)[0])


def learner(setting: Any) -> Any:
    """Plays the budget, and counts which stroke wins."""
    state = setting.reset(64)
    assert setting.observation[state].shape == (64, 60)
    worth = np.zeros(setting.mask.shape[1])
    rng = np.random.default_rng(setting.seed)
    for _ in range(setting.budget // 64):
        strokes = np.array([rng.choice(np.flatnonzero(mask)) for mask in setting.mask[state]])
        state, reward, _ = setting.step(strokes)
        np.add.at(worth, strokes, reward)
    with pytest.raises(RuntimeError, match="used up"):
        setting.step(strokes)
    return Best(worth)


class Best:
    def __init__(self, worth: Any) -> None:
        self.worth = worth

    def probabilities(self, observation: Any, mask: Any) -> Any:
        best = np.where(mask, self.worth, -np.inf).argmax(axis=1)
        return np.eye(mask.shape[1])[best]


class Offline:
    def __init__(self, setting: Any) -> None:
        self.setting = setting

    def fit(self, log: Any) -> Any:
        assert log.stroke.shape == log.state.shape == log.own.shape
        assert self.setting.mask[log.state, log.stroke].all()
        return First()


class Estimator:
    def estimate(self, log: Any, policies: Any) -> Any:
        legal = policies[0].probabilities(log.state[:5])
        assert np.allclose(legal.sum(axis=1), 1, atol=1e-3)
        return [float(log.won.mean())] * len(policies)


class Text:
    def answer(self, position: Any) -> Any:
        return position["legal"][0]


class Adapter:
    def policy_for_next_rally(self) -> Any:
        return First()

    def observe_rally(self, rally: Any) -> None:
        assert len(rally.state) == len(rally.own)


def named(setting: Any) -> Any:
    return "minimax"


def imports(setting: Any) -> Any:
    from shuttle_marl.exact import solve

    return solve


def opens(setting: Any) -> Any:
    return pathlib.Path(os.environ["PACKAGE"], "__init__.py").read_text(encoding="utf-8")


def starts(setting: Any) -> Any:
    return subprocess.check_output([sys.executable, "-c", "import shuttle_marl"])


def prints(setting: Any) -> Any:
    sys.stdout.write("words on the standard output\n")
    raise SystemExit(3)
