"""The tasks by name, and files around them: templates of submissions, and data of cases."""

import functools
from pathlib import Path
from typing import Final, Literal

from shuttle_marl.base.errors import command, did_you_mean, printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.table_files import write_parquet
from shuttle_marl.game.shipped import drawn_game, is_shipped, resolve_game
from shuttle_marl.game.tables import RECOVERY
from shuttle_marl.recording.minari_files import write_minari
from shuttle_marl.suite.adapt import Adapt, AdaptEntrance
from shuttle_marl.suite.exploit import Equilibrium, EquilibriumEntrance, Exploit, ExploitEntrance
from shuttle_marl.suite.method import kind_of
from shuttle_marl.suite.offline import OPPONENT, Evaluate, LogTask, Offline, log_of_unit
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.population import checked_beacon, rng_of
from shuttle_marl.suite.store import CARD, Card, RunConfig, write_card
from shuttle_marl.suite.task import Arena, Case, Task
from shuttle_marl.suite.text import Text, json_lines, positions

_TASKS = (Exploit, Equilibrium, Adapt, Offline, Evaluate, ExploitEntrance, EquilibriumEntrance, AdaptEntrance, Text)
TASKS: Final[dict[str, Task]] = {task.name: task() for task in _TASKS}


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
    task: Task, model: str, split: Split, *, quick: bool = False, budget: int | None = None, beacon: str | None = None
) -> Arena:
    """The game and the split of a task.

    Raises:
        SuiteError: the task has no such split, or the randomness of the beacon is missing.
        GameError: the model does not exist.
    """
    if split not in task.splits:
        raise SuiteError(f"{task.name} has no split {split!r}; there are: {', '.join(task.splits)}")
    if split == "round":
        beacon = checked_beacon(beacon)
    variant = "-".join(filter(None, (task.variants.get(split), RECOVERY if task.recovery else None)))
    name = f"{model}:{variant}" if variant else model
    game, base = resolve_game(name), resolve_game(name).hash
    if sigma := task.drawn.get(split):
        game = drawn_game(game, rng_of("drawn game", split, beacon, "game"), sigma)
    return Arena(game=game, model=name, base=base, split=split, quick=quick, budget=budget, beacon=beacon)


def task_of_run(config: RunConfig, model: str | None = None, beacon: str | None = None) -> tuple[Task, Arena, list[Case]]:
    """Task, game and cases of a run whose folder may be a stranger's.

    Args:
        model: name or folder of the game that the user named; None: the shipped model of this name. A folder that the
            configuration names is never opened.
        beacon: randomness of the beacon of a round.

    Raises:
        SuiteError: the configuration names a model that is not shipped, or cases of different budgets, which are never pooled.
    """
    task = find_task(config.task)
    if model is None and not is_shipped(config.game.model):
        raise SuiteError(f"the run names the model {printable(config.game.model)!r}, which is not shipped; name it with --game")
    arena = arena_of(task, model or config.game.model, config.split, quick=config.quick, budget=config.budget, beacon=beacon)
    cases = task.cases(arena)
    if config.budget is None and len({case.budget for case in cases}) > 1:
        raise SuiteError("the run names no budget; budgets are never pooled")
    return task, arena, cases


Language = Literal["python", "perl", "apart"]
_TEMPLATES: Final = Path(__file__).parent / "templates" / "submission"
_PYTHON: Final = {
    "exploit": "player:train",
    "equilibrium": "player:train",
    "adapt": "adapter:Adapter",
    "offline": "offline:Learner",
    "evaluate": "estimator:Estimator",
    "text": "text:Player",
}
"""Template and method of each kind of task."""
_PERL: Final = ("exploit", "equilibrium")


def new_submission(task: str, out: Path, language: Language = "python") -> str:
    """Write a template of a method and a card into a folder.

    Args:
        out: folder, which is created; existing files are not replaced.

    Returns:
        The command that runs it, from that folder.

    Raises:
        SuiteError: there is no such task or template, or a file exists.
    """
    kind = kind_of(find_task(task).name)
    if language != "python" and kind not in _PERL:
        raise SuiteError(f"there is no such template for {task}; there is one for {', '.join(_PERL)}")
    module, _, attribute = (_PYTHON[kind] if language != "apart" else "apart:train").partition(":")
    source = "player.pl" if language == "perl" else f"{module}.py"
    # Modules of the user are found by name, so that of the template must be free.
    target = out / (source if language == "perl" else f"my_{module}.py")
    for path in (target, out / CARD):
        if path.exists():
            raise SuiteError(f"{path}: already exists; name another folder")
    replace_file(target, (_TEMPLATES / source).read_bytes())
    write_card(out, Card(method=target.stem, tuning_strokes=0))
    method = "program:perl player.pl" if language == "perl" else f"my_{module}:{attribute}"
    if language == "apart":
        return command(
            "suite", "commit", ".", "--task", task, "--method", method, "--author", "NAME", "--out", "../commitment.json"
        )
    return command("suite", "run", task, "--method", method, "--quick")


def write_data(
    task: str, out: Path, split: Split, model: str, seeds: int | None, *, quick: bool = False, minari: bool = False
) -> dict[str, str]:
    """Write the logs of a task as Parquet files or Minari data sets, or the positions of ``text`` as JSON lines.

    Returns:
        SHA-256 of the content of each file by its name.

    Raises:
        SuiteError: the task has no data.
    """
    found = find_task(task)
    arena = arena_of(found, model, split, quick=quick)
    if isinstance(found, Text):
        (case,) = found.cases(arena)
        replace_file(out / "positions.jsonl", json_lines(positions(arena)))
        return {"positions.jsonl": next(iter(found.given(arena, case, 0)))}
    if seeds is not None and seeds < 1:
        raise SuiteError(f"--seeds {seeds}: expected 1 or more")
    if not isinstance(found, LogTask):
        raise SuiteError(f"{task} has no data; offline-v0, evaluate-v0 and text-v0 have")
    hashes = {}
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
