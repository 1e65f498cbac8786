"""Cost of recording every rally: in environments and a tournament; and writing, reading and random access of logs.

    python -m benchmarks.recording [--quick] [--json]

``make_vec`` in the JSON is the speed of an environment that records beside that of one that does not, which alternate: the median
ratios of CPU time, of all threads, and of wall-clock time. Both play random legal actions; a turn of the former ends when its log
is closed.

The tournament is the league command with every rally recorded, on all cores; its speed is wall-clock. Its log of some ten
million rallies is then read, opened again for each of many single rallies, and copied from memory, so that only the log is timed.
CPU time is user and system time of all threads, so other programs hardly affect it; the fastest of several runs is reported.
:mod:`benchmarks.training` has the cost of recording in training.
"""

import contextlib
import io
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
import tyro

from docs.tools.results import Json, show, this_machine
from shuttle_marl.game import default_game
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.recording import RallyLog, RallyLogWriter, replay

_POOL: Final = ("bc", "attacking", "safe", "random")
_MATCHES: Final = 20_000
_IN_MEMORY: Final = 256  # number of batches that are copied from memory
_FOUND: Final = 100
_BATCHES: Final = (64, 1024, 8192)
_ACTIONS: Final = 4_000_000  # of a turn of an environment, at least: seconds, of which the end of the log is a small part
_STEPS: Final = 256  # likewise


def environments(folder: Path, turns: int, actions: int) -> list[dict[str, float]]:
    """Speed of ``make_vec`` with a log, of that without."""
    found = []
    for batch in _BATCHES:
        pairs = [
            [_stepped(batch, actions, path) for path in (None, folder / f"{batch}-{turn}.mcap")] for turn in range(turns + 1)
        ]
        cpu, wall = np.median([np.divide(without, recorded) for without, recorded in pairs[1:]], axis=0).tolist()
        found.append({"batch": batch, "cpu_ratio": cpu, "wall_ratio": wall})
    return found


def _stepped(batch: int, actions: int, record: Path | None) -> tuple[float, float]:
    """CPU and wall-clock seconds of a turn."""
    env: Any = gymnasium.make_vec("shuttle_marl:shuttle_marl/Rally-v0", num_envs=batch, opponent="bc", record=record)
    env.reset(seed=0)
    before = np.array([time.process_time(), time.perf_counter()])
    for _ in range(max(_STEPS, actions // batch)):
        env.step(env.random_actions())
    with contextlib.redirect_stderr(io.StringIO()):
        env.close()
    cpu, wall = (np.array([time.process_time(), time.perf_counter()]) - before).tolist()
    return cpu, wall


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


def measure(matches: int, repeat: int) -> dict[str, Any]:
    """All measurements, by key."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stepped = environments(folder, 3 * repeat, _ACTIONS if repeat > 1 else _STEPS)
        played = tournament(folder, matches, repeat)
        logged = log(folder / "run" / "rallies.mcap", folder, repeat)
        return {**this_machine(), **played, **logged, "make_vec": stepped}


def main(*, quick: bool = False, as_json: Json = False) -> None:
    """Measure and print.

    Args:
        quick: fewer runs.
        as_json: print JSON instead of a table.
    """
    show(measure(_MATCHES, 1 if quick else 3), "recording", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
