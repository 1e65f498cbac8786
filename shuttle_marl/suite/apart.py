"""The side of a rerun that runs alone, apart from the package: it imports NumPy and the method, and nothing else of ours.

    python -I apart.py MODULE:ATTRIBUTE FOLDER WORK

Messages in both directions are arrays in the format of NumPy, without pickles. What keeps the method from everything else is the
boundary around this process (:mod:`.remote`), not this file.
"""

import contextlib
import ctypes
import functools
import importlib
import inspect
import io
import operator
import os
import struct
import sys
import types
import zipfile
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

_LENGTH: Final = struct.Struct("<Q")
_JOIN_SESSION_KEYRING: Final = {"x86_64": (250, 1, None), "aarch64": (219, 1, None)}
"""System call by machine."""
_MOST: Final = 1 << 30
"""Largest size of a message [bytes]."""


def message(**arrays: Any) -> bytes:
    """Arrays as a message."""
    content = io.BytesIO()
    np.savez(content, **arrays)
    return _LENGTH.pack(content.tell()) + content.getvalue()


def receive(pipe: Any) -> dict[str, Any]:
    """Read a message.

    Raises:
        EOFError: the other side has ended.
        ValueError: it is no message, or too large.
    """
    if len(length := pipe.read(_LENGTH.size)) < _LENGTH.size:
        raise EOFError("the other side has ended")
    (size,) = _LENGTH.unpack(length)
    if size > _MOST:
        raise ValueError(f"a message of {size:,} bytes; expected at most {_MOST:,}")
    content = io.BytesIO(pipe.read(size))
    try:
        with zipfile.ZipFile(content) as packed:
            if any(part.compress_type != zipfile.ZIP_STORED for part in packed.infolist()):
                raise ValueError("a message that is packed")
        with np.load(content, allow_pickle=False) as found:
            return dict(found)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, KeyError) as error:
        raise ValueError(f"no message: {error}") from error


class Setting:
    """The argument of a method.

    Attributes:
        seed, budget: random seed of the method, and strokes that it may play.
        folder: an empty folder.
        observation, mask: ``[S, 60]`` what is seen in each state, and ``[S, n]`` which strokes are legal.
        feasible: ``[S, 9]`` positions in which a receiver may wait in each state; ``[0, 9]`` without recovery.
        opponents: number of known opponents that :meth:`reset` may name.
        waits: after :meth:`reset` and :meth:`step`, ``[rallies]`` whether a position is to be chosen: action n + p is position p.
    """

    def __init__(self, ask: Any, fields: dict[str, Any], folder: Path) -> None:
        self._ask, self.folder = ask, folder
        self.observation, self.mask, self.feasible = (fields[name] for name in ("observation", "mask", "feasible"))
        self.seed, self.budget, self.opponents = (int(fields[name]) for name in ("seed", "budget", "opponents"))
        self.waits = np.zeros(0, np.bool_)

    def reset(self, rallies: int = 256, opponent: int = 0) -> Any:
        """Start so many rallies at once, each time with other luck; returns the ``[rallies]`` states in which to choose.

        Args:
            opponent: number of a known opponent, in ``adapt``.
        """
        found = self._ask(reset=rallies, opponent=opponent)
        self.waits = found["waits"]
        return found["state"]

    def step(self, actions: Any, positions: Any = None) -> tuple[Any, Any, Any]:
        """Play ``[rallies]`` actions; rallies that are over start again.

        Args:
            positions: ``[rallies]`` positions of the receivers, in ``equilibrium`` with recovery.

        Returns:
            ``[rallies]`` states, rewards of who acted (1: rally won, -1: lost), and whether each rally is over.

        Raises:
            RuntimeError: the budget is used up, or an action is not legal.
        """
        found = self._ask(step=np.asarray(actions), **({} if positions is None else {"positions": np.asarray(positions)}))
        self.waits = found["waits"]
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
        found: dict[str, Any] = {"stroke": np.array([int(result.act(seen, mask)) if some else -1 for seen, mask, some in rows])}
    elif callable(getattr(result, "probabilities", None)):
        found = {"probability": np.asarray(result.probabilities(setting.observation, setting.mask), dtype=np.float32)}
    else:
        return {"values": np.asarray(result, dtype=np.float64)}
    if len(setting.feasible) and callable(getattr(result, "positions", None)):
        found["position"] = np.asarray(result.positions(setting.observation, setting.feasible), dtype=np.float64)
    return found


def main(name: str, folder: str, work: str) -> None:
    """Make the method, and answer until the other side ends."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the method prints
    if (join := _JOIN_SESSION_KEYRING.get(os.uname().machine)) is not None:  # else units of a login share its keys
        ctypes.CDLL(None).syscall(*join)
    sys.path.append(folder)
    Path(work).mkdir()  # beside what is shown of a Python that lies in /tmp

    def send(pipe: IO[bytes], **arrays: Any) -> None:
        pipe.write(message(**arrays))
        pipe.flush()

    def ask(**request: Any) -> dict[str, Any]:
        send(answers, **request)
        reply = receive(requests)
        if "error" in reply:
            raise RuntimeError(str(reply["error"]))
        return reply

    def policy(number: int) -> Any:
        """Has ``[B, n]`` probabilities of the strokes in ``[B]`` states."""
        asked = functools.partial(ask, policy=number)
        return types.SimpleNamespace(probabilities=lambda states: asked(state=np.asarray(states))["probability"])

    try:
        setting = Setting(ask, receive(requests), Path(work))
        module, _, attribute = name.partition(":")
        method = operator.attrgetter(attribute)(importlib.import_module(module))
        fields = receive(requests)  # from here on the other side answers
        made = method(setting) if inspect.signature(method).parameters else method()
        while True:
            if (call := str(fields.pop("call"))) == "player":
                result = made
            elif call == "policy_for_next_rally":
                result = made.policy_for_next_rally()
            else:
                policies = [policy(number) for number in range(int(fields.pop("policies", 0)))]
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
