"""One schema for recorded rallies: a row a rally, its strokes in a list. Version 2; see ``docs/rally_log.md``."""

import functools
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.arrays import Array
from shuttle_marl.errors import ShuttleError
from shuttle_marl.rally.record import OPTIONAL, PER_STROKE, Rallies, stroke_dtype

VERSION: Final = 2

_ROW: Final = (
    ("pairing", pa.uint32()),
    ("match", pa.uint32()),
    ("rally", pa.uint16()),
    ("policy_0", pa.uint16()),
    ("policy_1", pa.uint16()),
    ("server", pa.uint8()),
    ("winner", pa.uint8()),
    ("reason", pa.uint8()),
    ("points_0", pa.uint8()),
    ("points_1", pa.uint8()),
    ("games_0", pa.uint8()),
    ("games_1", pa.uint8()),
)
_SCORE: Final = ("points_0", "points_1", "games_0", "games_1")


class RecordingError(ShuttleError):
    """A log that cannot be written, or a file that is no rally log of this version."""


class DamagedLogError(RecordingError):
    """A rally log that was cut off or changed after it was written."""


class OtherFileError(RecordingError):
    """A file that is no rally log at all."""


@functools.cache
def arrow_schema(n_strokes: int, columns: tuple[str, ...] = ()) -> pa.Schema:
    """Columns of a log: stroke numbers take one byte in a game of up to 256 strokes, else two.

    Args:
        n_strokes: number of strokes in the game.
        columns: the columns of :data:`shuttle_marl.rally.record.OPTIONAL` in the log.
    """
    fields = [pa.field(name, kind, nullable=False) for name, kind in _ROW]
    if "update" in columns:
        fields.append(pa.field("update", pa.uint32(), nullable=False))
    fields.append(_list("strokes", "stroke", pa.from_numpy_dtype(stroke_dtype(n_strokes))))
    fields += [_list(name, name, pa.float32()) for name in OPTIONAL if name in PER_STROKE and name in columns]
    return pa.schema(fields)


def _list(name: str, item: str, kind: pa.DataType) -> pa.Field:
    return pa.field(name, pa.list_(pa.field(item, kind, nullable=False)), nullable=False)


def to_arrow(rallies: Rallies, n_strokes: int) -> pa.RecordBatch:
    """Rallies as a batch of schema :func:`arrow_schema`."""
    columns = dict(rallies.columns())
    columns |= {f"policy_{seat}": rallies.policy[:, seat] for seat in (0, 1)}
    columns |= {name: rallies.score[:, i] for i, name in enumerate(_SCORE)} | {"strokes": rallies.stroke}
    offsets = pa.array(rallies.first_stroke.astype(np.int32))
    schema = arrow_schema(n_strokes, rallies.optional_columns)
    arrays = []
    for field in schema:
        column = np.ascontiguousarray(columns[field.name])
        if pa.types.is_list(field.type):
            arrays.append(pa.ListArray.from_arrays(offsets, pa.array(column, field.type.value_type), type=field.type))
        else:
            arrays.append(pa.array(column, field.type))
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def from_arrow(batch: pa.RecordBatch) -> Rallies:
    """Rallies of a batch of schema :func:`arrow_schema`.

    Raises:
        DamagedLogError: lists of different lengths in one row.
    """
    column = {name: batch.column(name).to_numpy(zero_copy_only=False) for name, _ in _ROW}
    strokes = batch.column("strokes")
    length = np.diff(strokes.offsets.to_numpy()).astype(np.int32)
    optional: dict[str, Array] = {}
    for name in (name for name in OPTIONAL if name in batch.schema.names):
        values = batch.column(name)
        if name in PER_STROKE:
            if not np.array_equal(np.diff(values.offsets.to_numpy()), length):
                raise DamagedLogError(f"a rally whose number of strokes differs from the length of its {name}")
            values = values.flatten()
        optional[name] = values.to_numpy(zero_copy_only=False)
    return Rallies(
        **{name: column[name] for name in ("pairing", "match", "rally", "server", "winner", "reason")},
        policy=np.stack([column["policy_0"], column["policy_1"]], axis=1),
        score=np.stack([column[name] for name in _SCORE], axis=1),
        length=length,
        stroke=strokes.flatten().to_numpy(zero_copy_only=False),
        **optional,
    )
