"""Runs of methods on tasks, whose units are played in parallel and can be resumed; each is stored and scored."""

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
from shuttle_marl.policy.foreign import source_hashes
from shuttle_marl.suite import store
from shuttle_marl.suite.method import baseline_of, find
from shuttle_marl.suite.options import SuiteError, SuiteRun
from shuttle_marl.suite.registry import arena_of, find_task, task_of_run
from shuttle_marl.suite.results import summarise
from shuttle_marl.suite.store import Card, Entry, RunConfig

PACKAGES: Final = ("numpy", "scipy", "numba", "msgspec", "zstandard")
PlayedUnit = tuple[Path, Entry, dict[str, bytes]]
"""File of the entry of a unit, the entry, and the compressed table of each policy by its hash."""


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
    card = store.read_card(Path())
    if baseline is not None:
        card = Card(method=options.method, author=card.author, kind=baseline.kind, access=baseline.access)
    name = "-".join([task.name, options.method, options.split, *([] if options.budget is None else [str(options.budget)])])
    words = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
    check_processes(1 if options.ray is not None else options.workers)
    fixed = dataclasses.asdict(config)
    with runs.open_run(options.out, words[:80], fixed, resume=options.resume, overwrite=options.overwrite) as run:
        folder = run.folder
        numbers = itertools.product(range(len(cases)), range(config.seeds))
        units = [unit for unit in numbers if not store.entry_path(folder, *unit).exists()]
        about = {**runs.describe(PACKAGES), "sources": _sources(folder, config, more=bool(units))}
        runs.write_json(folder / runs.MANIFEST, {"status": "running", **about})
        play = functools.partial(play_unit, folder, config, options.seed)
        with Progress(
            *Progress.get_default_columns(), TimeElapsedColumn(), console=console or Console(quiet=True), transient=True
        ) as bar:
            # A unit may take hours.
            for path, entry, policies in bar.track(_played(play, units, options), len(units), description="units"):
                store.write_entry(folder, path, entry, policies)
        store.write_card(folder, card)
        runs.write_json(folder / store.RESULTS, summarise(folder, options.game, options.seed))
        runs.write_json(folder / runs.MANIFEST, {"status": "finished", **about})
    return folder


def _sources(folder: Path, config: RunConfig, *, more: bool) -> Mapping[str, str]:
    """Hashes of the files of a method, which are those that the run was started with if there is more to play."""
    baseline = baseline_of(config.task, config.method)
    path, now = folder / runs.MANIFEST, source_hashes(config.method if baseline is None else f"{__name__}:")
    if not runs.has_results(folder):
        return now
    before: dict[str, str] = runs.read_json(path, dict[str, Any]).get("sources", {}) if path.exists() else {}
    changed = sorted(key for key in before.keys() | now.keys() if before.get(key) != now.get(key))
    if changed and more:
        advice = "two versions are never mixed: restore it, or start again with --overwrite or another --out"
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
        entry = store.checked(Entry(
            case=case.name,
            seed=seed,
            fingerprint=fingerprint,
            policies={role: policy.hash for role, policy in outcome.policies.items()},
            answers=dict(outcome.answers),
            scores=task.score(arena, case, seed, outcome),
            seconds=seconds,
            strokes=outcome.strokes,
            curve=tuple(outcome.curve),
        ), case)  # fmt: skip
    except ShuttleError as error:
        raise SuiteError(f"{config.method}, case {case.name}, seed {seed}: {error}") from error
    if not any(work.iterdir()):
        work.rmdir()
    return store.entry_path(folder, number, seed), entry, {p.hash: p.packed() for p in outcome.policies.values()}
