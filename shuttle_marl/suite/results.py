"""Tasks by name, and runs: the folder, aggregates, and verification, which recomputes scores from stored policies and answers.

- ``config.json``: task, method, split, seeds, and the game; ``card.json``: what the author says, edited by hand, never scored;
- ``entries/CASE-SEED.json``: one unit, with a checksum; ``policies/HASH.zst``: one table of a policy by the hash of its numbers;
- ``work/FINGERPRINT-SEED/``: files of the method, and ``results.json``: aggregates, neither of which is read.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, NotRequired, TypedDict

import msgspec
import numpy as np

from shuttle_marl.base import cache, files, runs
from shuttle_marl.base.errors import ShuttleError, did_you_mean, printable
from shuttle_marl.base.intervals import RESAMPLES, trim_mean
from shuttle_marl.base.table_files import write_parquet
from shuttle_marl.game.shipped import RECOVERY, drawn_game, is_shipped, resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.computed import StoredPolicies, policy_file
from shuttle_marl.recording.logs import write_minari
from shuttle_marl.suite.adapt import Adapt
from shuttle_marl.suite.exploit import Equilibrium, Exploit, ExploitEntrance
from shuttle_marl.suite.method import baseline_of
from shuttle_marl.suite.offline import OPPONENT, Evaluate, LogTask, Offline, log_of_unit
from shuttle_marl.suite.options import ACCESS, Access, Kind, Split, SuiteError
from shuttle_marl.suite.population import rng_of
from shuttle_marl.suite.task import Arena, Case, Outcome, Task

TASKS: Final[dict[str, Task]] = {task.name: task() for task in (Exploit, ExploitEntrance, Adapt, Evaluate, Offline, Equilibrium)}


def find_task(name: str) -> Task:
    """A task by name. Raises SuiteError: there is no such task."""
    if name not in TASKS:
        raise SuiteError(f"no task {name!r}{did_you_mean(name, TASKS, 0.4)}; there are: {', '.join(TASKS)}")
    return TASKS[name]


@functools.lru_cache(maxsize=4)
def arena_of(
    task: Task, model: str, split: Split, *, quick: bool = False, budget: int | None = None, seed: str | None = None
) -> Arena:
    """The game and the split of a task. Raises SuiteError: a round without a seed; GameError: the model does not exist."""
    if split == "round" and not seed:
        raise SuiteError("--split round: its games are drawn from a seed that no method knows; name it with --seed")
    variant = "-".join(filter(None, (task.variants.get(split), RECOVERY * task.recovery)))
    name = f"{model}:{variant}" if variant else model
    game, base = resolve_game(name), resolve_game(name).hash
    if sigma := task.drawn.get(split):
        game = drawn_game(game, rng_of("drawn game", split, seed, "game"), sigma)
    return Arena(game=game, model=name, base=base, split=split, quick=quick, budget=budget, seed=seed)


def write_data(
    task: str, out: Path, split: Split, model: str, seeds: int | None, *, quick: bool = False, minari: bool = False
) -> dict[str, str]:
    """Write the logs of a task as Parquet files or Minari data sets.

    Returns:
        SHA-256 of the content of each log by its name.

    Raises:
        SuiteError: the task has no logs.
    """
    found = find_task(task)
    if not isinstance(found, LogTask):
        raise SuiteError(f"{task} has no logs; offline-v1 and evaluate-v1 have")
    if seeds is not None and seeds < 1:
        raise SuiteError(f"--seeds {seeds}: expected 1 or more")
    arena, hashes = arena_of(found, model, split, quick=quick), {}
    for case in found.cases(arena):
        for seed in range(seeds or found.seeds):
            log = log_of_unit(arena, case, seed)
            fresh = "-fresh" if case.options.get("log") == "fresh" else ""
            name = f"{split}-{case.options['behaviour']}-{case.budget}{fresh}".translate(str.maketrans(":*+", "-x-"))
            if minari:
                name = f"shuttle_marl/{name}-v{seed}"
                write_minari(log.transitions, name, out, arena.model, OPPONENT)
            else:
                name = f"{name}-{seed}.parquet"
                write_parquet(out / name, log.table())
            hashes[name] = log.hash
    return hashes


ENTRIES: Final = "entries"
POLICIES: Final = "policies"
CARD: Final = "card.json"
RESULTS: Final = "results.json"
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]  # a name in a file of a stranger
Author = Annotated[str, msgspec.Meta(pattern=r"^[^/]*[^\W\d_][^/]*$", max_length=1000)]  # with a letter, and without /
Figure = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]  # a score in a file of a stranger; neither infinite nor NaN


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Content of ``config.json``: everything that decides the results."""

    task: Name
    method: Name
    split: Split
    quick: bool
    budget: files.StoredCount | None = None
    seeds: Annotated[int, msgspec.Meta(ge=1, le=100)]  # seeds from 0
    model: Name  # name or folder of the model of the game
    game: files.Sha256  # hash of its tables


