"""Machine code is kept on disk where that is possible, and what is out of date is compiled again."""

import os
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

SCRIPT = """
import logging, sys
from shuttle_marl.base.compiling import compiled, inlined
{definitions}
print(twice(21), *getattr(twice, "_cache_hits", {{}}).values(), sep=",")
"""
DEFINITIONS = """
@inlined
def factor(): return {factor}

@compiled
def twice(x): return factor() * x
"""
ROOT = Path(__file__).parents[2]


def run(folder: Path, *, factor: int = 2, **environment: str) -> tuple[str, str]:
    """Run a module of two compiled functions that stands in ``folder``; returns what it printed and what it warned of."""
    folder.mkdir(exist_ok=True)
    script = folder / "numbers_of_two.py"
    text = SCRIPT.format(definitions=DEFINITIONS.format(factor=factor))
    if not script.exists() or script.read_text() != text:
        script.write_text(text)
    inherited = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    # The module is imported, as numba keeps nothing for a main script of another run.
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(folder)!r}); import numbers_of_two"],
        env={**inherited, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(folder / "cache"), **environment},
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return done.stdout.strip(), done.stderr


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that two processes filled, which started at once."""
    folder = tmp_path_factory.mktemp("machine") / "code"
    assert run(folder, NUMBA_DISABLE_JIT="1") == ("42", ""), "functions run uncompiled where numba is told so"
    with ThreadPoolExecutor(2) as starts:
        assert {(found.partition(",")[0], warned) for found, warned in starts.map(run, [folder, folder])} == {("42", "")}
    return folder


def test_without_a_writable_folder_functions_are_compiled_and_a_line_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "code"
    folder.mkdir()
    # Files in the places of folders: even the superuser cannot write below them.
    for blocked in (folder / "__pycache__", tmp_path / "home"):
        blocked.write_text("")
    home: dict[str, Any] = {name: str(tmp_path / "home" / "cache") for name in ("HOME", "XDG_CACHE_HOME")}
    found, warned = run(folder, **home)
    assert found == "42"
    assert "set NUMBA_CACHE_DIR to a folder that is" in warned
    assert len(warned.splitlines()) == 1


def test_another_process_reads_what_two_that_started_at_once_compiled(filled: Path) -> None:
    assert run(filled) == ("42,1", "")


def test_a_changed_function_is_compiled_again(filled: Path) -> None:
    assert run(filled, factor=3)[0] == "63"
    assert run(filled, factor=2)[0] == "42"


def test_numba_has_a_tested_upper_bound() -> None:
    """The cache sets a private part of numba, so a release is allowed only once these tests have run with it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (numba,) = (found for found in map(Requirement, project["dependencies"]) if found.name == "numba")
    (bound,) = (specifier.version for specifier in numba.specifier if specifier.operator == "<")
    installed = version("numba")
    assert numba.specifier.contains(installed)
    first_untested = int(installed.split(".")[1]) + 1
    assert bound == f"0.{first_untested}", f"numba {installed} is tested; allow versions below 0.{first_untested}"
