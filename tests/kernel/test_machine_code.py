"""Machine code is kept on disk where that is possible, and whatever is damaged or out of date is compiled again."""

import os
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

SCRIPT = """
import logging, sys
from shuttle_marl.base.compiling import compiled, inlined
{definitions}
print(twice(21), *twice._cache_hits.values(), sep=",")
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


def kept(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.suffix in (".nbi", ".nbc"))


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("machine") / "code"
    assert run(folder) == ("42", "")
    assert run(folder) == ("42,1", ""), "the second run reads what the first one kept"
    return folder


def test_machine_code_without_any_writable_folder_lasts_for_the_process(tmp_path: Path) -> None:
    folder, temporary = tmp_path / "code", tmp_path / "temporary"
    folder.mkdir()
    temporary.mkdir()
    # Files in the places of folders: even the superuser cannot write below them.
    for blocked in (folder / "__pycache__", tmp_path / "home"):
        blocked.write_text("")
    home: dict[str, Any] = {name: str(tmp_path / "home" / "cache") for name in ("HOME", "XDG_CACHE_HOME")}
    found, warned = run(folder, **home, TMPDIR=str(temporary))
    assert found == "42"
    assert warned.count("writable") == 2, "one line, with its advice"
    assert len(warned.splitlines()) == 1
    assert str(temporary) in warned
    assert not list(temporary.iterdir()), "the folder is gone with the process"


def test_machine_code_lies_in_the_cache_of_the_user(filled: Path) -> None:
    assert kept(filled)
    assert all(filled / "cache" in path.parents for path in kept(filled))


def test_damaged_machine_code_is_compiled_again(filled: Path) -> None:
    whole = {path: path.read_bytes() for path in kept(filled)}
    assert {path.suffix for path in whole} == {".nbi", ".nbc"}
    damages = [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b"no pickle"]
    for damage in damages:
        for path, content in whole.items():
            path.write_bytes(damage(content))
        assert run(filled) == ("42", ""), "compiled again, without a word"
    assert run(filled) == ("42,1", ""), "and kept again"


def test_a_changed_function_is_compiled_again(filled: Path) -> None:
    assert run(filled, factor=3)[0] == "63"
    assert run(filled, factor=2)[0] == "42"


def test_numba_has_a_tested_upper_bound() -> None:
    """The cache replaces private parts of numba, so a release is allowed only once these tests have run with it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (numba,) = (found for found in map(Requirement, project["dependencies"]) if found.name == "numba")
    (bound,) = (specifier.version for specifier in numba.specifier if specifier.operator == "<")
    installed = version("numba")
    assert numba.specifier.contains(installed)
    first_untested = int(installed.split(".")[1]) + 1
    assert bound == f"0.{first_untested}", f"numba {installed} is tested; allow versions below 0.{first_untested}"


def test_no_home_is_no_folder_of_that_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    found, _ = run(tmp_path / "code", XDG_CACHE_HOME="~/.cache")
    assert found == "42"
    assert not list((tmp_path / "work").iterdir())
