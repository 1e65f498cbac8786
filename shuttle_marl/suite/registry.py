"""The tasks by name, their games, and their logs as files."""

import functools
from pathlib import Path
from typing import Final

from shuttle_marl.base.errors import did_you_mean
from shuttle_marl.base.table_files import write_parquet
from shuttle_marl.game.shipped import RECOVERY, drawn_game, resolve_game
from shuttle_marl.recording.logs import write_minari
from shuttle_marl.suite.adapt import Adapt
from shuttle_marl.suite.exploit import Equilibrium, Exploit, ExploitEntrance
from shuttle_marl.suite.offline import OPPONENT, Evaluate, LogTask, Offline, log_of_unit
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.population import rng_of
from shuttle_marl.suite.task import Arena, Task

TASKS: Final[dict[str, Task]] = {task.name: task() for task in (Exploit, Equilibrium, Adapt, Offline, Evaluate, ExploitEntrance)}


def find_task(name: str) -> Task:
    """A task by name.

    Raises:
        SuiteError: there is no such task.
    """
    if name not in TASKS:
        raise SuiteError(f"no task {name!r}{did_you_mean(name, TASKS, 0.4)}; there are: {', '.join(TASKS)}")
    return TASKS[name]


@functools.lru_cache(maxsize=4)
def arena_of(
    task: Task, model: str, split: Split, *, quick: bool = False, budget: int | None = None, seed: str | None = None
) -> Arena:
    """The game and the split of a task.

    Raises:
        SuiteError: the seed of a round is missing.
        GameError: the model does not exist.
    """
    if split == "round" and not seed:
        raise SuiteError("--split round: its games are drawn from a seed that no method knows; name it with --seed")
    variant = "-".join(filter(None, (task.variants.get(split), RECOVERY if task.recovery else None)))
    name = f"{model}:{variant}" if variant else model
    game, base = resolve_game(name), resolve_game(name).hash
    if sigma := task.drawn.get(split):
        game = drawn_game(game, rng_of("drawn game", split, seed, "game"), sigma)
    return Arena(game=game, model=name, base=base, split=split, quick=quick, budget=budget, seed=seed)


def write_data(
    task: str, out: Path, split: Split, model: str, seeds: int | None, *, quick: bool = False, minari: bool = False
) -> dict[str, str]:
    """Write the logs of a task as Parquet files or Minari data sets.

    Returns:
        SHA-256 of the content of each log by its name.

    Raises:
        SuiteError: the task has no logs.
    """
    found = find_task(task)
    if not isinstance(found, LogTask):
        raise SuiteError(f"{task} has no logs; offline-v0 and evaluate-v0 have")
    if seeds is not None and seeds < 1:
        raise SuiteError(f"--seeds {seeds}: expected 1 or more")
    arena, hashes = arena_of(found, model, split, quick=quick), {}
    for case in found.cases(arena):
        for seed in range(seeds or found.seeds):
            log = log_of_unit(arena, case, seed)
            fresh = "-fresh" if case.options.get("log") == "fresh" else ""
            name = f"{split}-{case.options['behaviour']}-{case.budget}{fresh}".translate(str.maketrans(":*+", "-x-"))
            if minari:
                name = f"shuttle_marl/{name}-v{seed}"
                write_minari(log.transitions, name, out, arena.model, OPPONENT)
            else:
                name = f"{name}-{seed}.parquet"
                write_parquet(out / name, log.table())
            hashes[name] = log.hash
    return hashes
