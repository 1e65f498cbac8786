"""Runs that stop before a file comes to its place, as if the process had been killed there."""

import itertools
import os
from collections.abc import Callable
from typing import Any

import pytest


class Killed(BaseException):
    """End of the process, as far as a run can tell."""


def stop(patch: pytest.MonkeyPatch, when: int, *names: str) -> None:
    """Let the n-th call of some functions of ``os`` stop before it does anything, such as to put a file in its place."""
    count = itertools.count(1)

    def stopping(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if next(count) == when:
                raise Killed
            return function(*arguments, **options)

        return call

    for name in names:
        patch.setattr(os, name, stopping(getattr(os, name)))
