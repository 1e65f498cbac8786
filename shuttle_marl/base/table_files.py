"""Tables as Parquet files with a checksum, and as CSV files that spreadsheets do not execute.

Parquet supports checksums of page data, but not of page headers and the footer. A *seal*, a mark and the SHA-256 of the rest of
the file, is stored between the last page and the footer, which readers of Parquet ignore. :func:`open_parquet` verifies it.
"""

import hashlib
import io
from pathlib import Path
from typing import Any, BinaryIO, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from shuttle_marl.base.files import open_file, replace_file

PARQUET: Final[dict[str, Any]] = {"compression": "zstd", "write_page_checksum": True}
"""Options of all Parquet files."""
_MARK: Final = b"shuttle_marl.sha256="
_SEAL: Final = len(_MARK) + 32
_END: Final = 8
"""Length of the footer (4 bytes) and the magic ``PAR1`` [bytes]."""
_BLOCK: Final = 1 << 20
_MOST_FOOTER: Final = 1 << 24
"""Maximum size of a footer [bytes]."""
_MOST: Final = 1 << 29
"""Maximum size of a table that is read [bytes]: a small file may hold any number of equal rows."""
_FORMULA: Final = r"\A([=+\-@\t\r])"


def parquet_bytes(table: pa.Table, **options: Any) -> bytes:
    """A table as a sealed Parquet file; the same arguments give the same bytes.

    Args:
        **options: of ``pyarrow.parquet.write_table``, in addition to :data:`PARQUET`.
    """
    buffer = pa.BufferOutputStream()
    pq.write_table(table, buffer, **{**PARQUET, **options})
    file = io.BytesIO(buffer.getvalue().to_pybytes())
    seal_parquet(file)
    return file.getvalue()


def write_parquet(path: Path, table: pa.Table, **options: Any) -> None:
    """Write a table as a sealed Parquet file, atomically.

    Raises:
        FileWriteError: the file cannot be written.
    """
    replace_file(path, parquet_bytes(table, **options))


def seal_parquet(file: BinaryIO) -> None:
    """Add the seal to a complete Parquet file.

    Args:
        file: open for reading and writing, without a seal.
    """
    start, size = _footer(file)
    file.seek(start)
    footer = file.read()
    digest = _digest(file, (0, start), (start, size))
    file.seek(start)
    file.write(_MARK + digest + footer)


def open_parquet(path: Path) -> pq.ParquetFile:
    """Open a Parquet file and verify its seal, if it has one; reading verifies the pages.

    Raises:
        OSError: the file cannot be opened, is not a regular file, or (on reading) a page is damaged.
        pa.ArrowException: it is not a Parquet file, is damaged, or has columns of more than 512 MB together.
    """
    with open_file(path) as file:
        start, size = _footer(file)
        file.seek(max(0, start - _SEAL))
        seal = file.read(min(start, _SEAL))
        if seal.startswith(_MARK) and seal[len(_MARK) :] != _digest(file, (0, start - _SEAL), (start, size)):
            raise pa.ArrowInvalid("it was changed after it was written: its checksum does not match")
    file = pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False)
    about = file.metadata
    if (size := sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))) > _MOST:
        file.close()
        raise pa.ArrowInvalid(f"columns of {size >> 20} MB, expected at most {_MOST >> 20}; divide the file")
    return file


def read_parquet(path: Path) -> pa.Table:
    """Read the table of a Parquet file, verified as by :func:`open_parquet`.

    Raises:
        OSError: the file cannot be opened, is not a regular file, or a page is damaged.
        pa.ArrowException: it is not a Parquet file, is damaged, or is larger than 512 MB in memory.
        MemoryError: there is less memory than it needs.
    """
    with open_parquet(path) as file:
        schema = file.schema_arrow
        texts = [field.name for field in schema if pa.types.is_string(field.type) or pa.types.is_large_string(field.type)]
    # Equal texts are stored once, and equal numbers as their count. Memory is added up before it is used: from the number of
    # rows, the widths of numbers, and the lengths of texts.
    with pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False, read_dictionary=texts) as file:
        size = file.metadata.num_rows * sum(_width(field.type) for field in schema)
        if size > _MOST:
            raise pa.ArrowInvalid(f"a table of {size >> 20} MB, expected at most {_MOST >> 20}; divide the file")
        table = file.read(use_threads=False)
    for name in texts:
        size += sum(pc.sum(pc.binary_length(chunk.dictionary).take(chunk.indices)).as_py() or 0 for chunk in table[name].chunks)
    if size > _MOST:
        raise pa.ArrowInvalid(f"a table of {size >> 20} MB, expected at most {_MOST >> 20}; divide the file")
    return table.cast(schema)


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
    """The table with dictionaries decoded, and an apostrophe before text that a spreadsheet would interpret as a formula.

    Formulas start with ``=``, ``+``, ``-``, ``@``, a tab or a carriage return.
    """
    for at, field in enumerate(table.schema):
        kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
        if pa.types.is_string(kind):
            plain = pc.replace_substring_regex(table.column(at).cast(pa.string()), _FORMULA, r"'\1")
            table = table.set_column(at, pa.field(field.name, pa.string(), field.nullable), plain)
    return table


def _footer(file: BinaryIO) -> tuple[int, int]:
    """Offset of the footer of a Parquet file, and the size of the file [bytes].

    Raises:
        pa.ArrowInvalid: it is not a Parquet file.
    """
    size = file.seek(0, io.SEEK_END)
    if size >= _END + 4:
        file.seek(size - _END)
        end = file.read(_END)
        start = size - _END - int.from_bytes(end[:4], "little")
        if end.endswith(b"PAR1") and start >= max(4, size - _MOST_FOOTER):
            return start, size
    raise pa.ArrowInvalid("not a Parquet file, or truncated")


def _digest(file: BinaryIO, *ranges: tuple[int, int]) -> bytes:
    digest = hashlib.sha256()
    for begin, end in ranges:
        file.seek(begin)
        remaining = end - begin
        while remaining and (block := file.read(min(_BLOCK, remaining))):
            digest.update(block)
            remaining -= len(block)
    return digest.digest()
