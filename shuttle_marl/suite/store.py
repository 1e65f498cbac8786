"""The folder of a run, which is also a submission.

- ``config.json``: task, method, split, seeds, and the game;
- ``card.json``: what the author says about the method, see :class:`Card`; edited by hand, never scored;
- ``entries/CASE-SEED.json``: one unit: fingerprint of the case, hashes of the policies, answers, scores, curve, seconds; with a
  checksum;
- ``policies/HASH.zst``: one table of a policy, compressed; HASH is the SHA-256 of its numbers;
- ``work/FINGERPRINT-SEED/``: files of the method, which nothing reads;
- ``results.json``: aggregates, which nothing reads.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec

from shuttle_marl.base import runs
from shuttle_marl.base.files import MAX_JSON, FileReadError, Sha256, StoredCount, T, read_json, replace_file, replace_sealed
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.computed import StoredPolicies, policy_file
from shuttle_marl.suite.options import Access, Kind, Split, SuiteError
from shuttle_marl.suite.task import Case, Outcome

ENTRIES: Final = "entries"
POLICIES: Final = "policies"
CARD: Final = "card.json"
RESULTS: Final = "results.json"
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]
"""A name in a file of a stranger."""
Author = Annotated[str, msgspec.Meta(pattern=r"[^\W\d_]", max_length=1000)]
"""A name with at least one letter."""
Figure = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
"""A score in a file of a stranger; neither infinite nor NaN."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Content of ``config.json``: everything that decides the results.

    Attributes:
        seeds: seeds from 0.
        model: name or folder of the model of the game.
        game: hash of its tables.
    """

    task: Name
    method: Name
    split: Split
    quick: bool
    budget: StoredCount | None = None
    seeds: Annotated[int, msgspec.Meta(ge=1, le=100)]
    model: Name
    game: Sha256


@dataclasses.dataclass(frozen=True, kw_only=True)
class Card:
    """Content of ``card.json``.

    Attributes:
        author: whose row it is; boards refuse a run without one.
        tuning_strokes: strokes or runs that were used for tuning; None: not stated.
        access: what it reads; None: not stated.
    """

    method: Name | None = None
    author: Author | None = None
    paper: Name | None = None
    tuning_strokes: StoredCount | Name | None = None
    kind: Kind = "method"
    access: Access | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Entry:
    """Content of a file in ``entries``.

    Attributes:
        fingerprint: of the case, see :meth:`shuttle_marl.suite.task.Task.fingerprint`.
        answers, strokes, curve: see :class:`shuttle_marl.suite.task.Outcome`.
        seconds: time of the method, without scoring.
    """

    case: Name
    seed: StoredCount
    fingerprint: Sha256
    policies: Mapping[str, Sha256]
    answers: Mapping[str, Any]
    scores: Annotated[Mapping[str, Figure], msgspec.Meta(max_length=16)]
    seconds: Annotated[float, msgspec.Meta(ge=0, le=1e9)]
    strokes: StoredCount | None = None
    curve: Annotated[Sequence[tuple[StoredCount, Figure]], msgspec.Meta(max_length=10_000)] = ()


def read(path: Path, kind: type[T], advice: str = "", *, sealed: bool = False, limit: int = MAX_JSON) -> T:
    """Read a JSON file, see :func:`shuttle_marl.base.files.read_json`.

    Raises:
        SuiteError: it is missing, damaged, or was changed.
    """
    try:
        return read_json(path, kind, sealed=sealed, limit=limit)
    except FileReadError as error:
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
            replace_file(target, content)
    replace_sealed(path, dataclasses.asdict(entry))


def read_entry(path: Path) -> Entry:
    """Read a unit."""
    return read(path, Entry, "; `suite run --resume` plays missing units", sealed=True, limit=1 << 20)


def read_outcome(folder: Path, entry: Entry, game: Game) -> Outcome:
    """The outcome of a unit, with its policies; each is read once.

    Raises:
        PolicyError: a policy is missing, damaged, or of another game.
    """
    stored = StoredPolicies(folder / POLICIES, game)
    loaded = {digest: stored.read(digest) for digest in set(entry.policies.values())}
    policies = {role: loaded[digest] for role, digest in entry.policies.items()}
    return Outcome(policies=policies, answers=entry.answers, strokes=entry.strokes, curve=entry.curve)


def write_card(folder: Path, card: Card) -> None:
    """Write the card of a run, unless its author has written one."""
    if not (folder / CARD).exists():
        runs.write_json(folder / CARD, dataclasses.asdict(card))


def read_card(folder: Path) -> Card:
    """The card of a run; an empty one if there is none."""
    return read(folder / CARD, Card) if (folder / CARD).exists() else Card()


def read_unit(folder: Path, number: int, case: Case, seed: int) -> Entry:
    """The unit of a case, with what can be checked without computing anything.

    Raises:
        SuiteError: it is missing, damaged, of another case or seed, or used more than its budget.
    """
    path = entry_path(folder, number, seed)
    entry = read_entry(path)
    if (entry.case, entry.seed) != (case.name, seed):
        raise SuiteError(f"{path}: is of case {entry.case!r} and seed {entry.seed}; expected {case.name!r} and {seed}")
    return checked(entry, case)


def checked(entry: Entry, case: Case) -> Entry:
    """The entry, if it can be read again and used no more than the budget of its case.

    Raises:
        SuiteError: a number is out of range, there are too many, or it used more.
    """
    try:
        entry = msgspec.convert(dataclasses.asdict(entry), Entry)
    except msgspec.ValidationError as error:
        raise SuiteError(f"the method returned something that cannot be stored: {error}") from error
    if case.budget and (most := max(entry.strokes or 0, *(used for used, _ in entry.curve), 0)) > case.budget:
        raise SuiteError(f"used {most:,} strokes, more than the budget of {case.budget:,}")
    return entry
