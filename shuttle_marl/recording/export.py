"""Rally logs as Parquet, CSV or Arrow files, a batch at a time."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from shuttle_marl.recording.reader import RallyLog
from shuttle_marl.recording.schema import RecordingError
from shuttle_marl.recording.tables import rally_rows, stroke_rows

_WRITERS: Final[dict[str, Callable[[str, pa.Schema], Any]]] = {
    ".parquet": lambda path, schema: pyarrow.parquet.ParquetWriter(path, schema, compression="zstd"),
    ".csv": pyarrow.csv.CSVWriter,
    ".arrow": pa.ipc.new_file,
}


def export(source: Path, target: Path, rows: Literal["rallies", "strokes"]) -> int:
    """Write a log as a table; it is beside ``target`` until it is whole.

    Args:
        source: the log.
        target: ends in .parquet, .csv (lists of strokes as names with spaces between them) or .arrow; replaced if it exists.
        rows: one row a rally or a stroke, with the columns of :mod:`shuttle_marl.recording.tables`.

    Returns:
        The number of rows.

    Raises:
        RecordingError: an unknown suffix, a log that cannot be read, or a table that cannot be written.
    """
    open_writer = _WRITERS.get(target.suffix)
    if open_writer is None:
        raise RecordingError(f"{target}: expected a name that ends in {', '.join(_WRITERS)}")
    flat = target.suffix == ".csv"
    making = target.with_name(f".{target.name}.part")
    with RallyLog(source) as log:
        rows_of = rally_rows if rows == "rallies" else stroke_rows
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            schema = _columns(rows_of(log, 0, log.no_rallies()), log, flat).schema
            count = 0
            with open_writer(str(making), schema) as writer:
                for batch in log.batches():
                    table = _columns(rows_of(log, *batch), log, flat)
                    writer.write_table(table)
                    count += table.num_rows
            making.replace(target)
        except OSError as error:
            raise RecordingError(f"{target}: cannot be written ({error.strerror or error})") from error
        finally:
            with contextlib.suppress(OSError):
                making.unlink(missing_ok=True)
    return count


def _columns(table: pa.Table, log: RallyLog, flat: bool) -> pa.Table:
    """For CSV: dictionaries as words, and a list of strokes as one text."""
    if not flat:
        return table
    for at, field in enumerate(table.schema):
        column = table.column(at)
        if pa.types.is_dictionary(field.type):
            table = table.set_column(at, field.name, column.cast(pa.string()))
        elif pa.types.is_list(field.type):
            names = pa.array(log.catalogue.names)
            texts = [
                pa.compute.binary_join(pa.ListArray.from_arrays(chunk.offsets, names.take(chunk.values)), " ")
                for chunk in column.chunks
            ]
            table = table.set_column(at, field.name, pa.chunked_array(texts, pa.string()))
    return table
