"""Aggregates of runs: interquartile means, performance profiles and differences, with bootstrap intervals.

As recommended by Agarwal et al. (NeurIPS 2021, arXiv 2108.13264). The bootstrap resamples the units within each stratum of cases.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NotRequired, TypedDict

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.intervals import Interval, stratified
from shuttle_marl.suite import frozen, store
from shuttle_marl.suite.options import Access, Kind, Split, SuiteError
from shuttle_marl.suite.registry import arena_of_run, find_task
from shuttle_marl.suite.store import Entry
from shuttle_marl.suite.task import Arena, Case, Task

PROFILE_POINTS: Final = 21
"""Number of thresholds of a performance profile."""


class Bounds(TypedDict):
    """A figure and its 95 % interval, if it has one."""

    value: float
    low: float | None
    high: float | None


class Row(TypedDict):
    """Aggregates of a run: a row of a board.

    Attributes:
        task, method, split, quick, budget, seeds: of the configuration.
        game: hash of the game.
        kind, access, tuning_strokes: of the card.
        metric, score, low, high: the main score with its interval.
        exploitability: if the task scores it.
        seconds, strokes: sums over all units, as they are declared.
        scores: all scores by name.
        strata: mean scores of each stratum of cases.
        profile: see :func:`profile`.
        outputs: hash of all policies and answers; runs with the same ones are the same.
        remarks: why the row is not official, or what a reader should know.
        official: whether there is no remark.
        verified: whether all scores were recomputed; None: not checked.
        rank: among the methods of a board with this access.
        behind: paired difference to the best method.
    """

    task: str
    method: str
    split: Split
    quick: bool
    budget: int | None
    seeds: int
    game: str
    kind: Kind
    access: Access
    tuning_strokes: int | str | None
    metric: str
    score: float
    low: float | None
    high: float | None
    exploitability: float | None
    seconds: float
    strokes: int
    scores: dict[str, Bounds]
    strata: dict[str, dict[str, float]]
    profile: dict[str, list[float]]
    outputs: str
    remarks: list[str]
    official: bool
    verified: NotRequired[bool | None]
    rank: NotRequired[int]
    behind: NotRequired[Bounds]


def summarise(folder: Path, beacon: str | None = None, game: str | None = None) -> Row:
    """Aggregates of a run, from its entries as they are stored; :func:`shuttle_marl.suite.verify.verify_run` recomputes those.

    Args:
        folder: of the run.
        beacon: randomness of the beacon round of the hidden split.
        game: model of the game; None: the shipped model that the run names.

    Raises:
        SuiteError: a unit is missing or damaged.
    """
    config, card = store.read_config(folder), store.read_card(folder)
    task = find_task(config.task)
    cases = cases_of(task, arena_of_run(task, config, game, beacon=beacon), config)
    entries = store.read_entries(folder, cases, config.seeds)
    missing = len(cases) * config.seeds - len(entries)
    if missing:
        raise SuiteError(f"{folder}: {missing} of {len(cases) * config.seeds} units are missing; --resume plays them")
    units = list(entries.values())
    names = units[0].scores.keys()
    if task.metric not in names or any(entry.scores.keys() != names for entry in units):
        raise SuiteError(f"{folder}: the units have different scores, or none named {task.metric}; `suite verify` says more")
    scores = {name: aggregate(task, cases, entries, name) for name in names}
    different = min(len({_output(entries[case.name, seed]) for seed in range(config.seeds)}) for case in cases)
    if different < config.seeds:  # copies are no sample
        scores = {name: {"value": each["value"], "low": None, "high": None} for name, each in scores.items()}
    main, remarks = scores[task.metric], _remarks(task, config, card, units, different)
    return {
        "task": task.name,
        "method": config.method,
        "split": config.split,
        "quick": config.quick,
        "budget": config.budget,
        "seeds": config.seeds,
        "game": config.game.hash,
        "kind": card.kind,
        "access": card.access or task.access,
        "tuning_strokes": card.tuning_strokes,
        "metric": task.metric,
        "score": main["value"],
        "low": main["low"],
        "high": main["high"],
        "exploitability": scores["exploitability"]["value"] if "exploitability" in scores else None,
        "seconds": float(sum(entry.seconds for entry in units)),
        "strokes": sum(entry.strokes or 0 for entry in units),
        "scores": scores,
        "strata": {
            stratum: {name: float(np.mean(values)) for name, values in by_name.items()}
            for stratum, by_name in _by_stratum(cases, entries).items()
        },
        "profile": profile(_columns(cases, entries, task.metric)),
        "outputs": hashlib.sha256(repr(sorted(map(_output, units))).encode()).hexdigest(),
        "remarks": remarks,
        "official": not remarks,
    }


def _output(entry: Entry) -> str:
    """What a unit produced, as text."""
    return json.dumps([entry.policies, entry.answers], sort_keys=True)


def _remarks(task: Task, config: store.RunConfig, card: store.Card, units: Sequence[Entry], different: int) -> list[str]:
    """Why results of a run are not official; ``different``: number of seeds that differ in every case."""
    found = []
    if config.quick:
        found.append("a quick run")
    if not frozen.load().official(config.game.hash):
        found.append("another game than the frozen one")
    if different < config.seeds:
        found.append(f"{config.seeds} seeds, of which {different} differ")
    if card.kind != "reference":
        if config.seeds < task.seeds:
            found.append(f"{config.seeds} of {task.seeds} seeds")
        found += _remarks_on_strokes(task, config, units)
    return found


def _remarks_on_strokes(task: Task, config: store.RunConfig, units: Sequence[Entry]) -> list[str]:
    if not task.budgets:
        return []
    if any(entry.strokes is None for entry in units):
        return ["strokes not declared"]
    used = max(entry.strokes or 0 for entry in units)
    smaller = [budget for budget in task.budgets if used <= budget < (config.budget or 0)]
    return [f"fits the budget of {smaller[0]:,} strokes"] if smaller else []


def cases_of(task: Task, arena: Arena, config: store.RunConfig) -> list[Case]:
    """Cases of a run.

    Raises:
        SuiteError: they have different budgets, which are never pooled.
    """
    cases = task.cases(arena)
    if config.budget is None and len({case.budget for case in cases}) > 1:
        raise SuiteError("the run names no budget; budgets are never pooled")
    return cases


def aggregate(task: Task, cases: Sequence[Case], entries: Mapping[tuple[str, int], Entry], name: str) -> Bounds:
    """A score over all units, with its 95 % interval."""
    return _bounds(stratified(_columns(cases, entries, name), task.statistic))


def _bounds(found: Interval) -> Bounds:
    """An interval as JSON; without bounds for a single unit, which has none."""
    low, high = (None if np.isnan(bound) else bound for bound in (found.low, found.high))
    return {"value": found.value, "low": low, "high": high}


def difference(task: Task, ours: Path, theirs: Path, game: str | None = None) -> Bounds:
    """Mean difference of the main score in paired units, positive if the first run is better, with its 95 % interval.

    Raises:
        SuiteError: the runs have different cases or seeds.
    """
    columns = []
    for folder in (ours, theirs):
        config = store.read_config(folder)
        cases = cases_of(task, arena_of_run(task, config, game), config)
        columns.append(_columns(cases, store.read_entries(folder, cases, config.seeds), task.metric))
    shapes = [[len(column) for column in part] for part in columns]
    if shapes[0] != shapes[1]:
        raise SuiteError(f"{ours} and {theirs} have different cases or seeds; run both with the same ones")
    sign = 1 if task.higher_is_better else -1
    return _bounds(stratified([sign * (first - second) for first, second in zip(*columns, strict=True)], "mean"))


def profile(columns: Sequence[F64]) -> dict[str, list[float]]:
    """Performance profile: fraction of units whose score is above each threshold."""
    values = np.concatenate(columns)
    thresholds = np.linspace(min(0.0, values.min()), max(1.0, values.max()), PROFILE_POINTS)
    return {"threshold": thresholds.tolist(), "above": (values[:, None] > thresholds).mean(axis=0).tolist()}


def _by_stratum(cases: Sequence[Case], entries: Mapping[tuple[str, int], Entry]) -> dict[str, dict[str, list[float]]]:
    stratum = {case.name: case.stratum for case in cases}
    found: dict[str, dict[str, list[float]]] = {}
    for (name, _), entry in entries.items():
        for score, value in entry.scores.items():
            found.setdefault(stratum[name], {}).setdefault(score, []).append(value)
    return found


def _columns(cases: Sequence[Case], entries: Mapping[tuple[str, int], Entry], name: str) -> list[F64]:
    """Values of a score by stratum, in the order of cases and seeds; without controls."""
    counting = {case.name for case in cases if case.counts}
    counted = {unit: entry for unit, entry in entries.items() if unit[0] in counting}
    return [np.array(by_name[name]) for by_name in _by_stratum(cases, counted).values()]
