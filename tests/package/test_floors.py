"""The floors of the package, as written down in pyproject.toml under ``tool.importlinter``."""

import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINT_IMPORTS = Path(sysconfig.get_path("scripts")) / ("lint-imports.exe" if sys.platform == "win32" else "lint-imports")


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [str(LINT_IMPORTS), "--no-cache", "--no-logo", "--config", str(ROOT / "pyproject.toml")]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_a_module_imports_only_from_floors_below_its_own() -> None:
    done = lint(ROOT)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("court.py", "import shuttle_marl.game.rally"),
        ("data/clean.py", "def late():\n    from shuttle_marl.policy import base"),
        ("policy/base.py", "import shuttle_marl.commands.cli"),
        ("attic.py", "x = 1"),
    ],
)
def test_an_import_from_above_and_a_module_without_floor_are_found(tmp_path: Path, module: str, line: str) -> None:
    for source in (ROOT / "shuttle_marl").rglob("*.py"):
        copy = tmp_path / source.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(source.read_bytes())
    assert lint(tmp_path).returncode == 0
    with (tmp_path / "shuttle_marl" / module).open("a", encoding="utf-8") as file:
        file.write(f"\n{line}\n")
    assert lint(tmp_path).returncode == 1
