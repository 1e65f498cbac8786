"""Methods as a stranger writes them, in a file without this package."""

# ruff: noqa: PTH123, PTH208

import ctypes
import os
import pathlib
import socket
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest


class First:
    """Plays the first legal stroke, and waits in the first feasible position."""

    def act(self, observation: Any, mask: Any) -> Any:
        return int(np.flatnonzero(mask)[0])

    def positions(self, observation: Any, feasible: Any) -> Any:
        return np.eye(9)[feasible.argmax(axis=1)]


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


class Adapter:
    def __init__(self, setting: Any) -> None:
        assert setting.opponents > 10
        assert len(setting.reset(8, opponent=3)) == 8

    def policy_for_next_rally(self) -> Any:
        return First()

    def observe_rally(self, rally: Any) -> None:
        assert len(rally.state) == len(rally.own) == len(rally.position)


class Wrong(First):
    """Waits where nobody can."""

    def positions(self, observation: Any, feasible: Any) -> Any:
        return np.eye(9)[feasible.argmin(axis=1)]


def wrong(setting: Any) -> Any:
    return Wrong()


def named(setting: Any) -> Any:
    return "minimax"


def imports(setting: Any) -> Any:
    import shuttle_marl

    return shuttle_marl


def opens(setting: Any) -> Any:
    return pathlib.Path("PACKAGE", "__init__.py").read_text(encoding="utf-8")


def through_a_folder(setting: Any) -> Any:
    handle = os.open("/", os.O_RDONLY)
    return os.open("PACKAGE/__init__.py".lstrip("/"), os.O_RDONLY, dir_fd=handle)


def through_a_link(setting: Any) -> Any:
    link = setting.folder / "link"
    link.symlink_to("PACKAGE")
    return (link / "__init__.py").read_text(encoding="utf-8")


def searches(setting: Any) -> Any:
    """Another copy of the package, wherever it is."""
    found = subprocess.run(["find", "/", "-name", "shuttle_marl", "-type", "d"], capture_output=True, text=True, check=False)
    copies = [path for path in found.stdout.split() if any(pathlib.Path(path).iterdir())]
    return copies[0]


def reads_the_memory(setting: Any) -> Any:
    others = [int(name) for name in os.listdir("/proc") if name.isdigit() and int(name) != os.getpid()]
    return open(f"/proc/{others[0]}/mem", "rb").read(1)


def reads_the_frame(setting: Any) -> Any:
    """The opponent in the frames of whoever called, if they are in this process."""
    frame = sys._getframe()
    while frame is not None:
        for value in frame.f_locals.values():
            if hasattr(value, "cumulative"):
                return value
        frame = frame.f_back
    raise LookupError("no table in any frame")


def calls_out(setting: Any) -> Any:
    return socket.create_connection(("192.0.2.1", 80), timeout=5)


def reads_the_folder(setting: Any) -> Any:
    """What the folder of the unit and the command line tell of the opponent."""
    return pathlib.Path(setting.folder, os.listdir(setting.folder)[0]).read_text(encoding="utf-8")


class Text(str):
    """A text that says it is another one."""

    def __eq__(self, other: object) -> bool:
        return True

    __hash__ = str.__hash__

    def __fspath__(self) -> str:
        return "PACKAGE/__init__.py"


def subclass(setting: Any) -> Any:
    return open(Text("/tmp/x"), encoding="utf-8").read()


def writes(setting: Any) -> Any:
    return pathlib.Path(__file__).write_text("", encoding="utf-8")


def notes(setting: Any) -> Any:
    """Keeps a note in the keys of the session, the user and the user's session, and reads that of the unit before."""
    kernel = ctypes.CDLL(None)
    assert [kernel.syscall(250, 10, ring, b"user", b"note", 0) for ring in (-3, -4, -5)] == [-1] * 3, "a note of a unit before"
    for ring in (-3, -4, -5):
        kernel.syscall(248, b"user", b"note", b"the opponent", 12, ring)
    for _ in range(setting.budget // 4096):
        setting.reset(4096)
    with pytest.raises(RuntimeError, match="more rallies were reset than the budget"):  # each shows a serve of the opponent
        setting.reset(4096)
    return First()


def prints(setting: Any) -> Any:
    sys.stdout.write("words on the standard output\n")
    raise SystemExit(3)


def floods(setting: Any) -> Any:
    os.write(3, b"\xff" * 64)
    for descriptor in range(3, 10):
        try:
            os.write(descriptor, b"\xff" * 64)
        except OSError:
            continue
    return First()


def goes_on(setting: Any) -> Any:
    os.setsid()
    threading.Thread(target=time.sleep, args=(30,)).start()
    return First()
