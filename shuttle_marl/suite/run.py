"""Run a method on a task: units in parallel, resumable, each stored and scored."""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import check_processes, in_processes, open_cluster
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.suite import store
from shuttle_marl.suite.method import Method, baseline_of, find, sources
from shuttle_marl.suite.options import SuiteError, SuiteRun
from shuttle_marl.suite.registry import arena_of, find_task, task_of_run
from shuttle_marl.suite.results import summarise
from shuttle_marl.suite.store import Card, Entry, RunConfig

PACKAGES: Final = ("numpy", "scipy", "numba", "msgspec", "zstandard")
PlayedUnit = tuple[Path, Entry, dict[str, bytes]]
"""File of the entry of a unit, the entry, and the compressed table of each policy by its hash."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Committed:
    """Code of a round that is rerun.

    Attributes:
        hash: of its commitment.
        method: plays it apart from this package, in any process.
        card: of its author.
        rerun: who reruns it.
    """

    hash: str
    method: Method
    card: Card
    rerun: store.Rerun


def run_method(options: SuiteRun, console: Console | None = None, *, committed: Committed | None = None) -> Path:
    """Run a method, or continue an interrupted run; returns the run folder.

    Args:
        committed: code that is run instead of the method that the options name.

    Raises:
        SuiteError, PolicyError: the task or the method does not exist, or the method failed; finished units are kept.
        RunError: the folder cannot be used.
    """
    task = find_task(options.task)
    if committed is None:
        find(task.name, options.method)
    baseline = None if committed is not None else baseline_of(task.name, options.method)
    fixed_seeds = options.quick or (baseline is not None and baseline.kind == "reference")
    arena = arena_of(task, options.game, options.split, quick=options.quick, budget=options.budget, beacon=options.beacon)
    cases = task.cases(arena)
    if options.budget is None and len(budgets := {case.budget for case in cases}) > 1:
        # Scores of different budgets are never pooled.
        return run_method(dataclasses.replace(options, budget=min(budgets)), console, committed=committed)
    config = RunConfig(
        task=task.name,
        method=options.method,
        split=options.split,
        quick=options.quick,
        budget=options.budget,
        seeds=options.seeds or (1 if fixed_seeds else task.seeds),
        game=store.GameOf(model=options.game, hash=arena.game.hash),
        commitment=None if committed is None else committed.hash,
    )
    own = Card(method=options.method, kind=baseline.kind, access=baseline.access) if baseline is not None else None
    name = "-".join([task.name, options.method, options.split, *([] if options.budget is None else [str(options.budget)])])
    words = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
    fixed = dataclasses.asdict(config)
    check_processes(1 if options.ray is not None else options.workers)
    with runs.open_run(options.out, words[:80], fixed, resume=options.resume, overwrite=options.overwrite) as folder:
        numbers = itertools.product(range(len(cases)), range(config.seeds))
        units = [unit for unit in numbers if not store.entry_path(folder, *unit).exists()]
        about = {**runs.describe(PACKAGES), "sources": {} if committed else _sources(folder, config, more=bool(units))}
        runs.write_json(folder / runs.MANIFEST, {"status": "running", **about})
        play = functools.partial(play_unit, folder, config, options.beacon, None if committed is None else committed.method)
        with Progress(
            *Progress.get_default_columns(), TimeElapsedColumn(), console=console or Console(quiet=True), transient=True
        ) as bar:
            # A unit may take hours.
            for path, entry, policies in bar.track(_played(play, units, options), len(units), description="units"):
                store.write_entry(folder, path, entry, policies)
        store.write_card(folder, committed.card if committed is not None else own or store.read_card(Path()))
        if committed is not None:
            runs.write_json(folder / store.RERUN, dataclasses.asdict(committed.rerun))
        runs.write_json(folder / store.RESULTS, summarise(folder, options.beacon, options.game))
        runs.write_json(folder / runs.MANIFEST, {"status": "finished", **about})
    return folder


def _sources(folder: Path, config: RunConfig, *, more: bool) -> Mapping[str, str]:
    """Hashes of the files of a method, which are those that the run was started with if there is more to play."""
    path, now = folder / runs.MANIFEST, sources(config.task, config.method)
    if not runs.has_results(folder):
        return now
    before: dict[str, str] = runs.read_json(path, dict[str, Any]).get("sources", {}) if path.exists() else {}
    changed = sorted(key for key in before.keys() | now.keys() if before.get(key) != now.get(key))
    if changed and more:
        advice = "versions are never mixed: restore it, or start again with --overwrite or another --out"
        raise SuiteError(f"{folder}: {', '.join(changed)} changed after the run was started; {advice}")
    return before


def _played(
    play: Callable[[tuple[int, int]], PlayedUnit], units: Sequence[tuple[int, int]], options: SuiteRun
) -> Iterator[PlayedUnit]:
    if options.ray is not None:
        with open_cluster(options.ray, PACKAGES) as cluster:
            for task in [cluster.submit(play, unit) for unit in units]:
                yield task.result()
    else:
        yield from in_processes(play, units, min(options.workers, len(units)))


def play_unit(folder: Path, config: RunConfig, beacon: str | None, method: Method | None, unit: tuple[int, int]) -> PlayedUnit:
    """Play and score the unit of a case and a seed, in any process.

    Args:
        method: what plays; None: the method that the configuration names.
    """
    number, seed = unit
    task, arena, cases = task_of_run(config, config.game.model, beacon)
    case = cases[number]
    fingerprint = task.fingerprint(arena, case, seed)
    begun = time.monotonic()
    work = folder / "work" / f"{fingerprint[:16]}-{seed}"
    work.mkdir(parents=True, exist_ok=True)
    try:
        outcome = task.play(arena, case, method or find(task.name, config.method), seed, work)
    except ShuttleError as error:
        raise SuiteError(f"{config.method}, case {case.name}, seed {seed}: {error}") from error
    seconds = time.monotonic() - begun
    entry = store.within_budget(store.checked(Entry(
        case=case.name,
        seed=seed,
        fingerprint=fingerprint,
        policies={role: policy.hash for role, policy in outcome.policies.items()},
        answers=dict(outcome.answers),
        scores=task.score(arena, case, seed, outcome),
        parts=task.parts(arena, case, outcome),
        seconds=seconds,
        strokes=outcome.strokes,
        curve=tuple(outcome.curve),
    )), case)  # fmt: skip
    if not any(work.iterdir()):
        work.rmdir()
    return store.entry_path(folder, number, seed), entry, {p.hash: p.packed() for p in outcome.policies.values()}
