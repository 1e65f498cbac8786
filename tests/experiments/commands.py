"""Runs commands of the repository by their names, in this process: ``python -m NAME ARGUMENTS``."""

import contextlib
import io
import json
import runpy
import sys
from typing import Any
from unittest import mock


def run(name: str, *arguments: object, status: int = 0) -> str:
    """Output of a command, of which the errors too if it fails as expected."""
    out, errors = io.StringIO(), io.StringIO()
    argv = [name, *map(str, arguments)]
    with mock.patch.object(sys, "argv", argv), contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        try:
            runpy.run_module(name, run_name="__main__", alter_sys=True)
            found: object = 0
        except SystemExit as stop:
            found = stop.code or 0
    assert found == status, errors.getvalue()
    return out.getvalue() + (errors.getvalue() if status else "")


def result_of(name: str, *arguments: object) -> dict[str, Any]:
    """What a command prints with ``--json``."""
    found: dict[str, Any] = json.loads(run(name, *arguments, "--json"))
    return found
