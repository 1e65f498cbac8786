"""Tables as Parquet files with a checksum, and as CSV files that spreadsheets do not execute.

Parquet supports checksums of page data, but not of page headers and the footer. A *seal*, a mark and the SHA-256 of the rest of
the file, is stored between the last page and the footer, which readers of Parquet ignore. :func:`read_parquet` verifies both.
"""

import io
from pathlib import Path
from typing import Any, BinaryIO, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from shuttle_marl.base.files import hash_of, read_file, replace_file, verify

PARQUET: Final[dict[str, Any]] = {"compression": "zstd", "write_page_checksum": True}
_MARK: Final = b"shuttle_marl.sha256="
_SEAL: Final = len(_MARK) + 64
_END: Final = 8  # length of the length of the footer, and of the magic ``PAR1`` behind it [bytes]
_MOST: Final = 1 << 29  # maximum size of a file and of its table [bytes]: a small file may hold any number of equal rows
_FORMULA: Final = r"\A([=+\-@\t\r])"


def parquet_bytes(table: pa.Table, **options: Any) -> bytes:
    """A table as a sealed Parquet file, with options of ``pyarrow.parquet.write_table``; equal arguments give equal bytes."""
    file = io.BytesIO()
    pq.write_table(table, file, **{**PARQUET, **options})
    seal_parquet(file)
    return file.getvalue()


def write_parquet(path: Path, table: pa.Table, *, new: bool = False, **options: Any) -> None:
    """Write :func:`parquet_bytes` of a table atomically; ``new``, errors: :func:`~shuttle_marl.base.files.replace_file`."""
    replace_file(path, parquet_bytes(table, **options), new=new)


def seal_parquet(file: BinaryIO) -> None:
    """Add the seal to a complete Parquet file; ``file``: open for reading and writing, without a seal."""
    file.seek(0)
    digest = hash_of(iter(lambda: file.read(1 << 20), b""))
    file.seek(-_END, io.SEEK_END)
    start = file.seek(-_END - int.from_bytes(file.read(4), "little"), io.SEEK_END)
    footer = file.read()
    file.seek(start)
    file.write(_MARK + digest.encode() + footer)


def read_parquet(path: Path) -> pa.Table:
    """Read the table of a Parquet file; verifies the checksums of its pages and its seal, if it has them.

    Raises:
        OSError: the file cannot be opened, is not a regular file or larger than 512 MB, or a page is damaged.
        ValueError: it was changed after it was written.
        pa.ArrowException: it is not a Parquet file, is damaged, or is larger than 512 MB in memory, by the sizes in its footer.
        MemoryError: there is less memory than it needs.
    """
    content = read_file(path, _MOST)
    start = len(content) - _END - int.from_bytes(content[-_END:-4], "little")
    if start < 4 or not content.endswith(b"PAR1"):
        raise pa.ArrowInvalid("not a Parquet file, or truncated")
    pages = max(0, start - _SEAL)
    seal = content[pages:start]
    if seal.startswith(_MARK):
        verify(seal[len(_MARK) :].decode(), [content[:pages], content[start:]])
    file = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True)
    schema, about = file.schema_arrow, file.metadata
    for field in schema:
        kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
        if not (pa.types.is_primitive(kind) or pa.types.is_null(kind) or _is_text(kind)):
            raise pa.ArrowInvalid(f"column {field.name!r:.50} holds values of type {kind!s:.50}, expected numbers or text")
    # Equal texts are stored once, and equal numbers as their count. Memory is added up before it is used: from the sizes of the
    # pages, the number of rows, the widths of numbers, and the lengths of texts.
    _bounded(sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups)))
    _bounded(size := about.num_rows * sum(_width(field.type) for field in schema))
    texts = [field.name for field in schema if _is_text(field.type)]
    table = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True, read_dictionary=texts).read(
        use_threads=False
    )
    lengths = (pc.binary_length(chunk.dictionary).take(chunk.indices) for name in texts for chunk in table[name].chunks)
    _bounded(size + sum(pc.sum(each).as_py() or 0 for each in lengths))
    return table.cast(schema)


def _bounded(size: int) -> None:
    if size > _MOST:
        raise pa.ArrowInvalid(f"a table of {size >> 20} MB, expected at most {_MOST >> 20}; divide the file")


def _is_text(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _width(kind: pa.DataType) -> int:
    """Size of a value [bytes], of texts only that of their index."""
    try:
        return max(1, int(kind.bit_width) // 8)
    except ValueError:
        return 4


def csv_bytes(table: pa.Table) -> bytes:
    """A table as CSV without formulas, see :func:`without_formulas`."""
    buffer = pa.BufferOutputStream()
    pyarrow.csv.write_csv(without_formulas(table), buffer)
    content: bytes = buffer.getvalue().to_pybytes()
    return content


def without_formulas(table: pa.Table) -> pa.Table:
    """The table without dictionaries; an apostrophe precedes ``=``, ``+``, ``-``, ``@``, tab and return, as in formulas."""
    for at, field in enumerate(table.schema):
        kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
        if pa.types.is_string(kind):
            plain = pc.replace_substring_regex(table.column(at).cast(pa.string()), _FORMULA, r"'\1")
            table = table.set_column(at, pa.field(field.name, pa.string(), field.nullable), plain)
    return table
