"""Results of runs.

- Aggregates: mean over cases of interquartile means over seeds, worst case, and differences.
- Verification: every score is recomputed from the stored policies and answers, and nothing else is proved.
"""

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NotRequired, TypedDict

import numpy as np

from shuttle_marl.base.errors import ShuttleError, printable
from shuttle_marl.base.files import content_hash
from shuttle_marl.base.intervals import combined, estimate
from shuttle_marl.suite import store
from shuttle_marl.suite.method import baseline_of
from shuttle_marl.suite.options import ACCESS, NOTHING_GIVEN, Access, Kind, Split, SuiteError, VerifyOptions
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
        author: from the card, or empty: the package.
        cases: hash of the fingerprints of the units of the first seed, from which the others follow; rows of a board have the
            same ones, whether they have one seed, as references, or several.
        access: what the method says that it reads; methods that were rerun get samples alone.
        commitment: hash of the code of an entry of a round.
        metric, score, low, high: the main score with its interval.
        worst: the main score of the worst case.
        seconds, strokes: sums over all units, as they are declared.
        outputs: hash of all policies and answers; runs with the same ones are the same.
        remarks: what a reader should know.
        recomputed: whether all scores were recomputed; None: not checked.
        reran_by: who reran the code to these scores; none: the row is self-reported.
        round: hash of the file of the round by which it was rerun.
        rank: among the methods of a board of this class and access.
        behind: paired difference to the best method.
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
    commitment: str | None
    tuning_strokes: int | str | None
    metric: str
    score: float
    low: float | None
    high: float | None
    worst: float
    seconds: float
    strokes: int
    scores: dict[str, Bounds]
    strata: dict[str, dict[str, float]]
    units: Units
    outputs: str
    remarks: list[str]
    recomputed: NotRequired[bool | None]
    reran_by: NotRequired[list[str]]
    round: NotRequired[str]
    rank: NotRequired[int]
    behind: NotRequired[Bounds]
    commit: NotRequired[str | None]


def summarise(folder: Path, beacon: str | None = None, game: str | None = None) -> Row:
    """Aggregates of a run, from its entries as they are stored; :func:`verify_run` recomputes those.

    Args:
        beacon: randomness of the beacon of a round.
        game: model of the game; None: the shipped model that the run names.

    Raises:
        SuiteError: a unit is missing or damaged.
    """
    config, card = store.read_config(folder), store.read_card(folder)
    task, arena, cases = task_of_run(config, game, beacon)
    entries = {
        (case.name, seed): store.read_unit(folder, number, case, seed)
        for number, case in enumerate(cases)
        for seed in range(config.seeds)
        if store.entry_path(folder, number, seed).exists()
    }
    if missing := len(cases) * config.seeds - len(entries):
        raise SuiteError(f"{folder}: {missing} of {len(cases) * config.seeds} units are missing; --resume plays them")
    units = list(entries.values())
    names, parts = units[0].scores.keys(), units[0].parts.keys()
    if task.metric not in names or any(entry.scores.keys() != names or entry.parts.keys() != parts for entry in units):
        raise SuiteError(f"{folder}: the units have different scores, or none named {task.metric}; `suite verify` says more")
    counting = [case for case in cases if case.counts]
    scores = {name: aggregate(units_of(counting, entries, name, task.metric)) for name in names}
    if (risk := scores.get("exploitability")) and risk["low"] is not None:
        risk["low"] = max(0.0, risk["low"])
    different = min(
        len({seen(entries[case.name, seed]) for seed in range(config.seeds)}) for case in cases for seen in (_output, _scores)
    )
    if different < config.seeds:  # copies are no sample
        scores = {name: {"value": each["value"], "low": None, "high": None} for name, each in scores.items()}
    main, remarks = scores[task.metric], _remarks(task, config, card, units, different)
    # Methods of this package declare what they read, those of others on their card, or all there is.
    baseline = baseline_of(task.name, config.method) if config.commitment is None else None
    authors = card.authors or ("anonymous" if baseline is None else "")
    said = baseline.access if baseline is not None else card.access or ACCESS[-1]
    by_unit = units_of(counting, entries, task.metric, task.metric)
    middles = [middle for parts in by_unit.values() for middle in _middles(parts)]
    return {
        "task": task.name,
        "author": authors if isinstance(authors, str) else ", ".join(authors),
        "method": config.method,
        "cases": content_hash("".join(entries[case.name, 0].fingerprint for case in cases).encode()),
        "split": config.split,
        "quick": config.quick,
        "budget": config.budget,
        "seeds": config.seeds,
        "game": arena.base,
        "kind": card.kind,
        "access": said if config.commitment is None else "samples",
        "commitment": config.commitment,
        "tuning_strokes": card.tuning_strokes,
        "metric": task.metric,
        "score": main["value"],
        "low": main["low"],
        "high": main["high"],
        "worst": min(middles) if task.higher_is_better else max(middles),
        "seconds": float(sum(entry.seconds for entry in units)),
        "strokes": sum(entry.strokes or 0 for entry in units),
        "scores": scores,
        "strata": {
            stratum: {
                name: aggregate(units_of([case for case in cases if case.stratum == stratum], entries, name))["value"]
                for name in names
            }
            for stratum in dict.fromkeys(case.stratum for case in cases)
        },
        "units": by_unit,
        "outputs": content_hash(repr(sorted(map(_output, units))).encode()),
        "remarks": remarks,
    }


