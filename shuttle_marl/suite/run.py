"""Runs of methods on tasks, also of code that was committed to for a round.

The units of a run are played in parallel and can be resumed; each is stored and scored. In a round, code is committed to by its
hash, then a public beacon draws games, opponents and luck, and anybody reruns the code:

1. Authors publish commitments (:func:`commit`), for instance in a repository, whose history shows their dates.
2. After a round of the beacon that was announced before, :func:`draw_round` writes the commitments and the randomness to a file.
3. Authors publish their code, and anybody runs it behind a boundary (:func:`rerun`). Who reruns looks the randomness up at the
   beacon, so that an invented one is found.
"""

import dataclasses
import datetime as dt
import functools
import itertools
import json
import re
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

from shuttle_marl.base import runs
from shuttle_marl.base.cluster import check_processes, in_processes, open_cluster
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import Sha256, content_hash, replace_sealed
from shuttle_marl.suite import apart, store
from shuttle_marl.suite.method import Method, baseline_of, find, sources
from shuttle_marl.suite.options import RerunOptions, Resources, SuiteError, SuiteRun
from shuttle_marl.suite.population import checked_beacon
from shuttle_marl.suite.registry import arena_of, find_task, task_of_run
from shuttle_marl.suite.remote import find_boundary, play_apart
from shuttle_marl.suite.results import summarise
from shuttle_marl.suite.store import Card, Entry, RunConfig

BEACON: Final = "https://api.drand.sh/52db9ba70e0cc0f6eaf7803dd07447a1f5477735fd3f661792ba94600c84e971/public"
"""Public beacon of randomness: the chain ``quicknet`` of drand (https://drand.love)."""
_GENESIS: Final = 1_692_803_367
_PERIOD: Final = 3
"""Time of its first round, in seconds since 1970, and between rounds."""
_NAME: Final = "^[A-Za-z0-9][A-Za-z0-9 ._-]{0,39}\\Z"
"""Names of authors: letters that look like no others."""
_METHOD: Final = r"^[A-Za-z_][A-Za-z0-9_.]{0,79}:[A-Za-z_][A-Za-z0-9_.]{0,79}\Z"
_TIME: Final = "%Y-%m-%d %H:%M:%S"
_FILES: Final = 1000
_BYTES: Final = 1 << 30
_LOOKS: Final = str.maketrans("01i5", "olls")
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
    check_processes(1 if options.ray is not None else options.workers)
    fixed = dataclasses.asdict(config)
    with runs.open_run(options.out, words[:80], fixed, resume=options.resume, overwrite=options.overwrite) as run:
        folder = run.folder
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
    except ShuttleError as error:
        raise SuiteError(f"{config.method}, case {case.name}, seed {seed}: {error}") from error
    if not any(work.iterdir()):
        work.rmdir()
    return store.entry_path(folder, number, seed), entry, {p.hash: p.packed() for p in outcome.policies.values()}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Commitment:
    """Code that an author commits to.

    Attributes:
        date: in UTC, to the second, as the author says.
        beacon: round of the beacon that was announced; None: any.
        hash: SHA-256 of the task, the author, the method, the beacon and the files. It reveals nothing of the
            code and differs between authors, so nobody can commit to the code of others.
    """

    task: store.Name
    author: Annotated[str, msgspec.Meta(pattern=_NAME)]
    method: Annotated[str, msgspec.Meta(pattern=_METHOD)]
    date: Annotated[dt.datetime, msgspec.Meta(tz=True)]
    hash: Sha256
    beacon: Annotated[int, msgspec.Meta(ge=1, le=1 << 36)] | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Round:
    """Content of the file of a round, sealed.

    Attributes:
        beacon: number of the round of the beacon.
        randomness: what the beacon published, hexadecimal.
        commitments: oldest first.
    """

    beacon: Annotated[int, msgspec.Meta(ge=1, le=1 << 36)]
    randomness: Sha256
    commitments: Sequence[Commitment]

    def entry(self, task: str, author: str) -> Commitment:
        """The commitment of an author.

        Raises:
            SuiteError: there is none.
        """
        for each in self.commitments:
            if (each.task, each.author) == (task, author):
                return each
        there = ", ".join(sorted(each.author for each in self.commitments if each.task == task)) or "none"
        raise SuiteError(f"no entry of {author!r} for {task} in this round; there are: {there}")


def time_of(beacon: int) -> dt.datetime:
    """When a round of the beacon appears."""
    return dt.datetime.fromtimestamp(_GENESIS + _PERIOD * (beacon - 1), dt.UTC)


def commit(
    folder: Path, *, task: str, method: str, author: str, beacon: int | None = None, now: dt.datetime | None = None
) -> Commitment:
    """The commitment to the code in a folder.

    Args:
        folder: with everything that the method needs beside Python and installed libraries.
        method: ``MODULE:ATTRIBUTE``, in that folder.
        beacon: announced round of the beacon; the commitment then counts in no other one.
        now: date; None: that of the clock.

    Raises:
        SuiteError: there is no such task, a name is not allowed, or there is a link, no file, or too much.
    """
    if "round" not in find_task(task).splits:
        raise SuiteError(f"{task} has no rounds")
    date = (now or dt.datetime.now(dt.UTC)).replace(microsecond=0)
    if not (files := _files(folder)):
        raise SuiteError(f"{folder}: has no files")
    words = json.dumps([task, author, method, beacon, files])
    found = {"task": task, "author": author, "method": method, "date": date, "beacon": beacon}
    try:
        return msgspec.convert({**found, "hash": content_hash(words.encode())}, Commitment)
    except msgspec.ValidationError as error:
        raise SuiteError(f"no commitment: {error}") from error


