"""Strokes per second of all environments, from one rally to 65,536 in parallel, compared with those of other libraries.

    python -m benchmarks.throughput [--quick] [--json] [--only WHAT ...]

Every name is measured in a fresh process, so that its peak memory is separate; environments without batches share a process and
alternate. Seconds are CPU seconds of the process for one thread, so that other programs hardly affect them, and wall-clock
seconds for several threads. The fastest turn is reported, because other load can only slow a turn down, and the median as well.

``--json`` prints a list of ``{"what", "batch", "threads", "strokes_per_s", ...}``, with the game with recovery at the end:
``recovery_ratio`` is the median ratio to the game without, which alternates with it; ``load`` is the load average at the start of
a measurement.

For ``vector``, ``match_vector`` and ``gymnasium``, the learner's stroke and the reply count as one stroke; in environments of
other libraries, an action counts.
"""

import multiprocessing
import os
import resource
import statistics
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Annotated, Any, Final

import tyro
from rich.console import Console
from rich.progress import track

from benchmarks.machine import machine, this_machine
from benchmarks.throughput_cases import BATCHED, ONE_THREAD, RECOVERY, SINGLE, Play
from docs.tools.results import show
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game import default_game, load_game

Row = dict[str, Any]

BATCHES: Final = (1, 64, 1024, 8192, 65_536)
THREADS: Final = (1, 2)
_HIDDEN_BATCH: Final = 8192
_NAMES: Final = (*BATCHED, *SINGLE)


def speeds(plays: Sequence[Play], seconds: float, turns: int, threads: int) -> list[list[float]]:
    """Strokes per second of each turn; the environments alternate.

    A turn is over when its time is, but not amid a call; where all turns would need more than four times their time on the
    clock, there are fewer.
    """
    clock = time.process_time if threads == 1 else time.perf_counter
    for play in plays:
        play()  # compiles, if need be
    found: list[list[float]] = [[] for _ in plays]
    last_start = time.perf_counter() + 4 * seconds * turns * len(plays)
    while len(found[0]) < turns and (not found[0] or time.perf_counter() < last_start):
        for play, speeds_of_play in zip(plays, found, strict=True):
            strokes, begun = 0, clock()
            while True:
                strokes += play()
                taken = clock() - begun
                if taken >= seconds:
                    break
            speeds_of_play.append(strokes / taken)
    return found


def peak_mb() -> float:
    """Peak memory of this process [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def row(what: str, batch: int, threads: int, found: Sequence[float], **more: Any) -> Row:
    """A measurement, as a row of the results."""
    return {
        "what": what,
        "batch": batch,
        "threads": threads,
        "strokes_per_s": max(found),
        "median_per_s": statistics.median(found),
        "peak_mb": round(peak_mb(), 1),
        **more,
    }


def measure_batched(what: str, batches: Sequence[int], threads: Sequence[int], seconds: float, turns: int) -> list[Row]:
    """All batch sizes of one case in increasing order, so that the peak memory is that of the batch."""
    found = []
    for batch in sorted(batches):
        for count in threads if what not in ONE_THREAD else (1,):
            (measured,) = speeds([BATCHED[what](batch, count)], seconds, turns, count)
            found.append(row(what, batch, count, measured))
    return found


def measure_single(names: Sequence[str], seconds: float, turns: int) -> list[Row]:
    """Environments without batches, which alternate in one process."""
    found = speeds([SINGLE[name](1, 1) for name in names], seconds, turns, threads=1)
    return [row(name, 1, 1, measured) for name, measured in zip(names, found, strict=True)]


def measure_recovery(what: str, seconds: float, turns: int) -> list[Row]:
    """A case in the game with recovery, and how fast it is beside the game without."""
    games, batch = (default_game(), load_game("default:recovery")), _HIDDEN_BATCH if what in BATCHED else 1
    without, found = speeds([RECOVERY[what](batch, 1, game) for game in games], seconds, turns, threads=1)
    ratio = statistics.median(one / other for one, other in zip(found, without, strict=True))
    return [row(what, batch, 1, found, recovery_ratio=ratio)]


def measure(only: Sequence[str], batches: Sequence[int], threads: Sequence[int], seconds: float, turns: int) -> list[Row]:
    """Run the requested cases, each in a fresh process."""
    jobs: list[tuple[Callable[..., list[Row]], tuple[Any, ...]]] = [
        (measure_batched, (name, batches, threads, seconds, turns)) for name in BATCHED if name in only
    ]
    singles = [name for name in SINGLE if name in only]
    if singles:
        jobs.append((measure_single, (singles, seconds, turns)))
    jobs += [(measure_recovery, (name, seconds, turns)) for name in RECOVERY if name in only]
    rows: list[Row] = []
    for job, arguments in track(jobs, "measuring", console=Console(stderr=True)):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as fresh:
            load = round(os.getloadavg()[0], 1)
            rows += [{**measured, "load": load} for measured in fresh.submit(job, *arguments).result()]
    where = machine(this_machine()).removesuffix(".")
    return [{**measured, "machine": where} for measured in rows]


def main(
    *,
    quick: bool = False,
    only: tuple[str, ...] = _NAMES,
    batches: tuple[int, ...] = BATCHES,
    threads: tuple[int, ...] = THREADS,
    seconds: float = 0.02,
    turns: int = 50,
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Measure and print.

    Args:
        quick: ten turns of 0.01 seconds each.
        only: what to measure; all of it by default.
        batches: rallies, matches or environments at once.
        threads: threads that share a batch.
        seconds: length of a turn.
        turns: turns of each measurement.
        as_json: print JSON instead of tables.
    """
    unknown = sorted(set(only) - set(_NAMES))
    if unknown:
        raise ShuttleError(f"no such measurement: {', '.join(unknown)}; there are {', '.join(_NAMES)}")
    if quick:
        seconds, turns = 0.01, 10
    rows = measure(only, batches, threads, seconds, turns)
    show(rows, "throughput", *(["throughput_recovery"] if any("recovery_ratio" in row for row in rows) else []), as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