@dataclasses.dataclass(frozen=True, kw_only=True)
class Card:
    """Content of ``card.json``."""

    author: Author | None = None  # whose row it is; boards refuse a run without one
    tuning_strokes: files.StoredCount | Name | None = None  # strokes or runs that were used for tuning; None: not stated
    access: Access | None = None  # what it reads; None: not stated


@dataclasses.dataclass(frozen=True, kw_only=True)
class Entry:
    """Content of a file in ``entries``.

    Attributes:
        answers, strokes: see :class:`shuttle_marl.suite.task.Outcome`.
    """

    case: Name
    seed: files.StoredCount
    fingerprint: files.Sha256  # of the case, see `Task.fingerprint`
    policies: Mapping[str, files.Sha256]
    answers: Mapping[str, Any]
    scores: Annotated[Mapping[str, Figure], msgspec.Meta(max_length=16)]
    seconds: Annotated[float, msgspec.Meta(ge=0, le=1e9)]  # time of the method, without scoring
    strokes: files.StoredCount | None = None


def read(path: Path, kind: type[files.T], advice: str = "", *, sealed: bool = False, limit: int = files.MAX_JSON) -> files.T:
    """Read a JSON file as :func:`shuttle_marl.base.files.read_json` does. Raises SuiteError: missing, damaged, or changed."""
    try:
        return files.read_json(path, kind, sealed=sealed, limit=limit)
    except files.FileReadError as error:
        raise SuiteError(f"{path}: {error}{advice}") from error


def read_config(folder: Path) -> RunConfig:
    """Configuration of a run."""
    return read(folder / runs.CONFIG, RunConfig, "; no run of the suite is there: `suite run TASK` writes one")


def entry_path(folder: Path, case: int, seed: int) -> Path:
    """File of a unit; cases are counted from 0."""
    return folder / ENTRIES / f"{case:03d}-{seed}.json"


def write_entry(folder: Path, path: Path, entry: Entry, policies: Mapping[str, bytes]) -> None:
    """Write the packed policies of a unit by their hashes, and then its entry."""
    for digest, content in policies.items():
        if not (target := policy_file(folder / POLICIES, digest)).exists():
            files.replace_file(target, content)
    files.replace_sealed(path, dataclasses.asdict(entry))


def read_entry(path: Path) -> Entry:
    """Read a unit."""
    return read(path, Entry, "; `suite run --resume` plays missing units", sealed=True, limit=1 << 20)


def read_outcome(folder: Path, entry: Entry, game: Game) -> Outcome:
    """The outcome of a unit; each policy is read once. Raises PolicyError: one is missing, damaged, or of another game."""
    stored = StoredPolicies(folder / POLICIES, game)
    loaded = {digest: stored.read(digest) for digest in set(entry.policies.values())}
    policies = {role: loaded[digest] for role, digest in entry.policies.items()}
    return Outcome(policies=policies, answers=entry.answers, strokes=entry.strokes)


