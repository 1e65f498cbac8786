"""Start-up time of commands, each in a fresh interpreter: ``--help``, imports, and what a user does in the first minute.

    python -m benchmarks.startup [--repeat N] [--demo COMMIT …] [--json]

CPU time is user plus system time of the process and all that it starts. ``--help`` and imports: the smallest of N runs, after one
run that fills the bytecode caches. The first minute: cold, in a new copy of the package without bytecode, compiled code or cached
results; and warm, the smallest of N further runs. ``suite run`` ends where the method is called: the rest is the method's time.

``--demo`` clones the repository at each commit and calls ``make demo`` twice, with the installation the first time; so commits
are compared as ``--demo HEAD --demo COMMIT --demo HEAD``.
"""

import dataclasses
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import tyro

import shuttle_marl
from docs.tools.markdown import ROOT
from docs.tools.results import Json, show, this_machine
from shuttle_marl.__main__ import COMMANDS

_IMPORTS: Final = ("import shuttle_marl", "from shuttle_marl import rally_v0", "import shuttle_marl.dynamics")
_FIRST_MINUTE: Final = (
    "league --matches 20 --out league --overwrite",
    "scout viktor-axelsen kento-momota --out scout.html",
    "recording scene league/rallies.mcap --out scene.mcap",
    "suite run exploit-entrance-v1 --method begins:train --seeds 1 --quick --out suite --overwrite",
)
_CALLED: Final = "the start-up ends here"  # said by the method of a user as it is called


@dataclasses.dataclass(frozen=True, kw_only=True)
class Spent:
    """Time of a command."""

    cpu_s: float
    wall_s: float


def spent(command: Sequence[str], folder: Path, env: dict[str, str] | None = None) -> Spent:
    """Time of one run of a command, in a folder.

    Raises:
        subprocess.CalledProcessError: the command fails, and not because the method of the suite was called.
    """
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(command, check=False, capture_output=True, stdin=subprocess.DEVNULL, cwd=folder, env=env)
    wall, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    if _CALLED.encode() not in done.stderr:
        done.check_returncode()
    return Spent(cpu_s=after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall_s=wall)


def commands(repeat: int) -> list[dict[str, Any]]:
    """CPU time of ``--help`` of the package and of each of its commands, and of the imports that users write."""
    arguments = [["-c", "pass"], *(["-c", statement] for statement in _IMPORTS), ["-m", "shuttle_marl", "--help"]]
    arguments += [["-m", "shuttle_marl", name, "--help"] for name in COMMANDS]
    found = []
    for words in arguments:
        runs = [spent([sys.executable, *words], ROOT) for _ in range(repeat + 1)]
        found.append({"command": " ".join(["python", *words]), "cpu_s": min(run.cpu_s for run in runs[1:])})
    return found


def first_minute(repeat: int) -> list[dict[str, Any]]:
    """Time of the first commands of a user, cold and warm."""
    found = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        package = Path(shuttle_marl.__file__).parent
        shutil.copytree(package, folder / package.name, ignore=shutil.ignore_patterns("__pycache__", "node_modules"))
        (folder / "begins.py").write_text(f"def train(setting):\n    raise RuntimeError({_CALLED!r})\n", encoding="utf-8")
        env = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
        env |= {"PYTHONPATH": temporary, "XDG_CACHE_HOME": str(folder / "cache")}
        for line in _FIRST_MINUTE:
            for kept in (folder / "cache", *folder.glob("shuttle_marl/**/__pycache__")):
                shutil.rmtree(kept, ignore_errors=True)
            runs = [spent([sys.executable, "-m", "shuttle_marl", *line.split()], folder, env) for _ in range(repeat + 1)]
            warm = min(runs[1:], key=lambda run: run.cpu_s)
            found.append({"command": line, "cold": dataclasses.asdict(runs[0]), "warm": dataclasses.asdict(warm)})
    return found


def made(commit: str) -> dict[str, Any]:
    """Time of ``make demo`` in a fresh clone of the repository at a commit, with the installation, and of a second call."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        subprocess.run(["git", "clone", "--quiet", "--no-local", ROOT, folder / "clone"], check=True)
        subprocess.run(["git", "checkout", "--quiet", commit], cwd=folder / "clone", check=True)
        env = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
        env = {name: value for name, value in env.items() if name not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
        cold, warm = (spent(["make", "demo"], folder / "clone", env) for _ in range(2))
    return {"command": f"make demo ({commit})", "cold": dataclasses.asdict(cold), "warm": dataclasses.asdict(warm)}


def main(*, repeat: int = 3, demo: tyro.conf.UseAppendAction[tuple[str, ...]] = (), as_json: Json = False) -> None:
    """Measure and print.

    Args:
        repeat: runs of each command after the first; the fastest counts.
        demo: only `make demo` of this commit; may be repeated.
        as_json: print JSON instead of tables.
    """
    if demo:
        measured: dict[str, Any] = {"first_minute": [made(commit) for commit in demo]}
    else:
        measured = {"first_minute": first_minute(repeat), "commands": commands(repeat)}
    tables = ("first_minute",) if demo else ("first_minute", "startup")
    show({**this_machine(), **measured}, *tables, as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
