"""Waiting for a state of another process or thread, such as a file or a line, instead of for a time."""

import time
from collections.abc import Callable
from typing import TypeVar

_Result = TypeVar("_Result")


def wait_until(condition: Callable[[], _Result], timeout: float, what: str) -> _Result:
    """Wait until a condition is true, and return its value.

    Args:
        condition: called repeatedly.
        timeout: seconds after which the test fails; generous, because a machine may be busy.
        what: description of the condition, for the error.

    Raises:
        TimeoutError: the condition did not become true.
    """
    deadline = time.monotonic() + timeout
    while not (result := condition()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"waited {timeout:g} s for {what}")
        time.sleep(0.01)
    return result
