"""Runs of methods on tasks, whose units are played in parallel and can be resumed; and templates of methods."""

import dataclasses
import functools
import itertools
import time
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import check_processes, in_processes
from shuttle_marl.base.errors import ShuttleError, command
from shuttle_marl.base.files import replace_file
from shuttle_marl.policy.foreign import source_hashes
from shuttle_marl.suite import results
from shuttle_marl.suite.method import baseline_of, find, kind_of
from shuttle_marl.suite.options import SuiteError, SuiteRun
from shuttle_marl.suite.results import CARD, Card, Entry, RunConfig, arena_of, find_task, summarise, task_of_run, write_card

PACKAGES: Final = ("numpy", "scipy", "numba", "msgspec", "zstandard")
PlayedUnit = tuple[Path, Entry, dict[str, bytes]]  # file of an entry, the entry, and packed tables by hash


_METHODS: Final = {  # template and its method, by kind of task
    **dict.fromkeys(("exploit", "equilibrium"), "player:train"),
    "adapt": "adapter:Adapter",
    "offline": "offline:Learner",
    "evaluate": "estimator:Estimator",
}


def run_method(options: SuiteRun, console: Console | None = None) -> Path:
    """Run a method, or continue an interrupted run; returns the run folder.

    Raises:
        SuiteError, PolicyError: the task or the method does not exist, or the method failed; finished units are kept.
        RunError: the folder cannot be used.
    """
    task = find_task(options.task)
    find(task.name, options.method)
    baseline = baseline_of(task.name, options.method)
    fixed_seeds = options.quick or (baseline is not None and baseline.kind == "reference")
    arena = arena_of(task, options.game, options.split, quick=options.quick, budget=options.budget, seed=options.seed)
    cases = task.cases(arena)
    if options.budget is None and len(budgets := {case.budget for case in cases}) > 1:
        # Scores of different budgets are never pooled.
        return run_method(dataclasses.replace(options, budget=min(budgets)), console)
    config = RunConfig(
        task=task.name,
        method=options.method,
        split=options.split,
        quick=options.quick,
        budget=options.budget,
        seeds=options.seeds or (1 if fixed_seeds else task.seeds),
        model=options.game,
        game=arena.game.hash,
    )
    card = results.read_card(Path())
    if baseline is not None:
        card = Card(author=card.author, access=baseline.access)
    name = "-".join([task.name, options.method, options.split, *([] if options.budget is None else [str(options.budget)])])
    words = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
    check_processes(1 if options.ray is not None else options.workers)
    fixed = dataclasses.asdict(config)
    with runs.open_run(options.out, words[:80], fixed, resume=options.resume, overwrite=options.overwrite) as run:
        folder = run.folder
        numbers = itertools.product(range(len(cases)), range(config.seeds))
        units = [unit for unit in numbers if not results.entry_path(folder, *unit).exists()]
        if units:
            sources = source_hashes(options.method if baseline is None else f"{__name__}:")
            run.begin(PACKAGES, same={"sources": sources})
        play = functools.partial(play_unit, folder, config, options.seed)
        # Code of strangers finds nothing that its other units left.
        played = in_processes(
            play, units, min(options.workers, len(units)), apart=baseline is None, ray=options.ray, packages=PACKAGES
        )
        console = console or Console(quiet=True)
        columns = (*Progress.get_default_columns(), TimeElapsedColumn())
        saved = functools.partial(_saved, folder, len(cases) * config.seeds)
        with run.resumable(saved), Progress(*columns, console=console, transient=True) as bar:
            # A unit may take hours.
            for path, entry, policies in bar.track(played, len(units), description="units"):
                results.write_entry(folder, path, entry, policies)
        if units:
            run.finish()
        write_card(folder, card)
        runs.write_json(folder / results.RESULTS, summarise(folder, options.game, options.seed))
    return folder


def _saved(folder: Path, units: int) -> str:
    return f"{len(list((folder / results.ENTRIES).glob('*.json')))} of {units} units are saved"


def play_unit(folder: Path, config: RunConfig, round_seed: str | None, unit: tuple[int, int]) -> PlayedUnit:
    """Play and score the unit of a case and a seed, in any process."""
    number, seed = unit
    task, arena, cases = task_of_run(config, config.model, round_seed)
    case = cases[number]
    fingerprint = task.fingerprint(arena, case, seed)
    begun = time.monotonic()
    work = folder / "work" / f"{fingerprint[:16]}-{seed}"
    work.mkdir(parents=True, exist_ok=True)
    try:
        outcome = task.play(arena, case, find(task.name, config.method), seed, work)
        seconds = time.monotonic() - begun
        entry = results.checked(Entry(
            case=case.name,
            seed=seed,
            fingerprint=fingerprint,
            policies={role: policy.hash for role, policy in outcome.policies.items()},
            answers=dict(outcome.answers),
            scores=task.score(arena, case, seed, outcome),
            seconds=seconds,
            strokes=outcome.strokes,
        ), case)  # fmt: skip
    except ShuttleError as error:
        raise SuiteError(f"{config.method}, case {case.name}, seed {seed}: {error}") from error
    if not any(work.iterdir()):
        work.rmdir()
    return results.entry_path(folder, number, seed), entry, {p.hash: p.packed() for p in outcome.policies.values()}


def new_submission(task: str, out: Path, author: str) -> str:
    """Write a template of a method and a card into a folder.

    Args:
        out: folder, which is created; existing files are not replaced.

    Returns:
        The command that runs it, from that folder.

    Raises:
        SuiteError: there is no such task, the author has no letters, or a file exists.
    """
    module, _, attribute = _METHODS[kind_of(find_task(task).name)].partition(":")
    if "/" in author or not any(map(str.isalpha, author)):
        raise SuiteError(f"--author {author!r}: expected a name with letters, without /")
    # Modules of the user are found by name, so that of the template must be free.
    target = out / f"my_{module}.py"
    for path in (target, out / CARD):
        if path.exists():
            raise SuiteError(f"{path}: already exists; name another folder")
    replace_file(target, (Path(__file__).parent / "templates" / "submission" / f"{module}.py").read_bytes())
    write_card(out, Card(author=author, tuning_strokes=0))
    return command("suite", "run", task, "--method", f"{target.stem}:{attribute}", "--quick")
