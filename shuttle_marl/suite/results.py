"""Aggregates of runs: interquartile means, performance profiles and differences, with bootstrap intervals.

As recommended by Agarwal et al. (NeurIPS 2021, arXiv 2108.13264). The bootstrap resamples the units within each stratum of cases.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.intervals import Interval, stratified
from shuttle_marl.suite import frozen, store
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.registry import arena_of_run, find_task
from shuttle_marl.suite.store import Entry
from shuttle_marl.suite.task import Case, Task

PROFILE_POINTS: Final = 21
"""Number of thresholds of a performance profile."""


def summarise(folder: Path, beacon: str | None = None, game: str | None = None) -> dict[str, Any]:
    """Aggregates of a run, from its entries as they are stored; :func:`shuttle_marl.suite.verify.verify_run` recomputes those.

    Args:
        folder: of the run.
        beacon: randomness of the beacon round of the hidden split.
        game: model of the game; None: the shipped model that the run names.

    Raises:
        SuiteError: a unit is missing or damaged.
    """
    config = store.read_config(folder)
    task = find_task(config.task)
    cases = cases_of(task, config, beacon, game)
    entries = store.read_entries(folder, [case.name for case in cases], config.seeds)
    missing = len(cases) * config.seeds - len(entries)
    if missing:
        raise SuiteError(f"{folder}: {missing} of {len(cases) * config.seeds} units are missing; --resume plays them")
    units = list(entries.values())
    scores = {name: aggregate(task, cases, entries, name) for name in units[0].scores}
    main = scores[task.metric]
    return {
        "task": task.name,
        "method": config.method,
        "split": config.split,
        "quick": config.quick,
        "budget": config.budget,
        "game": config.game.hash,
        "official": frozen.load().official(config.game.hash) and not config.quick,
        "metric": task.metric,
        "score": main.value,
        "low": _known(main.low),
        "high": _known(main.high),
        "seeds": config.seeds,
        "exploitability": scores["exploitability"].value if "exploitability" in scores else None,
        "seconds": float(sum(entry.seconds for entry in units)),
        "strokes": sum(entry.strokes or 0 for entry in units),
        "scores": {name: {key: _known(bound) for key, bound in each._asdict().items()} for name, each in scores.items()},
        "strata": {
            stratum: {name: float(np.mean(values)) for name, values in by_name.items()}
            for stratum, by_name in _by_stratum(cases, entries).items()
        },
        "profile": profile(_columns(cases, entries, task.metric)),
    }


def _known(bound: float) -> float | None:
    """A bound of an interval; None for a single unit, which has none."""
    return None if np.isnan(bound) else bound


def cases_of(task: Task, config: store.RunConfig, beacon: str | None = None, game: str | None = None) -> list[Case]:
    """Cases of a run."""
    return task.cases(arena_of_run(task, config, game, beacon=beacon))


def aggregate(task: Task, cases: Sequence[Case], entries: Mapping[tuple[str, int], Entry], name: str) -> Interval:
    """A score over all units, with its 95 % interval."""
    return stratified(_columns(cases, entries, name), task.statistic)


def difference(task: Task, ours: Path, theirs: Path, game: str | None = None) -> Interval:
    """Mean difference of the main score in paired units, positive if the first run is better, with its 95 % interval.

    Raises:
        SuiteError: the runs have different cases or seeds.
    """
    columns = []
    for folder in (ours, theirs):
        config = store.read_config(folder)
        cases = cases_of(task, config, game=game)
        columns.append(_columns(cases, store.read_entries(folder, [case.name for case in cases], config.seeds), task.metric))
    shapes = [[len(column) for column in part] for part in columns]
    if shapes[0] != shapes[1]:
        raise SuiteError(f"{ours} and {theirs} have different cases or seeds; run both with the same ones")
    sign = 1 if task.higher_is_better else -1
    return stratified([sign * (first - second) for first, second in zip(*columns, strict=True)], "mean")


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
