"""The side of ``--isolated`` that runs alone: it imports NumPy and the method, and nothing of this package.

    python -I program.py MODULE:ATTRIBUTE FOLDER CLOSED …

Messages in both directions are arrays in the format of NumPy, without pickles. An audit hook refuses to import the package, to
open files in folders that are CLOSED, folders around them and other processes, and to start programs. It holds for code in
Python, not for compiled code that opens files itself, nor for code that changes this file or the library while it runs.
"""

import contextlib
import functools
import importlib
import inspect
import io
import json
import operator
import os
import struct
import sys
import types
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

_LENGTH: Final = struct.Struct("<Q")
_PROGRAMS: Final = (
    "subprocess.Popen", "os.exec", "os.posix_spawn", "os.spawn", "os.system", "os.startfile", "cpython.PyInterpreterState_New",
)  # fmt: skip
_LISTS: Final = ("os.listdir", "os.scandir")
_FILES: Final = (*_LISTS, "open", "os.link", "os.symlink", "os.rename", "sqlite3.connect")
"""Events of files; those that do not list reach what is in a folder, so none around a closed one may be used."""


def message(**arrays: Any) -> bytes:
    """Arrays as a message."""
    content = io.BytesIO()
    np.savez(content, **arrays)
    return _LENGTH.pack(content.tell()) + content.getvalue()


def send(pipe: IO[bytes], **arrays: Any) -> None:
    """Write a message."""
    pipe.write(message(**arrays))
    pipe.flush()


def receive(pipe: Any) -> dict[str, Any]:
    """Read a message.

    Raises:
        EOFError: the other side has ended.
    """
    if len(length := pipe.read(_LENGTH.size)) < _LENGTH.size:
        raise EOFError("the other side has ended")
    with np.load(io.BytesIO(pipe.read(*_LENGTH.unpack(length))), allow_pickle=False) as found:
        return dict(found)


class Setting:
    """The argument of a method: ``seed``, ``budget``, ``folder``; ``[S, 60]`` ``observation`` and ``[S, n]`` ``mask`` of states.

    ``reset`` and ``step`` play rallies in tasks that train players.
    """

    def __init__(self, ask: Any, fields: dict[str, Any]) -> None:
        self._ask = ask
        self.observation, self.mask = fields["observation"], fields["mask"]
        self.seed, self.budget, self.folder = int(fields["seed"]), int(fields["budget"]), Path(str(fields["folder"]))

    def reset(self, rallies: int = 256) -> Any:
        """Start so many rallies at once; returns the ``[rallies]`` states in which the learner is to strike."""
        return self._ask(reset=rallies)["state"]

    def step(self, strokes: Any) -> tuple[Any, Any, Any]:
        """Play ``[rallies]`` strokes; rallies that are over start again.

        Returns:
            ``[rallies]`` states, rewards of who struck (1: rally won, -1: lost), and whether each rally is over.

        Raises:
            RuntimeError: the budget is used up, or a stroke is none.
        """
        found = self._ask(step=np.asarray(strokes))
        return found["state"], found["reward"], found["over"]


def answer_of(result: Any, setting: Setting) -> dict[str, Any]:
    """What a method returned, as arrays."""
    if result is None:
        return {"nothing": 0}
    if isinstance(result, str):
        return {"text": result}
    if callable(getattr(result, "act", None)):
        legal = setting.mask.any(axis=1)
        rows = zip(setting.observation, setting.mask, legal, strict=True)
        return {"stroke": np.array([int(result.act(seen, mask)) if some else -1 for seen, mask, some in rows])}
    if callable(getattr(result, "probabilities", None)):
        return {"probability": np.asarray(result.probabilities(setting.observation, setting.mask), dtype=np.float32)}
    return {"values": np.asarray(result, dtype=np.float64)}


def start(*_: Any) -> None:
    """Start no program."""
    raise PermissionError("an isolated method cannot start programs")


def refuse(closed: tuple[str, ...], event: str, arguments: tuple[Any, ...]) -> None:
    """Audit hook, see the top of this module."""
    if event == "import" and arguments[0].partition(".")[0] == "shuttle_marl":
        raise ModuleNotFoundError("an isolated method cannot import shuttle_marl: it gets episodes only", name="shuttle_marl")
    if event in _PROGRAMS:
        start()
    if event in _FILES and isinstance(arguments[0], str | bytes | os.PathLike):
        path = os.path.realpath(os.fsdecode(arguments[0]))
        place, process = path.rstrip(os.sep) + os.sep, path.split("/")[2] if path.startswith("/proc/") else ""
        if (
            any(place.startswith(folder + os.sep) for folder in closed)
            or (event not in _LISTS and any(folder.startswith(place) for folder in closed))
            or (process.isdigit() and process != str(os.getpid()))  # has the memory of the game
        ):
            raise PermissionError(f"an isolated method cannot open {path}")


def main(name: str, folder: str, *closed: str) -> None:
    """Make the method, and answer until the other side ends."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the method prints
    sys.path.append(folder)
    sys.addaudithook(functools.partial(refuse, closed))
    with contextlib.suppress(ImportError):  # it has no event, and starts the processes of multiprocessing
        vars(importlib.import_module("_posixsubprocess"))["fork_exec"] = start

    def ask(**request: Any) -> dict[str, Any]:
        send(answers, **request)
        reply = receive(requests)
        if "error" in reply:
            raise RuntimeError(str(reply["error"]))
        return reply

    try:
        setting = Setting(ask, receive(requests))
        module, _, attribute = name.partition(":")
        method = operator.attrgetter(attribute)(importlib.import_module(module))
        fields = receive(requests)  # from here on the other side answers
        made = method(setting) if inspect.signature(method).parameters else method()
        while True:
            if (call := str(fields.pop("call"))) == "player":
                result = made
            elif call == "answer":
                result = made.answer(json.loads(str(fields["position"])))
            elif call == "policy_for_next_rally":
                result = made.policy_for_next_rally()
            else:
                # ``[B, n]`` probabilities of the strokes in ``[B]`` states are asked for.
                policies = [
                    types.SimpleNamespace(
                        probabilities=lambda states, i=i: ask(policy=i, state=np.asarray(states))["probability"]
                    )
                    for i in range(int(fields.pop("policies", 0)))
                ]
                data = types.SimpleNamespace(**fields)
                result = getattr(made, call)(*((data, policies) if policies else (data,)))
            send(answers, **answer_of(result, setting))
            fields = receive(requests)
    except EOFError:
        return
    except BaseException as error:
        with contextlib.suppress(OSError):
            send(answers, error=f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main(*sys.argv[1:])
