"""Runs the recipes of ``docs/recipes.md`` as they stand there, and keeps what they reached.

    python -m docs.tools.recipes NAME ... [--python INTERPRETER] [--save]

A recipe is a block whose fence says ``python recipe`` and whose first line is ``# NAME_recipe.py``. Its last line of output is
what it reached. With ``--save`` that goes to ``experiments/results/recipes.json``, from which the table of the page is made.
"""

import json
import os
import platform
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from docs.tools.markdown import ROOT
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.game import default_game

PAGE: Final = ROOT / "docs" / "recipes.md"
LOOP: Final = ROOT / "docs" / "tutorials" / "own_loop.md"
RESULTS: Final = ROOT / "experiments" / "results" / "recipes.json"
_BLOCK: Final = re.compile(r"^```python recipe\n(# (\w+)_recipe\.py\n.*?)^```$", re.S | re.M)
_WON: Final = re.compile(r"rallies won against bc: ([01]\.\d+)")


def recipes() -> dict[str, str]:
    """The programs of the page by name, and the loop of the tutorial with the block that measures it."""
    found = {name: code for code, name in _BLOCK.findall(PAGE.read_text(encoding="utf-8"))}
    loop = re.findall(r"^```python\n(.*?)^```$", LOOP.read_text(encoding="utf-8"), re.S | re.M)
    return {**found, "own_loop": "\n".join(loop[:2])}


def run(name: str, python: str = sys.executable, timeout: float = 900) -> dict[str, Any]:
    """Run a recipe in an empty folder, with one thread of PyTorch: waiting threads would count as CPU time.

    Args:
        name: of the recipe.
        python: interpreter of an environment with this package and the library.
        timeout: seconds.

    Returns:
        The last line that it printed, the CPU seconds, and the game.

    Raises:
        ShuttleError: the recipe does not exist, or it failed.
    """
    known = recipes()
    if name not in known:
        raise ShuttleError(f"no recipe {name!r}; there are {', '.join(known)}")
    begun = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}_recipe.py"
        path.write_text(known[name], encoding="utf-8")
        search = f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
        environment = {**os.environ, "PYTHONPATH": search, "OMP_NUM_THREADS": "1"}
        try:
            done = subprocess.run(
                [python, path.name], cwd=folder, env=environment, capture_output=True, text=True, timeout=timeout, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise ShuttleError(f"recipe {name}: not done within {timeout:g} s") from error
    if done.returncode != 0:
        raise ShuttleError(f"recipe {name}: exit status {done.returncode}\n{done.stderr[-2000:]}")
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    line = done.stdout.strip().splitlines()[-1]
    won = _WON.search(line)
    return {
        "printed": line,
        "rally_win_vs_bc": float(won[1]) if won else None,
        "cpu_seconds": round(ended.ru_utime + ended.ru_stime - begun.ru_utime - begun.ru_stime, 1),
        "game": default_game().hash,
    }


def main(names: Annotated[tuple[str, ...], tyro.conf.Positional] = (), python: str = sys.executable, save: bool = False) -> None:
    """Run recipes, all without names.

    Args:
        names: of the recipes.
        python: interpreter of an environment with this package and the libraries.
        save: keep the results.
    """
    for name in names or recipes():
        found = run(name, python)
        sys.stdout.write(f"{name}: {found['printed']} ({found['cpu_seconds']} s)\n")
        if save:
            kept = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.is_file() else {"recipes": {}}
            kept["recipes"][name] = found
            kept["python"] = platform.python_version()
            replace_file(RESULTS, (json.dumps(kept, indent=2) + "\n").encode())


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.recipes", description="Run the recipes of the documentation."))
