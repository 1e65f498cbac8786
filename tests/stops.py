"""Runs that stop before a file comes to its place, as if the process had been killed there."""

import itertools
import os
from collections.abc import Callable
from typing import Any


class Killed(BaseException):
    """End of the process, as far as a run can tell."""


def stopping(when: int) -> Callable[[Any, Any], None]:
    """A replacement of ``os.replace`` that stops before its n-th file comes to its place."""
    count, replace = itertools.count(1), os.replace

    def replace_or_stop(source: Any, target: Any) -> None:
        if next(count) == when:
            raise Killed
        replace(source, target)

    return replace_or_stop