def _files(folder: Path) -> dict[str, str]:
    """SHA-256 of each file of a folder by its path; hidden files and those of the interpreter are left out."""
    found: dict[str, str] = {}
    size = 0
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if any(part.startswith(".") or part == "__pycache__" for part in name.parts):
            continue
        if not name.as_posix().isprintable():
            raise SuiteError(f"{folder}: has the name {name.as_posix()!a}; commit to names that can be printed")
        if path.is_symlink() or not (path.is_dir() or path.is_file()):
            raise SuiteError(f"{path}: is a link or a device; commit to regular files")
        if path.is_file():
            size += path.stat().st_size
            if len(found) == _FILES or size > _BYTES:
                raise SuiteError(f"{folder}: more than {_FILES} files or {_BYTES:,} bytes")
            found[name.as_posix()] = content_hash(path.read_bytes())
    return found


def draw_round(commitments: Sequence[Path], *, beacon: int, randomness: str, now: dt.datetime | None = None) -> Round:
    """A round from files of commitments.

    Args:
        beacon: number of the round of the beacon, announced before.
        randomness: what it published, 64 hexadecimal digits.
        now: time; None: that of the clock.

    Raises:
        SuiteError: the beacon has not appeared yet, a commitment was made after it, or two are of one author.
    """
    if (drawn := time_of(beacon)) > (now or dt.datetime.now(dt.UTC)):
        raise SuiteError(f"round {beacon} of the beacon appears at {drawn:{_TIME}} UTC")
    found = sorted((store.read(path, Commitment, sealed=True) for path in commitments), key=lambda each: each.date)
    return _checked(Round(beacon=beacon, randomness=checked_beacon(randomness), commitments=found))


def _checked(found: Round) -> Round:
    """A round, which a stranger may have written, if its commitments are possible."""
    drawn, seen = time_of(found.beacon), dict[tuple[str, str], Commitment]()
    for each in found.commitments:
        find_task(each.task)
        if each.date >= drawn:
            raise SuiteError(f"{each.author}: committed at {each.date:{_TIME}}, not before the beacon of {drawn:{_TIME}}")
        if each.beacon not in (None, found.beacon):
            raise SuiteError(f"{each.author}: committed for round {each.beacon} of the beacon, not {found.beacon}")
        if (first := seen.setdefault((each.task, _plain(each.author)), each)) is not each:
            raise SuiteError(f"{each.author}: has the name of {first.author}, who committed first; one entry of an author")
    return found


def _plain(name: str) -> str:
    """A name without what cannot be told apart at a glance."""
    return re.sub("[^a-z0-9]", "", name.casefold().translate(_LOOKS)).replace("rn", "m").replace("vv", "w")


def write(path: Path, found: Commitment | Round) -> None:
    """Write a commitment or a round as a sealed file."""
    replace_sealed(path, msgspec.to_builtins(found))


def rerun(path: Path, folder: Path, asked: RerunOptions, resources: Resources, console: Console | None = None) -> Path:
    """Run committed code on a round, behind a boundary; returns the run folder.

    Args:
        path: file of the round.
        folder: code of the author.

    Raises:
        SuiteError: the round is impossible or has other randomness, the code is not that of the commitment, or there is no
            boundary here.
    """
    found = _checked(store.read(path, Round, sealed=True))
    if found.randomness != checked_beacon(asked.randomness):
        raise SuiteError(f"{path}: its randomness is not that of round {found.beacon} of the beacon, see {BEACON}/{found.beacon}")
    entry = found.entry(asked.task, asked.author)
    if resources.resume:
        raise SuiteError("a rerun cannot be resumed, because finished units in the folder may be forged; leave --resume out")
    with tempfile.TemporaryDirectory() as place:
        code = Path(place) / "code"
        files = _files(folder)
        for name in files:
            (code / "entry" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / name, code / "entry" / name)
        there = commit(code / "entry", task=entry.task, method=entry.method, author=entry.author, beacon=entry.beacon)
        if there.hash != entry.hash:
            raise SuiteError(f"{folder}: is not the code of the commitment of {entry.date:{_TIME}} UTC; a file differs")
        shutil.copyfile(apart.__file__, code / "apart.py")
        for each in (Path(place), code, *code.rglob("*")):
            each.chmod(0o755 if each.is_dir() else 0o644)
        boundary = find_boundary(code, asked.image, hidden=(path, *(folder / name for name in files)))
        committed = Committed(
            hash=entry.hash,
            method=functools.partial(play_apart, entry.method, code, boundary, found.randomness),
            card=Card(method=entry.method, authors=asked.author, access="samples"),
            rerun=store.Rerun(by=asked.by, boundary=boundary.name, round=content_hash(path.read_bytes())),
        )
        options = SuiteRun(
            **dataclasses.asdict(resources), task=asked.task, method=entry.method, split="round", beacon=found.randomness
        )
        return run_method(options, console, committed=committed)
