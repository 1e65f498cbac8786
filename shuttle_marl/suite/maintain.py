"""Files around the tasks: templates of submissions, data of cases, and the frozen settings."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, Literal

from shuttle_marl.base.errors import command
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.table_files import write_parquet
from shuttle_marl.recording.minari_data import write_minari
from shuttle_marl.suite import frozen
from shuttle_marl.suite.frozen import Frozen
from shuttle_marl.suite.method import kind_of
from shuttle_marl.suite.offline import OPPONENT, LogTask, log_of_unit
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.registry import TASKS, arena_of, find_task
from shuttle_marl.suite.store import CARD, Card, write_card
from shuttle_marl.suite.text import Text, json_lines, positions

Language = Literal["python", "perl"]
_TEMPLATES: Final = Path(__file__).parent / "templates" / "submission"
_PYTHON: Final = {
    "exploit": "player:train",
    "equilibrium": "player:train",
    "robust": "robust_player:train",
    "adapt": "adapter:Adapter",
    "offline": "offline:Learner",
    "evaluate": "estimator:Estimator",
    "imitate": "imitation:Imitator",
    "text": "text:Player",
}
"""Template and method of each kind of task."""
_PERL: Final = ("exploit", "equilibrium", "robust")


def new_submission(task: str, out: Path, language: Language = "python") -> str:
    """Write a template of a method and a card into a folder.

    Args:
        task: name of the task.
        out: folder, which is created; existing files are not replaced.
        language: of the template.

    Returns:
        The command that runs it, from that folder.

    Raises:
        SuiteError: there is no such task or template, or a file exists.
    """
    kind = kind_of(find_task(task).name)
    if language == "perl" and kind not in _PERL:
        raise SuiteError(f"there is no template in Perl for {task}; there is one for {', '.join(_PERL)}")
    module, _, attribute = _PYTHON[kind].partition(":")
    source = "player.pl" if language == "perl" else f"{module}.py"
    # Modules of the user are found by name, so that of the template must be free.
    target = out / (source if language == "perl" else f"my_{module}.py")
    for path in (target, out / CARD):
        if path.exists():
            raise SuiteError(f"{path}: already exists; name another folder")
    replace_file(target, (_TEMPLATES / source).read_bytes())
    write_card(out, Card(method=target.stem, tuning_strokes=0))
    method = "program:perl player.pl" if language == "perl" else f"my_{module}:{attribute}"
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


def freeze(
    path: Path,
    tasks: Sequence[str],
    *,
    model: str = "default",
    data: Path | None = None,
    progress: Callable[[Sequence[Any]], Any] = lambda units: units,
) -> Frozen:
    """Write the frozen settings: hash of the game, and fingerprint of every case of the public splits.

    Fingerprints of other tasks are kept if they are of the same game.

    Args:
        path: file of the frozen settings.
        tasks: names of tasks; empty: all that need no annotated matches, or all if ``data`` are named.
        model: the game.
        data: annotated matches.
        progress: wraps the cases.
    """
    game = arena_of(TASKS["exploit-v0"], model, "test").game
    before = frozen.load(path)
    kept = before if before.official(game.hash) else Frozen()
    cases, variants = dict(kept.cases), set(kept.variants)
    names = tasks or [name for name in TASKS if data is not None or name != "imitate-v0"]
    units = []
    for name in names:
        task = find_task(name)
        for split in task.splits:
            if split != "hidden":
                arena = arena_of(task, model, split, data=data)
                variants |= {arena.base} - {game.hash}
                units += [(task, split, arena, case, seed) for case in task.cases(arena) for seed in range(task.seeds)]
    for task, split, arena, case, seed in progress(units):
        cases[f"{task.name}/{split}/{case.name}/{seed}"] = task.fingerprint(arena, case, seed)
    done = Frozen(game=game.hash, variants=sorted(variants), cases=cases)
    frozen.save(done, path)
    return done
