"""Stroke tables: cleaned from the raw files or read from Parquet, written with account and provenance, and validated."""

import collections
import dataclasses
import json
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from shuttle_marl import __version__
from shuttle_marl.base import table_files
from shuttle_marl.base.cache import Cache, key_of
from shuttle_marl.base.errors import command
from shuttle_marl.base.files import content_hash, hash_of, problem
from shuttle_marl.data import schema, upstream
from shuttle_marl.data.cleaning import clean_matches
from shuttle_marl.data.hands import telling_hands, unknown_hands, with_hands
from shuttle_marl.data.matches import absent, copies, with_rules
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import NAMES, OPTIONAL, STROKES, Account, Cleaned, DataError, Problem, violations
from shuttle_marl.data.shuttleset import list_matches, read_game
from shuttle_marl.data.upstream import SPLITS, Split, split_of
from shuttle_marl.game.scoring import RULES, RulesName

_CACHE: Final = Cache("strokes", 4)  # some MB each
_QUOTED: Final = re.compile(r"(?<!\w)'.*'|(?<!\w)\".*\"")
_OF_PANDAS: Final = "__index_level_"
_STORED: Final = schema.named(STROKES.empty_table()).schema
_ACCOUNT: Final = b"shuttle_marl.account"
_PROVENANCE: Final = b"shuttle_marl.provenance"


def read_matches(path: Path | str, columns: Path | str | None = None, rules: RulesName | None = None) -> pa.Table:
    """Read the strokes of matches: from a Parquet file, a CSV file, a file of another program, or a folder with the raw files,
    which are cleaned.

    Args:
        columns: column map of the file, see ``docs/own_data.md``; None: it needs none.
        rules: of the matches; None: those that the table carries, or else the scores tell.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`. What is strange about an imported file is a warning.

    Raises:
        DataError: missing or unreadable file or folder, another schema, or a score that the rules do not allow.
    """
    path = Path(path)
    raw = path.is_dir() and columns is None
    cleaned = None if raw else _cleaned(path, None if columns is None else Path(columns), rules)
    if cleaned is not None:  # an import follows the rules
        strokes, doubts = cleaned.strokes, cleaned.warnings
    else:
        strokes = _of_folder(path) if raw else load_counted(path)[0]
        twice = [] if _published(strokes) else copies(strokes)
        strokes, doubts = _by_rules(strokes, path, rules)
        doubts = (*twice, *doubts)
    for told in doubts:
        warnings.warn(told, stacklevel=2)
    return strokes


def _published(strokes: pa.Table) -> bool:
    """Whether a table is of published or simulated matches, which carry no rules."""
    return bool(strokes["rules"].null_count == len(strokes))


def _by_rules(strokes: pa.Table, path: Path, rules: RulesName | None = None) -> tuple[pa.Table, tuple[str, ...]]:
    """The strokes of a table by the rules given or carried, and what is doubtful about the rules."""
    return (strokes, ()) if _published(strokes) and rules is None else with_rules(strokes, path, rules)


def _of_folder(root: Path) -> pa.Table:
    """The cleaned strokes of the raw files in a folder, in the cache by their content."""
    try:
        files = [file for folder in upstream.SOURCES.values() for file in sorted((root / folder).rglob("*.csv"))]
        contents = [f"{file.relative_to(root)} {upstream.sha256_of(file)}" for file in files if file.is_file()]
    except OSError:  # which cleaning tells
        return clean_matches(root).strokes
    key = key_of("strokes", *contents, *upstream.manifest().values(), rooms=("base", "data"))
    if (kept := _CACHE.read([key]).get(key)) is not None:
        strokes = pa.ipc.open_stream(kept).read_all()
    else:
        with telling_hands(()):
            strokes = clean_matches(root).strokes
        _CACHE.store({key: _stream(strokes, pa.ipc.IpcWriteOptions(compression="zstd"))})
    return with_hands(strokes, root)[0]


def _lack(strokes: pa.Table, account: Account | None) -> str:
    """A sentence on the rows that a table lacks: by its account, or else by their numbers; empty if it lacks none."""
    if account is None:
        return absent(strokes)
    counted = Account.of(strokes)
    both = [(each.strokes_kept, each.rallies_kept) for each in (account, counted)]
    if both[0] == both[1] and counted.matches <= account.matches:  # all strokes of a match may have been dropped
        return ""
    told = " and the table ".join(f"{n:,} strokes in {rallies:,} rallies" for n, rallies in both)
    return f"the account has {told}: rows were taken out or added after it was written, and what is counted is of those there"


