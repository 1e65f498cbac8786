"""Results of runs.

- Aggregates: mean over cases of interquartile means over seeds, worst case, and differences.
- Verification: every score is recomputed from the stored policies and answers, and nothing else is proved.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NotRequired, TypedDict

import numpy as np

from shuttle_marl.base import cache
from shuttle_marl.base.errors import ShuttleError, printable
from shuttle_marl.base.files import content_hash
from shuttle_marl.base.intervals import combined, estimate
from shuttle_marl.suite import store
from shuttle_marl.suite.options import ACCESS, Access, Kind, Split, SuiteError
from shuttle_marl.suite.registry import find_task, task_of_run
from shuttle_marl.suite.store import Entry
from shuttle_marl.suite.task import Case, Task

TOLERANCE: Final = 1e-7
"""Largest difference between a recomputed score and the stored one, in the unit of the score."""
NOT_VERIFIED: Final = ("strokes used", "curves", "tuning", "seconds", "access", "that the method produced these policies")
"""What no recomputation can show."""
Units = dict[str, dict[str, list[float]]]
"""Figures by stratum, case and seed."""


class Bounds(TypedDict):
    """A figure and its 95 % interval, if it has one."""

    value: float
    low: float | None
    high: float | None


class Row(TypedDict):
    """Aggregates of a run: a row of a board.

    Attributes:
        author: from the card; empty in the rows of this package.
        cases: hash of the fingerprints of the units of the first seed, from which the others follow; rows of a board have the
            same ones, whether they have one seed, as references, or several.
        access: what the card says that the method reads.
        metric, score, low, high: the main score with its interval.
        worst: the main score of the worst case.
        seconds, strokes: sums over all units, as they are declared.
        remarks: what a reader should know.
        rank: among the methods of a board of this access; equal scores share one.
        behind: paired difference to the best method of the board.
        commit: of this repository, for the rows of its results; None outside of git.
    """

    task: str
    author: str
    method: str
    cases: str
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
    worst: float
    seconds: float
    strokes: int
    scores: dict[str, Bounds]
    units: Units
    remarks: list[str]
    rank: NotRequired[int]
    behind: NotRequired[Bounds]
    commit: NotRequired[str | None]


def summarise(folder: Path, game: str | None = None, seed: str | None = None) -> Row:
    """Aggregates of a run, from its entries as they are stored; :func:`verify_run` recomputes those.

    Args:
        game: model of the game; None: the shipped model that the run names.
        seed: of a round.

    Raises:
        SuiteError: a unit is missing or damaged.
    """
    config, card = store.read_config(folder), store.read_card(folder)
    task, arena, cases = task_of_run(config, game, seed)
    entries = {
        (case.name, number): store.read_unit(folder, place, case, number)
        for place, case in enumerate(cases)
        for number in range(config.seeds)
    }
    units = list(entries.values())
    names = units[0].scores.keys()
    if task.metric not in names or any(entry.scores.keys() != names for entry in units):
        raise SuiteError(f"{folder}: the units have different scores, or none named {task.metric}; `suite verify` says more")
    counting = [case for case in cases if case.counts]
    scores = {name: aggregate(units_of(counting, entries, name)) for name in names}
    if (risk := scores.get("exploitability")) and risk["low"] is not None:
        risk["low"] = max(0.0, risk["low"])
    main, by_unit = scores[task.metric], units_of(counting, entries, task.metric)
    middles = [middle for parts in by_unit.values() for middle in _middles(parts)]
    return {
        "task": task.name,
        "author": card.author or "",
        "method": config.method,
        "cases": content_hash("".join(entries[case.name, 0].fingerprint for case in cases).encode()),
        "split": config.split,
        "quick": config.quick,
        "budget": config.budget,
        "seeds": config.seeds,
        "game": arena.base,
        "kind": card.kind,
        "access": card.access or ACCESS[-1],
        "tuning_strokes": card.tuning_strokes,
        "metric": task.metric,
        "score": main["value"],
        "low": main["low"],
        "high": main["high"],
        "worst": min(middles) if task.higher_is_better else max(middles),
        "seconds": float(sum(entry.seconds for entry in units)),
        "strokes": sum(entry.strokes or 0 for entry in units),
        "scores": scores,
        "units": by_unit,
        "remarks": _remarks(task, config, card, units),
    }


def _remarks(task: Task, config: store.RunConfig, card: store.Card, units: Sequence[Entry]) -> list[str]:
    """What a reader should know."""
    found = ["a quick run"] if config.quick else []
    if card.kind == "reference":
        return found
    if config.seeds < task.seeds:
        found.append(f"{config.seeds} of {task.seeds} seeds")
    if task.budgets and any(entry.strokes is None for entry in units):
        return [*found, "strokes not declared"]
    used = max(entry.strokes or 0 for entry in units)
    smaller = [budget for budget in task.budgets if used <= budget < (config.budget or 0)]
    return found + [f"fits the budget of {budget:,} strokes" for budget in smaller[:1]]


def units_of(cases: Sequence[Case], entries: Mapping[tuple[str, int], Entry], name: str) -> Units:
    """Figures of a score by stratum, case and seed."""
    found: Units = {}
    for case in cases:
        found.setdefault(case.stratum or case.name, {})[case.name] = [
            entry.scores[name] for (of, _), entry in entries.items() if of == case.name
        ]
    return found


def aggregate(units: Units) -> Bounds:
    """The mean over cases of the interquartile mean over seeds, with its 95 % interval.

    The sample of a stratum are its cases, which are exchangeable, or the seeds of its only case.
    """
    estimates = [
        estimate(_middles(cases), trimmed=False) if len(cases) > 1 else estimate(*cases.values(), trimmed=True)
        for cases in units.values()
    ]
    found = combined(estimates, list(map(len, units.values())))
    low, high = (None if np.isnan(bound) else bound for bound in (found.low, found.high))
    return {"value": found.value, "low": low, "high": high}


def _middles(cases: Mapping[str, Sequence[float]]) -> list[float]:
    """The interquartile mean over seeds of each case."""
    return [estimate(seeds, trimmed=True).value for seeds in cases.values()]


def difference(ours: Row, theirs: Row) -> Bounds:
    """Difference of the main score in paired units, positive if the first run is better, aggregated as scores are.

    Raises:
        SuiteError: the runs have different tasks, cases or seeds.
    """
    sizes = [{case: len(seeds) for cases in row["units"].values() for case, seeds in cases.items()} for row in (ours, theirs)]
    if ours["task"] != theirs["task"] or sizes[0] != sizes[1]:
        raise SuiteError(f"{ours['method']} and {theirs['method']} have different cases or seeds; run both with the same ones")
    sign = 1 if find_task(ours["task"]).higher_is_better else -1
    return aggregate({
        stratum: {
            case: [sign * (x - y) for x, y in zip(seeds, theirs["units"][stratum][case], strict=True)]
            for case, seeds in cases.items()
        }
        for stratum, cases in ours["units"].items()
    })  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True)
class Refusal:
    """A unit that is refused, and the reason."""

    case: str
    seed: int
    reason: str


@dataclasses.dataclass(frozen=True, kw_only=True)
class Verification:
    """Verification of a run.

    Attributes:
        summary: of the run; None if a unit is refused.
    """

    units: int
    refused: list[Refusal]
    summary: Row | None


def verify_run(
    folder: Path, game: str | None = None, seed: str | None = None, *, progress: Callable[[Any], Any] = iter
) -> Verification:
    """Recompute all scores of a run from its policies and answers, without the user's cache, into which a method can write.

    Nothing is recomputed if a unit can be refused without it.

    Args:
        game: model of the game; None: the shipped model that the run names.
        seed: of a round.

    Raises:
        SuiteError: the folder holds no run.
    """
    config = store.read_config(folder)
    task, arena, cases = task_of_run(config, game, seed)
    units = [(place, number) for place in range(len(cases)) for number in range(config.seeds)]
    summary, refused = None, []

    def read(place: int, number: int) -> store.Entry:
        if config.game != arena.game.hash:
            raise SuiteError(f"played on game {config.game[:12]}; this is {arena.game.hash[:12]}")
        entry = store.read_unit(folder, place, cases[place], number)
        if other := sorted({*entry.policies} - {*task.roles} | {*entry.answers} - {*task.answers}):
            what = "policies or answers that the task does not have, such as"
            raise SuiteError(f"the entry has {len(other)} {what} {printable(other[0][:40])}")
        return entry

    def recompute(place: int, number: int) -> None:
        entry, case = read(place, number), cases[place]
        fingerprint = task.fingerprint(arena, case, number)
        if entry.fingerprint != fingerprint:
            raise SuiteError(f"the case has fingerprint {entry.fingerprint[:12]}; expected {fingerprint[:12]}")
        outcome = store.read_outcome(folder, entry, arena.game)
        _compare(entry.scores, task.score(arena, case, number, outcome))

    with cache.forgotten():
        for check in (read, recompute):
            for place, number in progress(units):
                try:
                    check(place, number)
                except ShuttleError as error:
                    refused.append(Refusal(case=cases[place].name, seed=number, reason=str(error)))
            if refused:
                break
        else:
            summary = summarise(folder, game, seed)
    return Verification(units=len(units), refused=refused, summary=summary)


def _compare(stored: Mapping[str, float], found: Mapping[str, float]) -> None:
    if other := stored.keys() - found.keys():
        raise SuiteError(f"the entry has scores that the task does not have: {', '.join(sorted(map(printable, other)))}")
    for name, value in found.items():
        if not abs(value - stored.get(name, float("nan"))) <= TOLERANCE:
            raise SuiteError(f"{name} is {value:.9f}, not {stored.get(name)}")
