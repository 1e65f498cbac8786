"""Settings of all tests, and collection of the code in the documentation.

Every ``python`` block of a page runs, and every block whose fence says ``bash run``. A page is one test: its blocks run in
order, in one namespace and one empty folder, until one fails. A ``python`` block whose first line is a comment with a file
name (``# my_policy.py``) is also written to that file, so that later commands can use it.
"""

import gc
import os
import re
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, Final

import hypothesis
import pytest
from sybil import Document, Example, Sybil
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.markdown import CodeBlockParser, PythonCodeBlockParser

# One thread per process: tests run in parallel, and each of these libraries would start one thread per core. The variables must
# be set before the libraries are imported; subprocesses inherit them.
for _variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

# No deadline: a busy machine makes a test slow, not wrong. Examples are the same in every run, so failures are reproducible;
# `--hypothesis-profile explore` uses others.
hypothesis.settings.register_profile("explore", deadline=None)
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True)
hypothesis.settings.load_profile("repeatable")

SLOW_PAGES: Final = tuple(
    f"docs/{name}"
    for name in (
        "tutorials",
        "analysis.md",
        "api.md",
        "exact.md",
        "foxglove.md",
        "league.md",
        "rally_log.md",
        "suite/protocol.md",
        "training.md",
    )
)
"""Pages, or folders of pages, whose code trains agents or plays tournaments; marked ``slow``."""
_FILE_NAME: Final = re.compile(r"#\s*(\w+\.py)\n")


class _BashFailed(Exception):
    """A command of the documentation failed."""


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
        raise _BashFailed(f"line {example.line}: exit status {done.returncode} of:\n{example.parsed}\n{done.stdout}{done.stderr}")


class _PythonParser(PythonCodeBlockParser):
    def __init__(self) -> None:
        super().__init__()
        self.codeblock_parser = CodeBlockParser("python", _run_python)


_SYBIL: Final = Sybil(parsers=[_PythonParser(), CodeBlockParser("bash run", _run_bash)], pattern="*.md")


class _PageCode(pytest.Item):
    """All code of a page: one test, because blocks depend on earlier ones."""

    def __init__(self, *, document: Document, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.document = document

    def runtest(self) -> None:
        before = Path.cwd()
        with tempfile.TemporaryDirectory(prefix="docs-") as folder:
            os.chdir(folder)
            sys.path.insert(0, folder)
            try:
                for example in self.document.examples():
                    example.evaluate()
            finally:
                os.chdir(before)
                sys.path.remove(folder)

    def reportinfo(self) -> tuple[Path, int, str]:
        return self.path, 0, f"code of {self.path.name}"


class _Page(pytest.File):
    def collect(self) -> Iterator[pytest.Item]:
        document = _SYBIL.parse(self.path)
        if any(True for _ in document.examples()):
            item = _PageCode.from_parent(self, name="code", document=document)
            if any(self.path.is_relative_to(self.config.rootpath / slow) for slow in SLOW_PAGES):
                item.add_marker(pytest.mark.slow(minutes=True))
            yield item


def pytest_configure(config: pytest.Config) -> None:
    """Give all processes of this session one folder of their own: for caches, other libraries' logs, and what tests share."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        return  # inherited
    folder = tempfile.TemporaryDirectory(prefix="session-", ignore_cleanup_errors=True)
    config.add_cleanup(folder.cleanup)
    os.environ |= {"SESSION_FOLDER": folder.name, "XDG_CACHE_HOME": f"{folder.name}/cache", "SB3_LOGDIR": f"{folder.name}/sb3"}


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect tests without looking for garbage: what modules define stays to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the longest tests first, so that all cores are busy until the end."""
    items.sort(key=lambda item: not any(mark.kwargs.get("minutes") for mark in item.iter_markers("slow")))


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collect the code of a page of the documentation."""
    return _Page.from_parent(parent, path=file_path) if file_path.suffix == ".md" else None
