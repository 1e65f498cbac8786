"""Time of the exact solvers on the shipped game: minimax, profiles, best responses, human and robust play, pairs, cross-play.

    python -m benchmarks.exact_values [--repeat N] [--json]

Wall-clock and CPU seconds, the medians of N calls in one process after compilation; the cross-play is called once, on all
cores. On an idle machine, CPU and wall-clock seconds of a solver are equal; the cross-play takes more CPU seconds by the number
of cores.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any, Final

import tyro

from docs.tools.results import Json, show, this_machine
from shuttle_marl.base.cache import forgotten
from shuttle_marl.exact import best_response, crossplay, evaluate, policy_regret, solve, solve_robust, solve_soft, visits
from shuttle_marl.exact.sweeps import warm_up
from shuttle_marl.game import default_game
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.shipped import refits_of
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines, registry

_POLICIES: Final = 30


def thirty_policies(game: Game) -> list[TabulatedPolicy]:
    """30 policies: behaviour-cloned players, styles and random, and the same at other temperatures."""
    families = ("bc", "attacking", "defensive", "safe", "random")
    names = [name for name in registry.names(game) if name.partition(":")[0] in families and name != baselines.REMEMBERING]
    names += [f"{name}@{temperature}" for temperature in (0.5, 2) for name in names]
    return [tabulate(registry.resolve(name, game), game) for name in names[:_POLICIES]]


def median_seconds(call: Callable[[], Any], repeat: int) -> tuple[float, float]:
    """Median wall-clock and CPU seconds of a call."""
    times = []
    for _ in range(repeat):
        begun = time.perf_counter(), time.process_time()
        call()
        times.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
    wall, cpu = zip(*times, strict=True)
    return statistics.median(wall), statistics.median(cpu)


def measure(repeat: int) -> list[dict[str, Any]]:
    """All measurements: solver and times."""
    game, names = default_game(), ("viktor-axelsen", "kento-momota")
    warm_up(game)
    bc, other = (tabulate(registry.resolve(name, game), game) for name in ("bc", "attacking"))
    solution, several, pair = solve(game), [game, *refits_of(game)], pair_game(*names)

    def construct() -> None:
        pair_game.cache_clear()
        for seat in pair_game(*names).seats:
            _ = seat.limits

    calls: dict[str, Callable[[], Any]] = {
        f"minimax, error bound {solution.error_bound:.0e}": lambda: solve(game),
        "value of a profile": lambda: evaluate(bc, other),
        "best response": lambda: best_response(bc),
        "visits": lambda: visits(bc, other),
        "regret": lambda: policy_regret(bc, solution=solution),
        "human play, tau 0.05": lambda: solve_soft(bc, tau=0.05),
        f"robust play over {len(several)} games": lambda: solve_robust(several),
        "tables of a pair": construct,
        "minimax of a pair": lambda: solve(pair),
    }
    times = {what: median_seconds(call, repeat) for what, call in calls.items()}
    policies = thirty_policies(game)
    with forgotten():
        times[f"cross-play of {len(policies)}"] = median_seconds(lambda: crossplay(policies), 1)
    return [{"what": what, "seconds": wall, "cpu_s": cpu} for what, (wall, cpu) in times.items()]


def main(*, repeat: int = 5, as_json: Json = False) -> None:
    """Measure and print.

    Args:
        repeat: calls of each solver.
        as_json: print JSON instead of a table.
    """
    show({**this_machine(), "solvers": measure(repeat)}, "exact_values", as_json=as_json)


if __name__ == "__main__":
    tyro.cli(main)