def load_counted(path: Path | str) -> tuple[pa.Table, Account]:
    """Strokes as :func:`read_matches` loads them, and their account; that of the rows where the file has none."""
    path = Path(path)
    if (cleaned := _cleaned(path)) is not None:
        return cleaned.strokes, cleaned.account
    strokes, account = _read(path)
    for violation in violations(strokes, of_order=True):  # the score is counted in the order of the rows
        raise DataError(path, f"{violation}; sort by game, rally and stroke in each match, or {_again()}")
    if told := _lack(strokes, account):
        warnings.warn(f"{path}: {told}", stacklevel=2)
    return strokes, account or Account.of(strokes)


def _cleaned(path: Path, columns: Path | None = None, rules: RulesName | None = None) -> Cleaned | None:
    """The strokes of a folder, or of a file to import: one with a map, or by its name and its first bytes no Parquet file."""
    if columns is not None:
        return import_matches(path, columns, rules)
    if path.is_dir():
        return clean_matches(path)
    if path.suffix.lower() == ".parquet" or not path.is_file():
        return None
    with path.open("rb") as file:
        return None if file.read(4) == b"PAR1" else import_matches(path, rules=rules)


def write_parquet(strokes: pa.Table, path: Path, *, account: Account, provenance: dict[str, Any], new: bool = False) -> None:
    """Write a stroke table (zstd, with checksums) atomically, or raise a FileWriteError. Equal arguments give equal bytes."""
    extra = {_ACCOUNT: json.dumps(account.as_json()).encode(), _PROVENANCE: json.dumps(provenance, ensure_ascii=False).encode()}
    table = schema.named(strokes.cast(STROKES).combine_chunks()).replace_schema_metadata({**STROKES.metadata, **extra})
    table_files.write_parquet(path, table, new=new, compression_level=9)


def _read(path: Path) -> tuple[pa.Table, Account | None]:
    content = _content(path)
    strokes, told = _conforming(path, content), (content.schema.metadata or {}).get(_ACCOUNT)
    try:
        return strokes, None if told is None else Account.from_json(json.loads(told))
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise DataError(path, f"the account of its strokes is damaged; {_again()}") from error


def _content(path: Path) -> pa.Table:
    try:
        return table_files.read_parquet(path)
    except FileNotFoundError as error:
        raise DataError(path, "no such file or folder; expected a folder with the data or a Parquet file") from error
    except MemoryError:
        raise
    except pa.ArrowException as error:
        raise DataError(path, f"no readable Parquet file ({error})") from error
    except (OSError, ValueError) as error:
        raise DataError(path, f"cannot be read ({problem(error)})") from error


def _again() -> str:
    return f"create it again with `{command('data', 'convert')}` or `{command('data', 'import')}`"


def _written_elsewhere(table: pa.Table) -> bool:
    return not {b"schema", b"version", _ACCOUNT} & (table.schema.metadata or {}).keys()