def _output(entry: Entry) -> str:
    """What a unit produced, as text."""
    return json.dumps([entry.policies, entry.answers], sort_keys=True)


def _scores(entry: Entry) -> tuple[float, ...]:
    """Scores, to the digits to which they are verified: a table that was changed where it is never used is a copy."""
    return tuple(round(score, 7) for score in entry.scores.values())


def _remarks(task: Task, config: store.RunConfig, card: store.Card, units: Sequence[Entry], different: int) -> list[str]:
    """What a reader should know; ``different``: number of seeds that differ in every case."""
    found = []
    if config.quick:
        found.append("a quick run")
    if different < config.seeds:
        found.append(f"{config.seeds} seeds, of which {different} differ")
    if card.kind == "reference":
        return found
    if config.seeds < task.seeds:
        found.append(f"{config.seeds} of {task.seeds} seeds")
    if task.budgets and any(entry.strokes is None for entry in units):
        return [*found, "strokes not declared"]
    used = max(entry.strokes or 0 for entry in units)
    smaller = [budget for budget in task.budgets if used <= budget < (config.budget or 0)]
    return found + [f"fits the budget of {budget:,} strokes" for budget in smaller[:1]]


def units_of(cases: Sequence[Case], entries: Mapping[tuple[str, int], Entry], name: str, metric: str = "") -> Units:
    """Figures of a score by stratum, case and seed; parts of a case stand for cases if the score is the metric."""
    found: Units = {}
    for case in cases:
        units = [entry for (of, _), entry in entries.items() if of == case.name]
        if name == metric and units[0].parts:
            found[case.name] = {part: [entry.parts[part] for entry in units] for part in units[0].parts}
        else:
            found.setdefault(case.stratum, {})[case.name] = [entry.scores[name] for entry in units]
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
    sizes = [
        (row["task"], [(case, len(seeds)) for cases in row["units"].values() for case, seeds in cases.items()])
        for row in (ours, theirs)
    ]
    if sizes[0] != sizes[1]:
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
    folder: Path, given: VerifyOptions = NOTHING_GIVEN, *, progress: Callable[[Any], Any] = lambda units: units
) -> Verification:
    """Recompute all scores of a run from its policies and answers.

    Nothing is recomputed if a unit can be refused without it.

    Raises:
        SuiteError: the folder holds no run.
    """
    config = store.read_config(folder)
    task, arena, cases = task_of_run(config, given.game, given.beacon)
    units = [(number, seed) for number in range(len(cases)) for seed in range(config.seeds)]
    summary, refused = None, []

    def read(number: int, seed: int) -> store.Entry:
        if config.game.hash != arena.game.hash:
            raise SuiteError(f"played on game {config.game.hash[:12]}; this is {arena.game.hash[:12]}")
        entry = store.read_unit(folder, number, cases[number], seed)
        if other := sorted({*entry.policies} - {*task.roles} | {*entry.answers} - {*task.answers}):
            what = "policies or answers that the task does not have, such as"
            raise SuiteError(f"the entry has {len(other)} {what} {printable(other[0][:40])}")
        return entry

    def recompute(number: int, seed: int) -> None:
        entry, case = read(number, seed), cases[number]
        fingerprint = task.fingerprint(arena, case, seed)
        if entry.fingerprint != fingerprint:
            raise SuiteError(f"the case has fingerprint {entry.fingerprint[:12]}; expected {fingerprint[:12]}")
        outcome = store.read_outcome(folder, entry, arena.game)
        _compare(entry.scores, task.score(arena, case, seed, outcome))
        _compare(entry.parts, task.parts(arena, case, outcome))

    for check in (read, recompute):
        for number, seed in progress(units):
            try:
                check(number, seed)
            except ShuttleError as error:
                refused.append(Refusal(case=cases[number].name, seed=seed, reason=str(error)))
        if refused:
            break
    else:
        summary = summarise(folder, given.beacon, given.game)
    return Verification(units=len(units), refused=refused, summary=summary)


def _compare(stored: Mapping[str, float], found: Mapping[str, float]) -> None:
    if other := stored.keys() - found.keys():
        raise SuiteError(f"the entry has scores that the task does not have: {', '.join(sorted(map(printable, other)))}")
    for name, value in found.items():
        if not abs(value - stored.get(name, float("nan"))) <= TOLERANCE:
            raise SuiteError(f"{name} is {value:.9f}, not {stored.get(name)}")
