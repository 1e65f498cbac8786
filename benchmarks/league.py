"""Speed and memory of tournaments: matches per second, sampled and exact, by workers and by the size of the pool.

    python -m benchmarks.league [--pools 10 30 100] [--workers 1 2] [--matches 100] [--quick] [--json]

Pools are scripted styles at different temperatures. Sampled: all matches of a round robin between tables, without a log. Exact:
the odds of all pairs of a part of the pool, solved without the cache. Rating: the fit with 1,000 bootstrap draws. Memory is the
peak of the process so far, so pools are measured in increasing size.
"""

import itertools
import resource
import time
from typing import Annotated, Any, Final

import numpy as np
import tyro

from benchmarks.machine import this_machine
from docs.tools.results import show
from shuttle_marl.exact import crossplay
from shuttle_marl.game import default_game
from shuttle_marl.league.entrants import Entrant, enter
from shuttle_marl.league.ratings import ratings
from shuttle_marl.league.tournament import MatchOptions, Tournament, round_robin

STYLES: Final = ("safe", "attacking", "defensive")
_EXACT_PAIRS: Final = 60
"""Number of pairs solved to measure the speed; a pool of 100 has 4,950."""


def pool(size: int) -> list[str]:
    """Names of a number of different entrants."""
    temperatures = (f"{0.3 + 0.05 * i:.2f}" for i in itertools.count())
    names = (f"{style}@{temperature}" for temperature in temperatures for style in STYLES)
    return list(itertools.islice(names, size))


def sampled(entrants: list[Entrant], workers: int, matches: int) -> dict[str, Any]:
    """Play a round robin."""
    pairings = round_robin([entrant.name for entrant in entrants])
    tournament = Tournament(default_game(), entrants, MatchOptions(matches=matches, seed=0), workers=workers)
    begun = time.perf_counter()
    cells = [result.cells for blocks in tournament.play(pairings) for result, _ in blocks]
    seconds = time.perf_counter() - begun
    fitted = time.perf_counter()
    ratings(np.array(cells, dtype=np.float64), np.array([p.entrants for p in pairings]), len(entrants), np.random.default_rng(0))
    return {
        "pool": len(entrants),
        "workers": workers,
        "matches": len(pairings) * matches,
        "seconds": seconds,
        "matches_per_s": len(pairings) * matches / seconds,
        "rating_s": time.perf_counter() - fitted,
        "memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def exact(entrants: list[Entrant]) -> dict[str, float]:
    """Solve pairs of some entrants."""
    count = int(np.sqrt(2 * _EXACT_PAIRS))
    tables = [entrant.table for entrant in entrants[:count] if entrant.table is not None]
    begun = time.perf_counter()
    crossplay(tables)
    seconds = time.perf_counter() - begun
    pairs = len(tables) * (len(tables) + 1) // 2
    return {"pairs": pairs, "seconds": seconds, "pairs_per_s": pairs / seconds}


def measure(pools: tuple[int, ...], workers: tuple[int, ...], matches: int) -> dict[str, Any]:
    """All figures."""
    game = default_game()
    names = pool(max(pools))
    entrants = [enter(name, game) for name in names[:2]]
    sampled(entrants, 1, 2)  # compiled now
    crossplay([entrant.table for entrant in entrants[:1] if entrant.table is not None])
    cases = []
    for size in sorted(pools):
        entrants += [enter(name, game) for name in names[len(entrants) : size]]  # the peak memory is of this size
        cases += [sampled(entrants, count, matches) for count in workers]
    return {**this_machine(), "exact": exact(entrants), "sampled": cases}


def benchmark(
    *,
    pools: tuple[int, ...] = (10, 30, 100),
    workers: tuple[int, ...] = (1, 2),
    matches: int = 100,
    quick: bool = False,
    json_output: Annotated[bool, tyro.conf.arg(name="json")] = False,
) -> None:
    """Measure the speed and memory of tournaments.

    Args:
        pools: sizes of the pools.
        workers: numbers of threads.
        matches: matches of every pair.
        quick: two small pools and few matches, to see that it runs.
        json_output: print JSON.
    """
    found = measure((3, 6), (1, 2), 10) if quick else measure(pools, workers, matches)
    show(found, "league", as_json=json_output)


if __name__ == "__main__":
    tyro.cli(benchmark)
