"""What the rally log costs: CPU time and bytes of a stroke, and how fast rallies are read back.

    python -m benchmarks.recording_log [--matches N] [--repeat N] [--json]

A tournament between the scripted styles is played; its rallies are then written from memory and read back, so that only the
log is timed. CPU time is of the whole process (user and system); the smallest of N runs is reported.
"""

import json
import os
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from shuttle_marl.dynamics import default_game
from shuttle_marl.league.entrants import enter
from shuttle_marl.league.schedule import round_robin
from shuttle_marl.league.tournament import Tournament
from shuttle_marl.recording import LogHeader, Player, Rallies, RallyLog, RallyLogWriter, replay

_POOL: Final = ("attacking", "defensive", "safe", "random")


def cpu_seconds(work: Callable[[], object], repeat: int) -> float:
    """Least CPU time of ``repeat`` calls [s]."""
    times = []
    for _ in range(repeat):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


def measure(matches: int, repeat: int) -> dict[str, Any]:
    """Play, write, read; see the keys."""
    game = default_game()
    entrants, pairings = [enter(name, game) for name in _POOL], round_robin(_POOL)
    tournament = Tournament(game, entrants, matches=matches, seed=0, batch=8192, keep_strokes=True)

    def play() -> list[list[Rallies]]:
        return [rallies for group in tournament.play(pairings) for _, rallies in group]

    blocks = play()
    playing = cpu_seconds(play, repeat)
    header = LogHeader(
        seed=0,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=tuple(Player(name=entrant.name, hash=entrant.hash) for entrant in entrants),
        pairings=tuple(pairing.key for pairing in pairings),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rallies.mcap"

        def write() -> None:
            path.unlink(missing_ok=True)
            with RallyLogWriter(path, header) as log:
                for block in blocks:
                    for rallies in block:
                        log.append(rallies)
                    log.flush()

        writing = cpu_seconds(write, repeat)
        with RallyLog(path) as log:
            strokes, rallies, size = log.n_strokes, log.n_rallies, log.size
            reading = cpu_seconds(lambda: [len(batch.stroke) for _, batch in log.batches()], repeat)
            replaying = cpu_seconds(lambda: replay(log, game), 1)
        numbers = np.random.default_rng(0).integers(rallies, size=50)
        finding = [_find(path, int(number)) for number in numbers]
    return {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "strokes": strokes,
        "rallies": rallies,
        "bytes_per_stroke": size / strokes,
        "write_us_per_stroke": 1e6 * writing / strokes,
        "play_us_per_stroke": 1e6 * playing / strokes,
        "read_strokes_per_s": strokes / reading,
        "replay_strokes_per_s": strokes / replaying,
        "find_rally_ms": 1e3 * float(np.median(finding)),
    }


def _find(path: Path, number: int) -> float:
    """Seconds to open a log and read one of its rallies."""
    begun = time.perf_counter()
    with RallyLog(path) as log:
        rally: Rallies = log.rally(number)
    assert len(rally) == 1
    return time.perf_counter() - begun


def main(*, matches: int = 1000, repeat: int = 5, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """Measure and print.

    Args:
        matches: matches of each of the six pairings.
        repeat: runs of each measurement; the fastest counts.
        as_json: print JSON instead of a table.
    """
    result = measure(matches, repeat)
    if as_json:
        print(json.dumps(result, indent=2))
        return
    table = Table("", "measured")
    for name, value in result.items():
        table.add_row(name.replace("_", " "), f"{value:,.3f}" if isinstance(value, float) else str(value))
    Console().print(table)


if __name__ == "__main__":
    tyro.cli(main)
