"""Imports of the package: commands are light, play needs no torch, and no layer imports one above it."""

import json
import pkgutil
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest

import shuttle_marl

HEAVY = ("torch", "torchrl", "tensordict", "pettingzoo", "lightgbm", "matplotlib", "pygame")
TABLE_LAYERS = (
    "game", "kernel", "exact", "data", "policy", "env", "recording", "league", "reports", "staging", "scene",
    "suite", "watch",
)  # fmt: skip
"""Layers that run on tables: they work without PyTorch."""
NEED_TORCH = ("shuttle_marl.env.batched",)
IMPORT_ONE_BY_ONE = """
import importlib, json, sys
first = {}
for name in json.loads(sys.argv[1]):
    importlib.import_module(name)
    for heavy in ("torch", "torchrl", "tensordict"):
        if heavy in sys.modules:
            first.setdefault(heavy, name)
print("\\n" + json.dumps(first))
"""


def imported(code: str, names: tuple[str, ...]) -> set[str]:
    """Those of the packages ``names`` that a fresh interpreter holds after running ``code``."""
    script = f"import sys\ntry:\n    exec({code!r})\nexcept SystemExit:\n    pass\nprint('\\n' + ' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(names) & set(done.stdout.splitlines()[-1].split())


def command(name: str, *arguments: str) -> str:
    return f"import runpy, sys; sys.argv = [{name!r}, *{arguments!r}]; runpy.run_module({name!r}, run_name='__main__')"


def first_to_import_torch(modules: list[str]) -> dict[str, str]:
    """The first of ``modules`` that brings torch or what builds on it into one interpreter, by library."""
    script = [sys.executable, "-c", IMPORT_ONE_BY_ONE, json.dumps(modules)]
    done = subprocess.run(script, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    first: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    return first


def test_importing_the_package_is_light() -> None:
    assert imported("import shuttle_marl", (*HEAVY, "numpy")) == set()


@pytest.mark.parametrize("module", ["shuttle_marl", "shuttle_marl.dynamics"])
def test_help_is_light(module: str) -> None:
    assert imported(command(module, "--help"), (*HEAVY, "numba")) == set()


def test_what_plays_does_not_import_torch() -> None:
    names = [name for _, name, _ in pkgutil.walk_packages(shuttle_marl.__path__, "shuttle_marl.")]
    modules = [name for name in names if name.split(".")[1] in TABLE_LAYERS and not name.endswith("__main__")]
    assert {name.split(".")[1] for name in modules} == set(TABLE_LAYERS)
    assert set(NEED_TORCH) <= set(modules)
    assert first_to_import_torch([name for name in modules if name not in NEED_TORCH]) == {}


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
