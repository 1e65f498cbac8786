"""Stroke tables as Parquet files: written with their account and provenance, read back strictly."""

import hashlib
import json
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from shuttle_marl import __version__, table_files
from shuttle_marl.data import upstream
from shuttle_marl.data.clean import Account, Cleaned, clean_matches
from shuttle_marl.data.schema import STROKES
from shuttle_marl.data.strict_csv import DataError
from shuttle_marl.files import problem

_ACCOUNT: Final = b"shuttle_marl.account"
_PROVENANCE: Final = b"shuttle_marl.provenance"


def load_strokes(path: Path | str) -> pa.Table:
    """The strokes of a Parquet file made by ``convert``, or of a folder with the raw files, which are cleaned.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`.

    Raises:
        DataError: no such file or folder, an unreadable one, or another schema.
    """
    path = Path(path)
    return clean_matches(path).strokes if path.is_dir() else read_parquet(path)


def load_account(path: Path | str) -> Account:
    """The account of a Parquet file, or of a folder with the raw files.

    Raises:
        DataError: as :func:`load_strokes`; or the file holds no account.
    """
    path = Path(path)
    if path.is_dir():
        return clean_matches(path).account
    metadata = _open(path).schema_arrow.metadata or {}
    try:
        return Account.from_json(json.loads(metadata[_ACCOUNT]))
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise DataError(path, "holds no account of its strokes; make it with `python -m shuttle_marl.data convert`") from error


def write_parquet(strokes: pa.Table, path: Path, *, account: Account, provenance: dict[str, Any]) -> None:
    """Write a stroke table (zstd, with checksums), whole or not at all. The same arguments give the same bytes.

    Raises:
        FileWriteError: the file cannot be written.
    """
    extra = {
        _ACCOUNT: json.dumps(account.as_json()).encode(),
        _PROVENANCE: json.dumps(provenance, ensure_ascii=False).encode(),
    }
    table = strokes.cast(STROKES).combine_chunks().replace_schema_metadata({**STROKES.metadata, **extra})
    table_files.write_parquet(path, table, compression_level=9)


def read_parquet(path: Path) -> pa.Table:
    """Read a stroke table.

    Raises:
        DataError: no such file, no Parquet, or another schema; says which column.
    """
    file = _open(path)
    check_schema(path, file.schema_arrow)
    try:
        return file.read()
    except (OSError, pa.ArrowException) as error:
        raise DataError(path, f"a damaged Parquet file ({error}); make it again") from error


def check_schema(path: Path, schema: pa.Schema) -> None:
    """Compare a schema with the one of strokes.

    Raises:
        DataError: a column is missing, has another type, or is in another place; or the version differs.
    """
    advice = "make it again with `python -m shuttle_marl.data convert`"
    version = (schema.metadata or {}).get(b"version")
    expected = STROKES.metadata[b"version"]
    if version != expected:
        raise DataError(path, f"schema version {version!r}, expected {expected!r}; {advice}")
    for field in STROKES:
        if field.name not in schema.names:
            raise DataError(path, f"column {field.name!r} is missing; {advice}")
        found = schema.field(field.name)
        if found.type != field.type or found.nullable != field.nullable:
            raise DataError(path, f"column {field.name!r} is {_kind(found)}, expected {_kind(field)}; {advice}")
    if schema.names != STROKES.names:
        raise DataError(path, f"columns {', '.join(schema.names)}; expected {', '.join(STROKES.names)} in this order")


def provenance_of(root: Path, cleaned: Cleaned) -> dict[str, Any]:
    """Provenance of a cleaned table: a JSON object with the same values for the same input."""
    digest = hashlib.sha256()
    for path in cleaned.files:
        digest.update(f"{path.relative_to(root).as_posix()}\n".encode() + hashlib.sha256(path.read_bytes()).digest())
    return {
        "repository": upstream.REPOSITORY,
        "commit": upstream.COMMIT,
        "files": len(cleaned.files),
        "sha256": digest.hexdigest(),
        "cleaned_by": f"shuttle_marl {__version__}",
        "licence": upstream.LICENCE_NOTE,
        "citations": list(upstream.CITATIONS),
    }


def _open(path: Path) -> pq.ParquetFile:
    try:
        return table_files.open_parquet(path)
    except FileNotFoundError as error:
        raise DataError(path, "no such file or folder; give a folder with the data or a Parquet file") from error
    except pa.ArrowException as error:
        raise DataError(path, f"no readable Parquet file ({error})") from error
    except (OSError, ValueError) as error:
        raise DataError(path, f"cannot be read ({problem(error)})") from error


def _kind(field: pa.Field) -> str:
    return f"{field.type}{'' if field.nullable else ' not null'}"