def write_card(folder: Path, card: Card) -> None:
    """Write the card of a run, unless its author has written one."""
    if not (folder / CARD).exists():
        runs.write_json(folder / CARD, dataclasses.asdict(card))


def read_card(folder: Path) -> Card:
    """The card of a run; an empty one if there is none."""
    return read(folder / CARD, Card) if (folder / CARD).exists() else Card()


def read_unit(folder: Path, number: int, case: Case, seed: int) -> Entry:
    """The unit of a case, as far as nothing is computed. Raises SuiteError: missing, damaged, of another unit, or over budget."""
    path = entry_path(folder, number, seed)
    entry = read_entry(path)
    if (entry.case, entry.seed) != (case.name, seed):
        raise SuiteError(f"{path}: is of case {entry.case!r} and seed {entry.seed}; expected {case.name!r} and {seed}")
    return checked(entry, case)


def checked(entry: Entry, case: Case) -> Entry:
    """The entry, within its bounds. Raises SuiteError: a number out of range, too many, or more strokes than the budget."""
    try:
        entry = msgspec.convert(dataclasses.asdict(entry), Entry)
    except msgspec.ValidationError as error:
        raise SuiteError(f"the method returned something that cannot be stored: {error}") from error
    if case.budget and (entry.strokes or 0) > case.budget:
        raise SuiteError(f"used {entry.strokes:,} strokes, more than the budget of {case.budget:,}")
    return entry


DIGITS: Final = 6  # decimal places in which scores differ; verification allows less
TOLERANCE: Final = 1e-7  # largest difference between a recomputed score and the stored one, in the unit of the score
NOT_VERIFIED: Final = ("names", "strokes", "tuning", "seconds", "access", "independent seeds", "what made the policies")
Units = dict[str, dict[str, list[float]]]  # figures by stratum, case and seed


class Bounds(TypedDict):
    """A figure and its 95 % interval, if it has one."""

    value: float
    low: float | None
    high: float | None


class Row(TypedDict):
    """Aggregates of a run: a row of a board.

    Attributes:
        cases: hash of the fingerprints of the units of the first seed, from which the others follow; rows of a board have the
            same ones, whether they have one seed, as references, or several.
        metric, score, low, high: the main score with its interval.
        seconds, strokes: sums over all units, as they are declared.
    """

    task: str
    author: str  # from the card; empty in the rows of this package
    method: str
    cases: str
    split: Split
    quick: bool
    budget: int | None
    seeds: int
    game: str
    kind: Kind
    access: Access  # what the card says that the method reads
    tuning_strokes: int | str | None
    metric: str
    score: float
    low: float | None
    high: float | None
    worst: float  # the main score of the worst case
    seconds: float
    strokes: int
    scores: dict[str, Bounds]
    units: Units
    remarks: list[str]  # what a reader should know
    rank: NotRequired[int]  # among the methods of a board of this access; equal scores share one
    behind: NotRequired[Bounds]  # paired difference to the best method of the board
    commit: NotRequired[str | None]  # of this repository, for the rows of its results; None outside of git


def task_of_run(config: RunConfig, model: str | None = None, seed: str | None = None) -> tuple[Task, Arena, list[Case]]:
    """Task, game and cases of a run whose folder may be a stranger's.

    Args:
        model: name or folder of the game that the user named; None: the shipped model of this name. A folder that the
            configuration names is never opened.
        seed: of a round.

    Raises:
        SuiteError: the configuration names a model that is not shipped, or cases of different budgets, which are never pooled.
    """
    task = find_task(config.task)
    if model is None and not is_shipped(config.model):
        raise SuiteError(f"the run names the model {printable(config.model)!r}, which is not shipped; name it with --game")
    arena = arena_of(task, model or config.model, config.split, quick=config.quick, budget=config.budget, seed=seed)
    cases = task.cases(arena)
    if config.budget is None and len({case.budget for case in cases}) > 1:
        raise SuiteError("the run names no budget; budgets are never pooled")
    return task, arena, cases


