"""Ctrl-C at safe points: within :func:`interrupts_held` it is noted, and :func:`check_interrupt` raises it.

Libraries turn a KeyboardInterrupt inside of them into other errors, or lose it.
"""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Final

_noted: Final[list[int]] = []
"""Interrupts in the context."""


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back until :func:`check_interrupt` or the end of the context; a second one is raised at once.

    It has no effect in other threads than the main one, within another such context, and where the caller handles SIGINT.

    Raises:
        KeyboardInterrupt: at the end, if it was not raised before.
    """
    if not _is_main() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _note)
    try:
        yield
        check_interrupt()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _noted.clear()


def check_interrupt() -> None:
    """Raise an interrupt that is held back.

    Raises:
        KeyboardInterrupt: there is one.
    """
    if was_interrupted() and _is_main():
        raise KeyboardInterrupt


def was_interrupted() -> bool:
    """Whether there was an interrupt within the context of :func:`interrupts_held`."""
    return bool(_noted)


@contextlib.contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C for a moment, in this thread and for ever in processes that start within; it is raised at the end."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _is_main() -> bool:
    return threading.current_thread() is threading.main_thread()


def _note(number: int, frame: FrameType | None) -> None:
    _noted.append(number)
    if len(_noted) > 1:
        signal.default_int_handler(number, frame)
