"""The tasks by name."""

import difflib
import functools
from pathlib import Path
from typing import Final

from shuttle_marl.base.errors import printable
from shuttle_marl.game.shipped import drawn_game, is_shipped, resolve_game
from shuttle_marl.suite.adapt import Adapt
from shuttle_marl.suite.exploit import Equilibrium, Exploit
from shuttle_marl.suite.imitate import Imitate
from shuttle_marl.suite.offline import Evaluate, Offline
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.population import checked_beacon, rng_of
from shuttle_marl.suite.robust import Robust
from shuttle_marl.suite.store import RunConfig
from shuttle_marl.suite.task import Arena, Task
from shuttle_marl.suite.text import Text

TASKS: Final[dict[str, Task]] = {
    task.name: task for task in (Exploit(), Equilibrium(), Adapt(), Offline(), Evaluate(), Imitate(), Robust(), Text())
}


def find_task(name: str) -> Task:
    """A task by name.

    Raises:
        SuiteError: there is no such task.
    """
    if name not in TASKS:
        close = difflib.get_close_matches(name, TASKS, n=2, cutoff=0.4)
        raise SuiteError(f"no task {name!r}; {f'did you mean {close[0]}?' if close else ''} there are: {', '.join(TASKS)}")
    return TASKS[name]


@functools.lru_cache(maxsize=4)
def arena_of(
    task: Task,
    model: str,
    split: Split,
    *,
    quick: bool = False,
    budget: int | None = None,
    beacon: str | None = None,
    data: Path | None = None,
) -> Arena:
    """The game and the split of a task.

    Raises:
        SuiteError: the task has no such split, or the randomness of the beacon is missing.
        GameError: the model does not exist.
    """
    if split not in task.splits:
        raise SuiteError(f"{task.name} has no split {split!r}; there are: {', '.join(task.splits)}")
    if split == "hidden":
        beacon = checked_beacon(beacon)
    variant = task.variants.get(split)
    name = model if variant is None else f"{model}:{variant}"
    game, base = resolve_game(name), resolve_game(name).hash
    if sigma := task.drawn.get(split):
        game = drawn_game(game, rng_of("drawn game", split, beacon, "game"), sigma)
    return Arena(game=game, model=name, base=base, split=split, quick=quick, budget=budget, beacon=beacon, data=data)


def arena_of_run(
    task: Task, config: RunConfig, model: str | None = None, *, beacon: str | None = None, data: Path | None = None
) -> Arena:
    """The game and the split of a run whose folder may be a stranger's.

    Args:
        task: the task of the run.
        config: configuration in the folder.
        model: name or folder of the game that the user named; None: the shipped model of this name. A folder that the
            configuration names is never opened.
        beacon: randomness of the beacon round of the hidden split.
        data: annotated matches, for ``imitate``.

    Raises:
        SuiteError: the configuration names a model that is not shipped.
    """
    if model is None and not is_shipped(config.game.model):
        raise SuiteError(f"the run names the model {printable(config.game.model)!r}, which is not shipped; name it with --game")
    return arena_of(
        task, model or config.game.model, config.split, quick=config.quick, budget=config.budget, beacon=beacon, data=data
    )
