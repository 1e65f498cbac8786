"""Runs the code of the documentation: every ``python`` block, and every block whose fence says ``bash run``.

The blocks of one page run in order, in one namespace and one empty folder. A ``python`` block whose first line is a
comment with a file name (``# my_policy.py``) is also written to that file, so that commands further down can use it.
``<!--- skip: next -->`` before a block skips it.
"""

import os
import re
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from sybil import Example, Sybil
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.markdown import CodeBlockParser, PythonCodeBlockParser, SkipParser

_FILE_NAME = re.compile(r"#\s*(\w+\.py)\n")


class _BashFailed(Exception):
    """A command of the documentation that does not do what it says."""


def _run_python(example: Example) -> None:
    if name := _FILE_NAME.match(example.parsed):
        Path(name[1]).write_text(example.parsed, encoding="utf-8")
        sys.modules.pop(Path(name[1]).stem, None)  # another page may have imported a module of this name
    PythonEvaluator()(example)


def _run_bash(example: Example) -> None:
    scripts = sysconfig.get_path("scripts")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", example.parsed],
        env={**os.environ, "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "120"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise _BashFailed(f"exit status {done.returncode} of:\n{example.parsed}\n{done.stdout}{done.stderr}")


def _enter_folder(namespace: dict[str, Any]) -> None:
    folder = tempfile.TemporaryDirectory(prefix="docs-")
    namespace["__leave__"] = (folder, Path.cwd())
    os.chdir(folder.name)
    sys.path.insert(0, folder.name)


def _leave_folder(namespace: dict[str, Any]) -> None:
    folder, before = namespace["__leave__"]
    os.chdir(before)
    sys.path.remove(folder.name)
    folder.cleanup()


class _PythonParser(PythonCodeBlockParser):
    def __init__(self) -> None:
        super().__init__()
        self.codeblock_parser = CodeBlockParser("python", _run_python)


pytest_collect_file = Sybil(
    parsers=[_PythonParser(), CodeBlockParser("bash run", _run_bash), SkipParser()],
    pattern="*.md",
    setup=_enter_folder,
    teardown=_leave_folder,
).pytest()
