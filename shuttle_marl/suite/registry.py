"""The tasks by name, and files around them: templates of submissions, and data of cases.

Data of logs may be Minari data sets (extra ``minari``): the single-agent view, one episode for each rally with an own stroke.
Observations are those of ``shuttle_marl/Rally-v0``, with the mask of legal strokes. A reward is 1 for the last own stroke of a
rally that was won. Infos hold the state of the game and the probability of the stroke under the behaviour policy. The
observation after the last stroke is zero, because the rally is over.
"""

import functools
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal
from unittest import mock

import gymnasium
import numpy as np

from shuttle_marl.base.errors import ShuttleError, command, did_you_mean, printable
from shuttle_marl.base.extras import install_hint
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.table_files import write_parquet
from shuttle_marl.game.observation import observations
from shuttle_marl.game.shipped import drawn_game, is_shipped, resolve_game
from shuttle_marl.game.tables import RECOVERY
from shuttle_marl.recording.logs import Transitions
from shuttle_marl.suite.adapt import Adapt, AdaptEntrance
from shuttle_marl.suite.exploit import Equilibrium, EquilibriumEntrance, Exploit, ExploitEntrance
from shuttle_marl.suite.method import kind_of
from shuttle_marl.suite.offline import OPPONENT, Evaluate, LogTask, Offline, log_of_unit
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.population import checked_beacon, rng_of
from shuttle_marl.suite.store import CARD, Card, RunConfig, write_card
from shuttle_marl.suite.task import Arena, Case, Task
from shuttle_marl.suite.text import Text, json_lines, positions

TASKS: Final[dict[str, Task]] = {
    task.name: task
    for task in (
        *(Exploit(), Equilibrium(), Adapt(), Offline(), Evaluate()),
        *(ExploitEntrance(), EquilibriumEntrance(), AdaptEntrance(), Text()),
    )
}


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
    task: Task,
    model: str,
    split: Split,
    *,
    quick: bool = False,
    budget: int | None = None,
    beacon: str | None = None,
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


ENVIRONMENT: Final = "shuttle_marl:shuttle_marl/Rally-v0"


def write_minari(data: Transitions, name: str, folder: Path, model: str, opponent: str) -> None:
    """Write a data set.

    Args:
        name: id of the data set, such as ``shuttle_marl/offline-bc-v0``.
        folder: of the data sets, as in the environment variable ``MINARI_DATASETS_PATH``.
        model, opponent: names of the game and of the opponent, for the environment of the data set.

    Raises:
        ShuttleError: Minari is not installed, or the data set exists.
    """
    try:
        import minari  # noqa: PLC0415  an extra
    except ModuleNotFoundError as error:
        raise ShuttleError(f"Minari is not installed; {install_hint('minari')}") from error
    env = gymnasium.make(ENVIRONMENT, opponent=opponent, game=model)
    with warnings.catch_warnings(), mock.patch.dict(os.environ, {"MINARI_DATASETS_PATH": str(folder.resolve())}):
        warnings.simplefilter("ignore", UserWarning)  # optional metadata are missing
        try:
            minari.create_dataset_from_buffers(name, list(episodes(data)), env=env)
        except ValueError as error:
            raise ShuttleError(f"{folder}: {error}") from error


def episodes(data: Transitions) -> Iterator[Any]:
    """Each rally as an episode."""
    from minari.data_collector import EpisodeBuffer  # noqa: PLC0415  an extra

    seen, mask = observations(data.game, data.state), data.game.mask(data.state).astype(np.int8)
    for rows in np.split(np.arange(len(data)), np.flatnonzero(data.first)[1:]):
        last = rows == rows[-1]
        yield EpisodeBuffer(
            observations={
                "observation": np.pad(seen[rows], ((0, 1), (0, 0))),
                "action_mask": np.pad(mask[rows], ((0, 1), (0, 0))),
            },
            actions=data.stroke[rows].astype(np.int64),
            rewards=data.reward[rows],
            terminations=last,
            truncations=np.zeros_like(last),
            infos={
                "state": np.append(data.state[rows], -1)[:, None],
                "probability": np.append(data.probability[rows], np.float32(np.nan))[:, None],
            },
        )


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
            name = f"{split}-{case.options['behaviour']}-{case.budget}".replace(":", "-").replace("*", "x").replace("+", "-")
            if minari:
                name = f"shuttle_marl/{name}-v{seed}"
                write_minari(log.transitions, name, out, arena.model, OPPONENT)
            else:
                name = f"{name}-{seed}.parquet"
                write_parquet(out / name, log.table())
            hashes[name] = log.hash
    return hashes