def summarise(folder: Path, game: str | None = None, seed: str | None = None) -> Row:
    """Aggregates of a run, from its entries as they are stored; :func:`verify_run` recomputes those.

    Args:
        game: model of the game; None: the shipped model that the run names.
        seed: of a round.

    Raises:
        SuiteError: a unit is missing or damaged.
    """
    config, card = read_config(folder), read_card(folder)
    task, arena, cases = task_of_run(config, game, seed)
    entries = [read_unit(folder, place, case, number) for place, case in enumerate(cases) for number in range(config.seeds)]
    return _row(config, card, task, arena, cases, entries)


def _row(config: RunConfig, card: Card, task: Task, arena: Arena, cases: Sequence[Case], entries: Sequence[Entry]) -> Row:
    """Aggregates of the units of all cases and seeds."""
    names = entries[0].scores.keys()
    if task.metric not in names or any(entry.scores.keys() != names for entry in entries):
        raise SuiteError(f"the units have different scores, or none named {task.metric}; `suite verify` says more")
    counting = [case for case in cases if case.counts]
    scores = {name: aggregate(units_of(counting, entries, name)) for name in names}
    by_unit = units_of(counting, entries, task.metric)
    strata = units_of(cases, entries, task.metric)
    scores |= {f"{task.metric} {name}": aggregate({name: those}) for name, those in strata.items() if len(those) > 1}
    main, baseline = scores[task.metric], baseline_of(task.name, config.method)
    # What a row is, the package says of its own alone.
    kind: Kind = "method" if card.author or baseline is None else baseline.kind
    middles = [middle for parts in by_unit.values() for middle in _middles(parts)]
    return {
        "task": task.name,
        "author": card.author or "",
        "method": config.method,
        "cases": files.content_hash("".join(entry.fingerprint for entry in entries if entry.seed == 0).encode()),
        "split": config.split,
        "quick": config.quick,
        "budget": config.budget,
        "seeds": config.seeds,
        "game": arena.base,
        "kind": kind,
        "access": card.access or ACCESS[-1],
        "tuning_strokes": card.tuning_strokes,
        "metric": task.metric,
        "score": main["value"],
        "low": main["low"],
        "high": main["high"],
        "worst": min(middles) if task.higher_is_better else max(middles),
        "seconds": float(sum(entry.seconds for entry in entries)),
        "strokes": sum(entry.strokes or 0 for entry in entries),
        "scores": scores,
        "units": by_unit,
        "remarks": ["a quick run"] * config.quick + ([] if kind == "reference" else _remarks(task, config, by_unit, entries)),
    }


def _remarks(task: Task, config: RunConfig, scores: Units, entries: Sequence[Entry]) -> list[str]:
    """What a reader should know of what is not a reference."""
    found = [f"{config.seeds} of {task.seeds} seeds"] if config.seeds < task.seeds else []
    different = min(len(distinct(seeds)) for cases in scores.values() for seeds in cases.values())
    if different < config.seeds:
        found.append(f"{different} of {config.seeds} seeds differ")
    if task.budgets and any(entry.strokes is None for entry in entries):
        return [*found, "strokes not declared"]
    used = max(entry.strokes or 0 for entry in entries)
    smaller = [budget for budget in (0, *task.budgets) if used <= budget < (config.budget or 0)]
    return found + [f"fits the budget of {budget:,} strokes" for budget in smaller[:1]]


def distinct(scores: Sequence[float]) -> set[float]:
    """Different scores, to the digits in which scores differ."""
    return {round(score, DIGITS) for score in scores}


def units_of(cases: Sequence[Case], entries: Sequence[Entry], name: str) -> Units:
    """Figures of a score by stratum, case and seed."""
    found: Units = {}
    for case in cases:
        figures = [entry.scores[name] for entry in entries if entry.case == case.name]
        found.setdefault(case.stratum or case.name, {})[case.name] = figures
    return found


