"""Tables as Parquet files with a checksum, and as CSV files that spreadsheets do not execute.

Parquet supports checksums of page data, but not of page headers and the footer. A *seal*, a mark and the SHA-256 of the rest of
the file, is stored between the last page and the footer, which readers of Parquet ignore. :func:`open_parquet` verifies it.
"""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from shuttle_marl.base.files import hash_of, open_file, replace_file, verify

PARQUET: Final[dict[str, Any]] = {"compression": "zstd", "write_page_checksum": True}
"""Options of all Parquet files."""
_MARK: Final = b"shuttle_marl.sha256="
_SEAL: Final = len(_MARK) + 64
_END: Final = 8
"""Length of the footer (4 bytes) and the magic ``PAR1`` [bytes]."""
_BLOCK: Final = 1 << 20
_MOST_FOOTER: Final = 1 << 24
"""Maximum size of a footer [bytes]."""
_MOST: Final = 1 << 29
"""Maximum size of a table that is read [bytes]: a small file may hold any number of equal rows."""
_LONGEST_HEADER: Final = 1 << 16
"""Size of a page header that is read [bytes]."""
_TRUTHS: Final = (1, 2)
_NUMBERS: Final = (4, 5, 6)
_SIZES: Final = {3: 1, 7: 8, 8: 0}
"""Sizes of a byte, a double, and a text, which states its own [bytes]."""
_LISTS: Final = (9, 10)
_STRUCT: Final = 12
"""Kinds of values of Thrift's compact protocol."""
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


def write_parquet(path: Path, table: pa.Table, *, new: bool = False, **options: Any) -> None:
    """Write a table as a sealed Parquet file, atomically.

    Args:
        new: as of :func:`~shuttle_marl.base.files.replace_file`.
        **options: as of :func:`parquet_bytes`.

    Raises:
        FileWriteError: the file cannot be written.
    """
    replace_file(path, parquet_bytes(table, **options), new=new)


def seal_parquet(file: BinaryIO) -> None:
    """Add the seal to a complete Parquet file.

    Args:
        file: open for reading and writing, without a seal.
    """
    start, size = _footer(file)
    file.seek(start)
    footer = file.read()
    digest = hash_of(_blocks(file, (0, size)))
    file.seek(start)
    file.write(_MARK + digest.encode() + footer)


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
        if seal.startswith(_MARK):
            try:
                verify(seal[len(_MARK) :].decode(), _blocks(file, (0, start - _SEAL), (start, size)))
            except ValueError as error:
                raise pa.ArrowInvalid(str(error)) from error
    file = pq.ParquetFile(path, page_checksum_verification=True, pre_buffer=False)
    about = file.metadata
    with open_file(path) as pages:
        size = sum(_unpacked(pages, about.row_group(i).column(j)) for i, j in np.ndindex(about.num_row_groups, about.num_columns))
    if size > _MOST:
        file.close()
        raise pa.ArrowInvalid(f"columns of {size >> 20} MB, expected at most {_MOST >> 20}; divide the file")
    return file


def _unpacked(file: BinaryIO, chunk: pq.ColumnChunkMetaData) -> int:
    """Size of the pages of a column when they are unpacked [bytes], by their own headers: a footer may be forged.

    Raises:
        pa.ArrowInvalid: a header cannot be read.
    """
    first = chunk.dictionary_page_offset if chunk.has_dictionary_page else chunk.data_page_offset
    at, size = first, 0
    while at < first + chunk.total_compressed_size:
        file.seek(at)
        header = io.BytesIO(file.read(_LONGEST_HEADER))
        try:
            fields = _thrift(header, _STRUCT)
            unpacked, packed = fields[2], fields[3]
        except (IndexError, KeyError, RecursionError) as error:
            raise pa.ArrowInvalid("a page has no readable header") from error
        if min(unpacked, packed) < 0:
            raise pa.ArrowInvalid("a page has a negative size")
        size, at = size + unpacked, at + header.tell() + packed
    return size


def _thrift(data: BinaryIO, kind: int) -> Any:
    """Read a value of Thrift's compact protocol: a struct as numbers by field, a number, or nothing of other kinds."""
    if kind == _STRUCT:
        fields, number = dict[int, Any](), 0
        while step := data.read(1)[0]:
            number = number + (step >> 4) if step >> 4 else _thrift(data, _NUMBERS[0])
            fields[number] = _thrift(data, step & 15)
        return fields
    if kind in _LISTS:
        of = data.read(1)[0]
        for _ in range(of >> 4 if of >> 4 < 15 else _varint(data)):
            _thrift(data, of & 15)
    elif kind in _NUMBERS:
        number = _varint(data)
        return number >> 1 ^ -(number & 1)
    elif kind in _SIZES:
        data.seek(_SIZES[kind] or _varint(data), io.SEEK_CUR)
    elif kind not in _TRUTHS:
        raise KeyError(kind)
    return None


def _varint(data: BinaryIO) -> int:
    number = shift = 0
    while (byte := data.read(1)[0]) & 128:
        number, shift = number | (byte & 127) << shift, shift + 7
    return number | byte << shift


def read_parquet(path: Path) -> pa.Table:
    """Read the table of a Parquet file, verified as by :func:`open_parquet`.

    Raises:
        OSError: the file cannot be opened, is not a regular file, or a page is damaged.
        pa.ArrowException: it is not a Parquet file, is damaged, or is larger than 512 MB in memory.
        MemoryError: there is less memory than it needs.
    """
    with open_parquet(path) as file:
        schema = file.schema_arrow
        for field in schema:
            kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
            if not (pa.types.is_primitive(kind) or pa.types.is_null(kind) or _is_text(kind)):
                raise pa.ArrowInvalid(f"column {field.name!r:.50} holds values of type {kind!s:.50}, expected numbers or text")
        texts = [field.name for field in schema if _is_text(field.type)]
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


def _blocks(file: BinaryIO, *ranges: tuple[int, int]) -> Iterator[bytes]:
    for begin, end in ranges:
        file.seek(begin)
        remaining = end - begin
        while remaining and (block := file.read(min(_BLOCK, remaining))):
            yield block
            remaining -= len(block)
