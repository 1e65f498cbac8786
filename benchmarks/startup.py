"""Start-up time of commands: CPU time of ``--help`` and of imports, each in a fresh interpreter.

    python -m benchmarks.startup [--repeat N] [--json]

CPU time is user plus system time of the process and all its threads; the smallest of N runs is reported, after one run
that fills the bytecode caches.
"""

import dataclasses
import resource
import subprocess
import sys
from pathlib import Path
from typing import Final

import tyro

import shuttle_marl
from docs.tools.results import Json, show, this_machine

_IMPORTS: Final = ("import shuttle_marl", "from shuttle_marl import rally_v0", "import shuttle_marl.dynamics")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Timing:
    """CPU seconds of one command."""

    command: str
    cpu_s: float


def cpu_seconds(command: list[str], repeat: int) -> float:
    """Minimum CPU time of ``repeat`` runs of a command [s].

    Raises:
        subprocess.CalledProcessError: the command fails.
    """
    times = []
    for _ in range(repeat + 1):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, capture_output=True, stdin=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times[1:])


def measure(repeat: int) -> list[Timing]:
    """Time ``--help`` of the package and of each of its commands, and the imports that users write."""
    commands = sorted(path.parent.name for path in Path(shuttle_marl.__file__).parent.glob("*/__main__.py"))
    arguments = [["-c", "pass"], *(["-c", statement] for statement in _IMPORTS), ["-m", "shuttle_marl", "--help"]]
    arguments += [["-m", f"shuttle_marl.{name}", "--help"] for name in commands]
    return [Timing(command=" ".join(["python", *a]), cpu_s=cpu_seconds([sys.executable, *a], repeat)) for a in arguments]


def main(*, repeat: int = 5, as_json: Json = False) -> None:
    """Measure and print.

    Args:
        repeat: runs of each command; the fastest counts.
        as_json: print JSON instead of a table.
    """
    timings = [dataclasses.asdict(timing) for timing in measure(repeat)]
    show({**this_machine(), "commands": timings}, "startup", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
