"""Run a method on a task: units in parallel, resumable, each stored and scored."""

import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import check_processes, in_processes, open_cluster
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.suite import frozen, store
from shuttle_marl.suite.isolated import isolated as isolated_method
from shuttle_marl.suite.method import Method, baseline_of, find, sources
from shuttle_marl.suite.options import SuiteError, SuiteRun
from shuttle_marl.suite.registry import arena_of, arena_of_run, find_task
from shuttle_marl.suite.results import summarise
from shuttle_marl.suite.store import Card, Entry, RunConfig

PACKAGES: Final = ("numpy", "scipy", "numba", "msgspec", "zstandard")


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Unit:
    """One case and seed, as it is sent to a worker."""

    folder: Path
    config: RunConfig
    beacon: str | None
    data: Path | None
    case: int
    seed: int


def run_method(options: SuiteRun, console: Console | None = None) -> Path:
    """Run a method, or continue an interrupted run; returns the run folder.

    Raises:
        SuiteError, PolicyError: the task or the method does not exist, or the method failed; finished units are kept.
        RunError: the folder cannot be used.
    """
    task = find_task(options.task)
    method_of(task.name, options.method, isolated=options.isolated)
    baseline = baseline_of(task.name, options.method)
    fixed_seeds = options.quick or (baseline is not None and baseline.kind == "reference")
    arena = arena_of(
        task, options.game, options.split, quick=options.quick, budget=options.budget, beacon=options.beacon, data=options.data
    )
    cases = task.cases(arena)
    if options.budget is None and len(budgets := {case.budget for case in cases}) > 1:
        # Scores of different budgets are never pooled.
        return run_method(dataclasses.replace(options, budget=min(budgets)), console)
    task.fingerprint(arena, cases[0], 0)  # fails before a folder is made if something is missing, such as --data
    config = RunConfig(
        task=task.name,
        method=options.method,
        split=options.split,
        quick=options.quick,
        budget=options.budget,
        seeds=options.seeds or (1 if fixed_seeds else task.seeds),
        game=store.GameOf(model=options.game, hash=arena.game.hash),
        isolated=options.isolated,
    )
    own = baseline and Card(method=options.method, kind=baseline.kind, access=baseline.access)
    name = "-".join([task.name, options.method, options.split, *([] if options.budget is None else [str(options.budget)])])
    words = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)
    fixed = dataclasses.asdict(config)
    check_processes(1 if options.ray is not None else options.workers)
    with runs.open_run(options.out, words[:80], fixed, resume=options.resume, overwrite=options.overwrite) as folder:
        numbers = [(case, seed) for case in range(len(cases)) for seed in range(config.seeds)]
        units = [
            _Unit(folder=folder, config=config, beacon=options.beacon, data=options.data, case=case, seed=seed)
            for case, seed in numbers
            if not store.entry_path(folder, case, seed).exists()
        ]
        about = {**runs.describe(PACKAGES), "sources": _sources(folder, config, more=bool(units))}
        runs.write_json(folder / runs.MANIFEST, {"status": "running", **about})
        _play_all(folder, units, options, console or Console(quiet=True))
        store.write_card(folder, own or store.read_card(Path()))
        runs.write_json(folder / store.RESULTS, summarise(folder, options.beacon, options.game))
        runs.write_json(folder / runs.MANIFEST, {"status": "finished", **about})
    return folder


def method_of(task: str, name: str, *, isolated: bool) -> Method:
    """The method of a run, see :func:`shuttle_marl.suite.method.find`.

    Raises:
        SuiteError: there is none, or a method of this package is to be isolated.
    """
    if not isolated:
        return find(task, name)
    if baseline_of(task, name) is not None or ":" not in name or name.startswith("program:"):
        raise SuiteError(f"--isolated takes a method MODULE:ATTRIBUTE of your own, not {name!r}")
    return isolated_method(name)


def _sources(folder: Path, config: RunConfig, *, more: bool) -> Mapping[str, str]:
    """Hashes of the files of a method, which are those that the run was started with if there is more to play."""
    path, now = folder / runs.MANIFEST, sources(config.task, config.method, isolated=config.isolated)
    if not runs.has_results(folder):
        return now
    before: dict[str, str] = runs.read_json(path, dict[str, Any]).get("sources", {}) if path.exists() else {}
    changed = sorted(key for key in before.keys() | now.keys() if before.get(key) != now.get(key))
    if changed and more:
        raise SuiteError(
            f"{folder}: {', '.join(changed)} changed after the run was started, and results of two versions of a method are "
            "never mixed; restore what it was, or start the run again with --overwrite or another --out"
        )
    return before


def _play_all(folder: Path, units: Sequence[_Unit], options: SuiteRun, console: Console) -> None:
    with Progress(*Progress.get_default_columns(), TimeElapsedColumn(), console=console, transient=True) as bar:
        for played in bar.track(_played(units, options), len(units), description="units"):  # a unit may take hours
            store.write_entry(folder, played.path, played.entry, played.policies)


def _played(units: Sequence[_Unit], options: SuiteRun) -> Iterator["PlayedUnit"]:
    if options.ray is not None:
        with open_cluster(options.ray, PACKAGES) as cluster:
            tasks = [cluster.submit(play_unit, unit) for unit in units]
            for task in tasks:
                yield task.result()
    else:
        yield from in_processes(play_unit, units, min(options.workers, len(units)))


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlayedUnit:
    """A unit that was played and scored.

    Attributes:
        path: file of the entry.
        entry: the entry.
        policies: compressed table of each policy, by its hash.
    """

    path: Path
    entry: Entry
    policies: dict[str, bytes]


def play_unit(unit: _Unit) -> PlayedUnit:
    """Play and score one unit, in any process."""
    config, task = unit.config, find_task(unit.config.task)
    arena = arena_of_run(task, config, config.game.model, beacon=unit.beacon, data=unit.data)
    case = task.cases(arena)[unit.case]
    fingerprint = task.fingerprint(arena, case, unit.seed)
    frozen.load().check(task, config.split, f"{case.name}/{unit.seed}", fingerprint, arena.base)
    begun = time.monotonic()
    work = unit.folder / "work" / f"{unit.case:03d}-{unit.seed}"
    work.mkdir(parents=True, exist_ok=True)
    try:
        outcome = task.play(arena, case, method_of(task.name, config.method, isolated=config.isolated), unit.seed, work)
    except ShuttleError as error:
        raise SuiteError(f"{config.method}, case {case.name}, seed {unit.seed}: {error}") from error
    seconds = time.monotonic() - begun
    entry = store.checked(Entry(
        case=case.name,
        seed=unit.seed,
        fingerprint=fingerprint,
        policies={role: policy.hash for role, policy in outcome.policies.items()},
        answers=dict(outcome.answers),
        scores=task.score(arena, case, unit.seed, outcome),
        parts=task.parts(arena, case, outcome),
        seconds=seconds,
        strokes=outcome.strokes,
        curve=tuple(outcome.curve),
    ))  # fmt: skip
    if not any(work.iterdir()):
        work.rmdir()
    path = store.entry_path(unit.folder, unit.case, unit.seed)
    return PlayedUnit(path=path, entry=entry, policies={p.hash: p.packed() for p in outcome.policies.values()})
