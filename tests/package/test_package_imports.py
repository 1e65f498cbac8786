"""Imports of the package: commands are light, and play needs no torch."""

import json
import pkgutil
import subprocess
import sys

import pytest

import shuttle_marl

HEAVY = ("torch", "torchrl", "tensordict", "pettingzoo", "lightgbm", "matplotlib", "pygame")
TABLE_LAYERS = (
    "game", "kernel", "exact", "data", "policy", "env", "recording", "analysis", "league", "pages", "coach", "staging", "scene",
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
    """Every module of the layers that run on tables, imported in one interpreter."""
    names = [name for _, name, _ in pkgutil.walk_packages(shuttle_marl.__path__, "shuttle_marl.")]
    modules = [name for name in names if name.split(".")[1] in TABLE_LAYERS and not name.endswith("__main__")]
    assert {name.split(".")[1] for name in modules} == set(TABLE_LAYERS)
    assert set(NEED_TORCH) <= set(modules)
    assert first_to_import_torch([name for name in modules if name not in NEED_TORCH]) == {}
