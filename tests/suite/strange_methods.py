"""Methods as a stranger writes them, in a file without this package."""

import importlib.util
import multiprocessing
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


def through_a_folder(setting: Any) -> Any:
    package = pathlib.Path(os.environ["PACKAGE"])
    handle = os.open(package.parent, os.O_RDONLY)
    return os.open(f"{package.name}/__init__.py", os.O_RDONLY, dir_fd=handle)


def renames(setting: Any) -> Any:
    return (parent := pathlib.Path(os.environ["PACKAGE"]).parent).rename(parent)


def reads_the_memory(setting: Any) -> Any:
    return pathlib.Path(f"/proc/{os.getppid()}/maps").read_text(encoding="utf-8")


def spawns(setting: Any) -> Any:
    multiprocessing.get_context("spawn").Process(target=print).start()


def interprets(setting: Any) -> Any:
    names = [name for name in ("_interpreters", "_xxsubinterpreters") if importlib.util.find_spec(name) is not None]
    return importlib.import_module(names[0]).create()


def drawn(setting: Any) -> Any:
    """Works alone, and leaves what it finds in its folder."""
    state = setting.reset(8)
    found = [path.name for path in setting.folder.iterdir()]
    (setting.folder / "found.txt").write_text(" ".join(found), encoding="utf-8")
    assert len(state) == 8
    return First()


def prints(setting: Any) -> Any:
    sys.stdout.write("words on the standard output\n")
    raise SystemExit(3)
