"""The layers of the package, as written down in pyproject.toml under ``tool.importlinter``."""

import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINT_IMPORTS = Path(sysconfig.get_path("scripts")) / ("lint-imports.exe" if sys.platform == "win32" else "lint-imports")
FORBIDDEN = {
    ("game/rules.py", "shuttle_marl.policy.registry"): "import {}",
    ("kernel/core.py", "shuttle_marl.exact.optimal"): "from {} import solve",
    ("exact/optimal.py", "shuttle_marl.dynamics.evaluate"): "import {}",
    ("data/table.py", "shuttle_marl.dynamics.features"): "def late():\n    import {}",
    ("policy/registry.py", "shuttle_marl.commands.cli"): "import {}",
    ("league/run.py", "shuttle_marl.scene.write"): "import {}",
    ("recording/reader.py", "torch"): "def late():\n    import {}",
}
"""Module and what it must not import; how the import is written."""


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [str(LINT_IMPORTS), "--no-cache", "--no-logo", "--config", str(ROOT / "pyproject.toml")]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the package, in the folder that is returned."""
    for source in (ROOT / "shuttle_marl").rglob("*.py"):
        target = tmp_path / source.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(source.read_bytes())
    return tmp_path


def append(folder: Path, module: str, text: str) -> None:
    with (folder / "shuttle_marl" / module).open("a", encoding="utf-8") as file:
        file.write(f"\n{text}\n")


def test_no_import_is_excepted() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    assert {contract["type"] for contract in contracts} == {"layers", "forbidden"}
    assert [contract["name"] for contract in contracts if contract.get("ignore_imports")] == []


def test_imports_from_above_and_of_torch_are_found(copy: Path) -> None:
    for (module, target), line in FORBIDDEN.items():
        assert (copy / "shuttle_marl" / module).exists(), module
        append(copy, module, line.format(target))
    append(copy, "attic.py", "x = 1")
    done = lint(copy)
    assert done.returncode == 1
    found = " ".join(done.stdout.split())
    for module, target in FORBIDDEN:
        name = f"shuttle_marl.{module.removesuffix('.py').replace('/', '.')}"
        assert f"{name} -> {target} (" in found
    assert "shuttle_marl.attic" in found, "a module without layer"