def _conforming(path: Path, table: pa.Table) -> pa.Table:
    """A table of a file in the schema of strokes; columns that it may lack are added. One that another program wrote, such as
    pandas, is cast to the schema and must satisfy its rules."""
    elsewhere, metadata, advice = _written_elsewhere(table), table.schema.metadata, _again()
    if elsewhere:
        table = table.select([name for name in table.column_names if not name.startswith(_OF_PANDAS)])
        advice = f"expected the columns of a table of `{command('data', 'import')}`, in its order, filtered or not"
        metadata = STROKES.metadata
    elif (version := metadata.get(b"version")) != (expected := STROKES.metadata[b"version"]):
        raise DataError(path, f"schema version {version!r}, expected {expected!r}; {advice}")
    names, columns = [name for name in STROKES.names if name in table.column_names or name not in OPTIONAL], []
    if missing := [name for name in names if name not in table.column_names]:
        raise DataError(path, f"column {missing[0]!r} is missing; {advice}")
    if table.column_names != names:
        expected_names = ", ".join(STROKES.names)
        raise DataError(path, f"columns {', '.join(table.column_names)}; expected {expected_names} in this order; {advice}")
    for field in STROKES:
        column = table[field.name] if field.name in names else pa.nulls(len(table), field.type)
        if field.name in names and not elsewhere:
            forms = table.schema.field(field.name), _STORED.field(field.name), field
            told, wanted, codes = (f"{each.type}{'' if each.nullable else ' not null'}" for each in forms)
            if told not in (wanted, codes):
                raise DataError(path, f"column {field.name!r} is {told}, expected {wanted}; {advice}")
        try:
            columns.append(schema.unnamed(field.name, column) if field.name in NAMES else column.cast(field.type))
        except pa.ArrowException as error:
            raise DataError(path, f"column {field.name!r} is no {field.type} ({error}); {advice}") from error
        if field.name == "rules" and (odd := {*columns[-1].unique().to_pylist()} - {None, *RULES}):
            raise DataError(path, f"rules {min(map(str, odd))!r:.60}; expected one of {', '.join(RULES)}")
        if column.null_count and not field.nullable:
            raise DataError(path, f"column {field.name!r} lacks {column.null_count} values; {advice}")
    strokes = pa.table(columns, schema=STROKES.with_metadata(metadata))
    for violation in violations(strokes) if elsewhere else ():
        raise DataError(path, str(violation))
    return with_hands(strokes, path)[0]


def provenance_of(root: Path, cleaned: Cleaned) -> dict[str, Any]:
    """Provenance of a cleaned table as a JSON object; equal inputs give equal values."""
    hashes = ((path.relative_to(root).as_posix(), upstream.sha256_of(path)) for path in cleaned.files)
    return {
        "repository": upstream.REPOSITORY,
        "commit": upstream.COMMIT,
        "files": len(cleaned.files),
        "sha256": hash_of(f"{name}\n".encode() + bytes.fromhex(known) for name, known in hashes),
        "cleaned_by": f"shuttle_marl {__version__}",
        "licence": upstream.LICENCE_NOTE,
        "citations": list(upstream.CITATIONS),
        **cleaned.provenance,
    }


def anonymised(strokes: pa.Table) -> pa.Table:
    """Strokes with pseudonyms for players (``player-01``) and matches (``match-001``), without provenance. The numbers follow the
    SHA-256 of the names, so they reveal no order; the same names give the same pseudonyms."""
    for columns, form in ((("player", "opponent"), "player-{:02d}"), (("match",), "match-{:03d}")):
        names = set[str]().union(*(strokes[column].unique().to_pylist() for column in columns))
        ranked = enumerate(sorted(names, key=lambda name: content_hash(name.encode())), 1)
        pseudonym = {name: form.format(number) for number, name in ranked}
        for column in columns:
            strokes = schema.changed(strokes, column, pa.array(map(pseudonym.get, strokes[column].to_pylist()), pa.string()))
    told = strokes.schema.metadata or {}
    return strokes.replace_schema_metadata({key: value for key, value in told.items() if key != _PROVENANCE})


def pseudonymous(cleaned: Cleaned) -> Cleaned:
    """Imported strokes with pseudonyms (:func:`anonymised`), and a provenance without names: of the file, or quoted from it."""
    strokes, named = anonymised(cleaned.strokes), unknown_hands(cleaned.strokes)
    told = {name: value for name, value in cleaned.provenance.items() if name not in ("file", "sha256")}
    for kind in ("inferred", "lost"):
        told[kind] = [_QUOTED.sub("'…'", sentence) for sentence in told[kind] if sentence not in named]
    told["lost"] += unknown_hands(strokes)
    return dataclasses.replace(cleaned, strokes=strokes, provenance=told)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Report:
    """Result of a validation: problems, and notes that are none.

    Attributes:
        splits: by split, number of unaltered files present and number of published files; empty for a table.
        account: of the strokes, None if they cannot be read.
    """

    problems: Sequence[Problem] = ()
    notes: Sequence[str] = ()
    splits: Mapping[Split, tuple[int, int]] = dataclasses.field(default_factory=dict)
    account: Account | None = None


