"""Cost of recording every rally: a tournament, training, and writing, reading and random access of logs.

    python -m benchmarks.recording [--quick] [--json]

The tournament is the league command with every rally recorded, on all cores; its speed is wall-clock. Its log of some ten
million rallies is then read, opened again for each of many single rallies, and copied from memory, so that only the log is
timed. Training is a run of PPO with its defaults: the CPU time of the recorder's thread and of all calls of the log is compared
with the remaining CPU time, as if there were no second core. CPU time is user and system time of all threads, so other programs
hardly affect it; the fastest of several runs is reported.
"""

import functools
import json
import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final
from unittest import mock

import numpy as np
import tyro

from benchmarks.machine import this_machine
from docs.tools.results import show
from shuttle_marl.game import default_game
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.recording import RallyLog, RallyLogWriter, replay
from shuttle_marl.recording.recorder import LogContext

_POOL: Final = ("bc", "attacking", "safe", "random")
_MATCHES: Final = 20_000
_IN_MEMORY: Final = 256
"""Number of batches that are copied from memory."""
_FOUND: Final = 100


def cpu_seconds(work: Callable[[], object], repeat: int) -> float:
    """Minimum CPU time of ``repeat`` calls [s]."""
    times = []
    for _ in range(repeat):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


def tournament(folder: Path, matches: int, repeat: int) -> dict[str, float]:
    """Play and record tournaments; the log of the last one is kept."""
    run_league(LeagueConfig(pool=_POOL, matches=200, out=folder / "warm", batch=1 << 14))
    speed, cpu = [], []
    for i in range(repeat):
        begun = time.process_time()
        config = LeagueConfig(pool=_POOL, matches=matches, out=folder / "run", batch=1 << 14, overwrite=i > 0)
        manifest = json.loads((run_league(config).folder / "manifest.json").read_text())
        cpu.append((time.process_time() - begun) / manifest["strokes_played"])
        speed.append(manifest["strokes_played"] / manifest["seconds"])
    return {"recorded_strokes_per_s": max(speed), "recorded_cpu_us_per_stroke": 1e6 * min(cpu)}


def log(path: Path, folder: Path, repeat: int) -> dict[str, float]:
    """Read, access at random, replay and rewrite the log."""
    with RallyLog(path) as found:
        strokes, rallies, size = found.n_strokes, found.n_rallies, found.size
        reading = cpu_seconds(lambda: [len(batch.stroke) for _, batch in found.batches()], repeat)
        kept = [found.batch(i)[1] for i in range(min(_IN_MEMORY, len(found.rallies)))]
        header = found.header
    numbers = np.random.default_rng(0).integers(rallies, size=_FOUND)
    finding = [_find(path, int(number)) for number in numbers]

    def write() -> None:
        (folder / "copy.mcap").unlink(missing_ok=True)
        with RallyLogWriter(folder / "copy.mcap", header) as copy:
            for batch in kept:
                copy.append(batch)

    writing = cpu_seconds(write, repeat)
    with RallyLog(folder / "copy.mcap") as copied:
        replaying = cpu_seconds(lambda: replay(copied, default_game()), 1)
        written = copied.n_strokes
    return {
        "strokes": strokes,
        "rallies": rallies,
        "cpu_us_per_stroke": 1e6 * writing / written,
        "bytes_per_stroke": size / strokes,
        "read_strokes_per_s": strokes / reading,
        "replay_strokes_per_s": written / replaying,
        "find_rally_ms": 1e3 * statistics.median(finding),
    }


def _find(path: Path, number: int) -> float:
    """Seconds to open a log and read one of its rallies."""
    begun = time.perf_counter()
    with RallyLog(path) as found:
        found.rally(number)
    return time.perf_counter() - begun


class _Timed(LogContext):
    """A training log that measures its CPU time."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner
        self.cpu = self.waited = 0.0

    def __getattr__(self, name: str) -> Any:
        return functools.partial(self._timed, name)

    def close(self) -> None:
        self._inner.flush()
        # Measured from here, because the replaying thread starts with the first rally.
        threads = [thread for thread in threading.enumerate() if thread.name.startswith("recording ")]
        clocks = [time.pthread_getcpuclockid(thread.ident or 0) for thread in threads]
        self.cpu += sum(time.clock_gettime(clock) for clock in clocks)
        self._timed("close")

    def abort(self) -> None:
        self._timed("abort")

    def _timed(self, name: str, *args: Any) -> Any:
        cpu, begun = time.thread_time(), time.perf_counter()
        try:
            return getattr(self._inner, name)(*args)
        finally:
            self.cpu += time.thread_time() - cpu
            self.waited += time.perf_counter() - begun


def training(folder: Path, strokes: int, repeat: int) -> dict[str, float]:
    """Train with every rally recorded, and measure the fraction of CPU time spent on recording."""
    from shuttle_marl.training import PPOConfig, train  # noqa: PLC0415  torch, which nothing above needs
    from shuttle_marl.training.rally_log import open_log  # noqa: PLC0415

    logs: list[_Timed] = []

    def timed(*args: Any, **options: Any) -> _Timed:
        logs.append(_Timed(open_log(*args, **options)))
        return logs[-1]

    overhead, waited, size = [], [], 0.0
    with mock.patch("shuttle_marl.training.run.open_log", timed):
        for n in (20_000, *[strokes] * repeat):  # the first one compiles what is not compiled yet
            begun, cpu = time.perf_counter(), time.process_time()
            config = PPOConfig(strokes=n, out=folder / "ppo", overwrite=True, evaluate_every=1 << 30)
            done = train(config)
            spent = time.process_time() - cpu
            overhead.append(logs[-1].cpu / (spent - logs[-1].cpu))
            waited.append(logs[-1].waited / (time.perf_counter() - begun))
            with RallyLog(done.folder / "rallies.mcap") as found:
                size = found.size / found.n_strokes
    return {
        "training_overhead": min(overhead[1:]),
        "training_waits": min(waited[1:]),
        "training_bytes_per_stroke": size,
    }


def measure(matches: int, strokes: int, repeat: int) -> dict[str, Any]:
    """All measurements, by key."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        played = tournament(folder, matches, repeat)
        result = {**played, **log(folder / "run" / "rallies.mcap", folder, repeat), **training(folder, strokes, repeat)}
    return {**this_machine(), **result}


def main(*, quick: bool = False, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """Measure and print.

    Args:
        quick: fewer runs and a shorter training.
        as_json: print JSON instead of a table.
    """
    result = measure(_MATCHES, 200_000 if quick else 1_000_000, 1 if quick else 3)
    show(result, "recording", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