def aggregate(units: Units) -> Bounds:
    """The mean over cases of the interquartile mean over seeds, with its 95 % interval.

    The interval is that of rliable (Agarwal et al., NeurIPS 2021): percentiles of a bootstrap stratified by case, which draws the
    seeds of a case again, or the cases of a stratum, which are exchangeable. A single unit has none.
    """
    rng, means, known = np.random.default_rng(0), [], True
    for cases in units.values():
        sample = np.array(_middles(cases) if len(cases) > 1 else next(iter(cases.values())))
        known &= len(sample) > 1
        drawn = np.vstack([sample, sample[rng.integers(len(sample), size=(RESAMPLES, len(sample)))]])
        means.append(len(cases) * (drawn.mean(axis=1) if len(cases) > 1 else trim_mean(drawn, axis=1)))
    value, *resampled = np.sum(means, axis=0) / sum(map(len, units.values()))
    low, high = np.percentile(resampled, (2.5, 97.5)).tolist() if known else (None, None)
    return {"value": float(value), "low": low, "high": high}


def _middles(cases: Mapping[str, Sequence[float]]) -> list[float]:
    """The interquartile mean over seeds of each case."""
    return [float(trim_mean(seeds)) for seeds in cases.values()]


def difference(ours: Row, theirs: Row) -> Bounds:
    """Paired difference of the main score, positive if the first run is better. Raises SuiteError: other task, cases or seeds."""
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
    """Verification of a run."""

    units: int
    refused: list[Refusal]
    summary: Row | None  # of the run; None if a unit is refused


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
    config, card = read_config(folder), read_card(folder)
    task, arena, cases = task_of_run(config, game, seed)
    units = list(itertools.product(range(len(cases)), range(config.seeds)))
    # Files are read once: they may change meanwhile.
    entries: dict[tuple[int, int], Entry] = {}
    summary, refused = None, []

    def stored(place: int, number: int) -> Entry:
        if config.game != arena.game.hash:
            raise SuiteError(f"played on game {config.game[:12]}; this is {arena.game.hash[:12]}")
        entry = read_unit(folder, place, cases[place], number)
        if other := sorted({*entry.policies} - {*task.roles} | {*entry.answers} - {*task.answers}):
            what = "policies or answers that the task does not have, such as"
            raise SuiteError(f"the entry has {len(other)} {what} {printable(other[0][:40])}")
        return entry

    def recomputed(place: int, number: int) -> Entry:
        entry, case = entries[place, number], cases[place]
        fingerprint = task.fingerprint(arena, case, number)
        if entry.fingerprint != fingerprint:
            raise SuiteError(f"the case has fingerprint {entry.fingerprint[:12]}; expected {fingerprint[:12]}")
        scores = task.score(arena, case, number, read_outcome(folder, entry, arena.game))
        _compare(entry.scores, scores)
        return dataclasses.replace(entry, scores=scores)

    with cache.forgotten():
        for check in (stored, recomputed):
            for place, number in progress(units):
                try:
                    entries[place, number] = check(place, number)
                except ShuttleError as error:
                    refused.append(Refusal(case=cases[place].name, seed=number, reason=str(error)))
            if refused:
                break
        else:
            summary = _row(config, card, task, arena, cases, list(entries.values()))
    return Verification(units=len(units), refused=refused, summary=summary)


def _compare(stored: Mapping[str, float], found: Mapping[str, float]) -> None:
    if other := stored.keys() - found.keys():
        raise SuiteError(f"the entry has scores that the task does not have: {', '.join(sorted(map(printable, other)))}")
    for name, value in found.items():
        if not abs(value - stored.get(name, float("nan"))) <= TOLERANCE:
            raise SuiteError(f"{name} is {value:.9f}, not {stored.get(name)}")
