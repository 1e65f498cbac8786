"""A time limit for every call of a policy, so that one that hangs fails instead of hanging its tournament.

Within :func:`time_limit`, a policy without a table is called in a thread of its own and given up when the time is over. That
thread cannot be ended safely: it is asked to stop, which ends loops of Python code, and otherwise left behind, and the
program does not wait for it when it ends. Not covered is what holds or kills the whole interpreter: compiled code that never
releases the interpreter's lock, ``os._exit``, a crash. Loading a policy (its import and its constructor) has no limit.
"""

import contextlib
import contextvars
import ctypes
import functools
import math
import queue
import threading
import weakref
from collections.abc import Callable, Iterator
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.policy import Policy, PolicyError, States, reads_score
from shuttle_marl.game.table import TabulatedPolicy

POLICY_TIMEOUT: Final = 10.0
"""Default of the command lines [seconds]."""

_seconds: Final = contextvars.ContextVar("seconds", default=0.0)
_T = TypeVar("_T")
_Call = Callable[[], Any]
_Answer = tuple[Any, BaseException | None]


@contextlib.contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Give every policy that is resolved within this context so much time for each call; also after the context ended.

    Args:
        seconds: 0 for no limit.

    Raises:
        PolicyError: ``seconds`` is negative or not finite.
    """
    if not (math.isfinite(seconds) and 0 <= seconds <= threading.TIMEOUT_MAX):
        raise PolicyError(f"--policy-timeout {seconds:g}: expected seconds, or 0 for no limit")
    token = _seconds.set(seconds)
    try:
        yield
    finally:
        _seconds.reset(token)


def limited(policy: Policy) -> Policy:
    """The policy under the time limit of the context that this is called in; itself without one, or if it is a table."""
    seconds = _seconds.get()
    return policy if not seconds or isinstance(policy, TabulatedPolicy) else TimedPolicy(policy, seconds)


class TimedPolicy:
    """A policy that is called in a thread of its own, and never again once it did not answer in time.

    Args:
        policy: any.
        seconds: for each call, above 0.
    """

    def __init__(self, policy: Policy, seconds: float) -> None:
        self._policy, self._limit = policy, seconds
        self._calls: queue.SimpleQueue[_Call | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[_Answer] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._hangs = False
        weakref.finalize(self, self._calls.put, None)

    @property
    def reads_score(self) -> bool:
        """Whether the policy reads the score.

        Raises:
            TimeoutError: it did not answer in time, now or before.
        """
        return self._call(functools.partial(reads_score, self._policy))

    def probabilities(self, states: States) -> npt.NDArray[np.floating]:
        """Probabilities of the policy, ``[B, n]``.

        Raises:
            TimeoutError: it did not answer in time, now or before.
        """
        return self._call(functools.partial(self._policy.probabilities, states))

    def _call(self, call: Callable[[], _T]) -> _T:
        if self._hangs:
            raise TimeoutError(f"it did not answer within {self._limit:g} s before, and is not asked again")
        if self._thread is None:
            self._thread = threading.Thread(target=_work, args=(self._calls, self._answers), daemon=True)
            self._thread.start()
        self._calls.put(call)
        try:
            answer, error = self._answers.get(timeout=self._limit)
        except queue.Empty:
            self._hangs = True
            _stop(self._thread)
            raise TimeoutError(f"no answer within {self._limit:g} s; --policy-timeout gives more time") from None
        if isinstance(error, KeyboardInterrupt):
            # Users interrupt the main thread only; this one must not look like theirs.
            raise RuntimeError("KeyboardInterrupt") from error
        if error is not None:
            raise error
        return answer


def _work(calls: "queue.SimpleQueue[_Call | None]", answers: "queue.SimpleQueue[_Answer]") -> None:
    while (call := calls.get()) is not None:
        try:
            answers.put((call(), None))
        except BaseException as error:
            answers.put((None, error))
        del call


def _stop(thread: threading.Thread) -> None:
    """Raise SystemExit in a thread as soon as it runs Python code."""
    if thread.ident is not None:
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident), ctypes.py_object(SystemExit))