def validate(path: Path, splits: Sequence[Split] = SPLITS, columns: Path | None = None) -> Report:
    """Validate a folder with the raw files, a Parquet file, or a file to import."""
    try:
        if columns is None and path.is_dir():
            return _validate_folder(path, splits)
        if (cleaned := _cleaned(path, columns)) is not None:
            return Report(notes=cleaned.warnings, account=cleaned.account)
        return _validate_table(path)
    except DataError as error:
        return Report(problems=error.problems)


def _validate_table(path: Path) -> Report:
    strokes, account = _read(path)
    lost, problems = _lack(strokes, account), [*map(str, violations(strokes))]
    notes = [*copies(strokes), *(() if problems else _by_rules(strokes, path)[1])]
    if account is None:
        notes += [lost, "another program wrote this file, without an account: the counts are those of its rows"]
    else:
        problems.append(lost)
        if account.strokes_kept + sum(account.dropped.values()) != account.strokes:
            problems.append("inconsistent account: kept and dropped strokes do not add up to all strokes")
    found, told = (tuple(Problem(path, text) for text in texts if text) for texts in (problems, notes))
    return Report(problems=found, notes=tuple(map(str, told)), account=account or Account.of(strokes))


def _validate_folder(root: Path, splits: Sequence[Split]) -> Report:
    """Compare the files with the manifest, and read every game strictly; problems of published files are notes."""
    if not any((root / source).is_dir() for source in upstream.SOURCES.values()):
        advice = f"`{command('data', 'download')}` downloads them; import your own with `{command('data', 'import')}`"
        nothing = Problem(root, f"contains none of the published data sets ({', '.join(upstream.SOURCES)}); {advice}")
        return Report(problems=(nothing,), splits=_compare(root, ())[0])
    counts, problems = _compare(root, splits)
    compared, notes = len(problems), list[str]()
    try:
        matches = list_matches(root, problems)
    except DataError as error:
        return Report(problems=(*problems, *error.problems), splits=counts)
    present = [match for match in matches if match.present]
    for match in present:
        try:
            for path in match.games():
                game = read_game(match, path)
                if game.published:
                    notes.extend(f"{problem} (in the published file: the row is dropped)" for problem in game.problems)
                else:
                    problems.extend(game.problems)
        except DataError as error:
            problems.extend(error.problems)
    listed = {match.name for match in matches}
    for source in upstream.SOURCES.values():
        strangers = sorted(child for child in (root / source).glob("*") if child.is_dir() and child.name not in listed)
        notes.extend(f"{child}: not in match.csv, so it is not read" for child in strangers)
    account = clean_matches(root).account if present and len(problems) == compared else None
    return Report(problems=tuple(problems), notes=tuple(notes), splits=counts, account=account)


def _compare(root: Path, splits: Sequence[Split]) -> tuple[dict[Split, tuple[int, int]], list[Problem]]:
    """Compare the files with the manifest: counts of unaltered and listed files by split, and problems."""
    whole, listed = collections.Counter[Split](), collections.Counter[Split]()
    missing: dict[tuple[Path, Split | None], list[str]] = {}
    problems: list[Problem] = []
    for name, digest in upstream.manifest().items():
        match, file = upstream.match_of(name), root / name
        split = None if match is None else split_of(match)
        listed.update([split] if split else [])
        if not file.is_file():
            missing.setdefault((file.parent, split), []).append(file.name)
        elif (got := upstream.sha256_of(file)) != digest:
            problems.append(Problem(file, f"altered: SHA-256 is {got}, expected {digest}; delete it and download it again"))
        else:
            whole.update([split] if split else [])
    advice = f"download them with `{command('data', 'download')}`"
    for (folder, split), names in missing.items():
        if split is None or split in splits:
            of_split = "" if split is None else f" ({split} split)"
            problems.append(Problem(folder, f"missing {', '.join(names)}{of_split}; {advice}"))
    return {split: (whole[split], listed[split]) for split in SPLITS}, problems


def strokes_hash(strokes: pa.Table) -> str:
    """SHA-256 of the columns of a stroke table without metadata, equal for the raw files and for Parquet."""
    return content_hash(_stream(strokes.cast(pa.schema([field.remove_metadata() for field in strokes.schema])).combine_chunks()))


def _stream(table: pa.Table, options: pa.ipc.IpcWriteOptions | None = None) -> bytes:
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema, options=options) as writer:
        writer.write_table(table)
    return bytes(sink.getvalue())
