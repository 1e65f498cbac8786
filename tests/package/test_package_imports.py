"""What the package imports when: light commands, and play that needs no torch."""

import pkgutil
import subprocess
import sys

import pytest

import shuttle_marl

HEAVY = ("torch", "torchrl", "tensordict", "pettingzoo", "lightgbm", "matplotlib", "pygame")
COMMANDS = ("data", "dynamics", "exact", "league", "recording")
TABLE_FLOORS = (
    "rally",
    "scoring",
    "draws",
    "stroke",
    "policy",
    "kernel",
    "exact",
    "env",
    "recording",
    "analysis",
    "staging",
    "scene",
    "league",
)
NEED_TORCH = ("shuttle_marl.env.batched",)


def imported(code: str, names: tuple[str, ...]) -> set[str]:
    """Which of the packages ``names`` a fresh interpreter holds after running ``code``."""
    script = f"import sys\ntry:\n    exec({code!r})\nexcept SystemExit:\n    pass\nprint('\\n' + ' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(names) & set(done.stdout.splitlines()[-1].split())


def command(name: str, *arguments: str) -> str:
    return f"import runpy, sys; sys.argv = [{name!r}, *{arguments!r}]; runpy.run_module({name!r}, run_name='__main__')"


def test_heavy_imports_are_seen() -> None:
    assert imported("import torch", HEAVY) >= {"torch"}


def test_importing_the_package_is_light() -> None:
    assert imported("import shuttle_marl", (*HEAVY, "numpy")) == set()


@pytest.mark.parametrize("module", ["shuttle_marl", "shuttle_marl.data", "shuttle_marl.dynamics", "shuttle_marl.league"])
def test_help_is_light(module: str) -> None:
    assert imported(command(module, "--help"), (*HEAVY, "numba")) == set()


@pytest.mark.parametrize("floor", TABLE_FLOORS)
def test_what_plays_does_not_import_torch(floor: str) -> None:
    """Every module of a floor that runs on tables, imported one after the other."""
    names = [name for _, name, _ in pkgutil.walk_packages(shuttle_marl.__path__, "shuttle_marl.") if name.split(".")[1] == floor]
    if not names:
        pytest.skip(f"there is no floor {floor} yet")
    wanted = [n for n in names if not n.endswith("__main__") and n not in NEED_TORCH]
    code = "import importlib\n" + "\n".join(f"importlib.import_module({n!r})" for n in wanted)
    assert imported(code, ("torch", "torchrl", "tensordict")) == set()
