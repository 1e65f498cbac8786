"""Checks data from end to end and tells everything that is wrong, not only the first thing."""

import collections
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pooch

from shuttle_marl.data import upstream
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import violations
from shuttle_marl.data.shuttleset import list_matches, read_game
from shuttle_marl.data.strict_csv import DataError, Problem
from shuttle_marl.data.table import Account, clean_matches, load_account, read_parquet
from shuttle_marl.data.upstream import SPLITS, Split, split_of

_ADVICE: Final = (
    "`python -m shuttle_marl.data download` fetches them, and matches of your own become a Parquet file with "
    "`python -m shuttle_marl.data import`"
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Report:
    """Findings of a check.

    Attributes:
        problems: everything that is wrong; empty if all is well.
        notes: what is worth knowing but not wrong.
        splits: of each split, how many of its files are there and unaltered, and how many there should be; empty for a
            table.
        account: the account of the strokes, where they can be read.
    """

    problems: tuple[Problem, ...]
    notes: tuple[str, ...]
    splits: dict[Split, tuple[int, int]]
    account: Account | None


def validate(path: Path, splits: Sequence[Split] = SPLITS, columns: Path | None = None) -> Report:
    """Check a folder with the raw files, a Parquet file made by ``convert`` or ``import``, or a CSV file of one's own.

    Args:
        path: folder or file.
        splits: only the files of these splits must be there.
        columns: the map of the columns of a CSV file.
    """
    try:
        if columns is not None:
            return Report(problems=(), notes=(), splits={}, account=import_matches(path, columns)[0].account)
        if path.is_dir() and not any((path / source).is_dir() for source in upstream.SOURCES.values()):
            nothing = Problem(path, f"holds none of the published data sets ({', '.join(upstream.SOURCES)}); {_ADVICE}")
            return Report(problems=(nothing,), notes=(), splits=_compare(path, ())[0], account=None)
        return _validate_folder(path, splits) if path.is_dir() else _validate_table(path)
    except DataError as error:
        return Report(problems=error.problems, notes=(), splits={}, account=None)


def _validate_table(path: Path) -> Report:
    strokes = read_parquet(path)
    account = load_account(path)
    problems = [Problem(path, str(violation)) for violation in violations(strokes)]
    rallies = strokes.group_by(["match", "game", "rally"]).aggregate([]).num_rows
    for name, told, found in (
        ("strokes", account.strokes_kept, strokes.num_rows),
        ("rallies", account.rallies_kept, rallies),
        ("matches", account.matches, len(strokes["match"].unique())),
    ):
        if told != found:
            problems.append(Problem(path, f"the account tells of {told} {name}, the table holds {found}"))
    if account.strokes_kept + sum(account.dropped.values()) != account.strokes:
        problems.append(Problem(path, "the account does not add up: strokes kept and dropped are not all strokes"))
    return Report(problems=tuple(problems), notes=(), splits={}, account=account)


def _validate_folder(root: Path, splits: Sequence[Split]) -> Report:
    counts, problems = _compare(root, splits)
    notes: list[str] = []
    compared = len(problems)
    matches = _read_all(root, problems, notes)
    readable = matches and len(problems) == compared
    return Report(
        problems=tuple(problems),
        notes=tuple(notes),
        splits=counts,
        account=clean_matches(root).account if readable else None,
    )


def _compare(root: Path, splits: Sequence[Split]) -> tuple[dict[Split, tuple[int, int]], list[Problem]]:
    """Compare the files with the manifest: files whole and files listed by split, and what is missing or altered."""
    whole: collections.Counter[Split] = collections.Counter()
    listed: collections.Counter[Split] = collections.Counter()
    missing: dict[tuple[Path, Split | None], list[str]] = {}
    problems: list[Problem] = []
    for name, digest in upstream.manifest().items():
        match = upstream.match_of(name)
        split = None if match is None else split_of(match)
        file = root / name
        if split is not None:
            listed[split] += 1
        if not file.is_file():
            missing.setdefault((file.parent, split), []).append(file.name)
        elif (got := pooch.file_hash(str(file))) != digest:
            problems.append(Problem(file, f"altered: SHA-256 is {got}, expected {digest}; delete it and download it again"))
        elif split is not None:
            whole[split] += 1
    for (folder, split), names in missing.items():
        if split is None or split in splits:
            of_split = "" if split is None else f" ({split} split)"
            advice = "get them with `python -m shuttle_marl.data download`"
            problems.append(Problem(folder, f"missing {', '.join(names)}{of_split}; {advice}"))
    return {split: (whole[split], listed[split]) for split in SPLITS}, problems


def _read_all(root: Path, problems: list[Problem], notes: list[str]) -> int:
    """Read every game strictly; add problems, and as notes those of published files, which no one can fix.

    Returns:
        Number of matches that are there.
    """
    try:
        matches = list_matches(root, problems)
    except DataError as error:
        problems.extend(error.problems)
        return 0
    present = [match for match in matches if match.present]
    for match in present:
        try:
            for path in match.games():
                found: list[Problem] = []
                read_game(match, path, found)
                if found and upstream.is_published(path.read_bytes()):
                    notes.extend(f"{problem} (so it was published: the row is dropped)" for problem in found)
                else:
                    problems.extend(found)
        except DataError as error:
            problems.extend(error.problems)
    listed = {match.name for match in matches}
    for source in upstream.SOURCES.values():
        strangers = sorted(child for child in (root / source).glob("*") if child.is_dir() and child.name not in listed)
        notes.extend(f"{child}: not in match.csv, so it is not read" for child in strangers)
    return len(present)
