"""A batch of rallies as a chunk of an MCAP file: Arrow columns, compression, and decoding of untrusted bytes.

A batch is one Arrow stream, which is the only message of a chunk. ``docs/rally_log.md`` describes the columns.
"""

import functools
import io
import itertools
import mmap
import struct
import zlib
from collections.abc import Iterator
from typing import Final

import numpy as np
import pyarrow as pa
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, Message

from shuttle_marl.base.arrays import Array
from shuttle_marl.game.rally import OPTIONAL, PER_STROKE, Rallies, stroke_dtype
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.recording.header import VERSION, DamagedLogError, LogHeader

FRAME: Final = struct.Struct("<BQ")
"""Head of every record: opcode and length of the body."""
RALLY_TIME: Final = 1_000_000
"""Log time of a rally [ns]: the log time of a batch is the number of its first rally times this."""
MAX_CHUNK: Final = 1 << 25
"""Limit of an uncompressed batch [bytes]; a file with a larger one is damaged."""
MAX_RALLIES: Final = 1 << 16
"""Limit of the rallies of a batch."""
MAX_STROKES: Final = 1 << 22
"""Limit of the strokes of a batch."""
_MAX_RECORDS: Final = 8
"""Limit of the records in a chunk: the message, and the channel and its schema in the first chunk."""
_ZSTD: Final = "zstd"
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
UNDECODABLE: Final = (struct.error, McapError, pa.ArrowException, zstandard.ZstdError, ValueError, LookupError, OverflowError)
"""Errors that the decoders raise for input that they do not expect."""


@functools.cache
def arrow_schema(n_strokes: int, columns: tuple[str, ...] = ()) -> pa.Schema:
    """Columns of a log: stroke numbers take one byte in a game of up to 256 strokes, else two.

    Args:
        columns: the columns of :data:`shuttle_marl.game.rally.OPTIONAL` in the log.
    """
    fields = [pa.field(name, kind, nullable=False) for name, kind in _ROW]
    if "update" in columns:
        fields.append(pa.field("update", pa.uint32(), nullable=False))
    fields.append(_list("strokes", "stroke", pa.from_numpy_dtype(stroke_dtype(n_strokes))))
    fields.append(_list("hurried", "hurried", pa.bool_()))
    kinds = {"waited": pa.int8()}
    fields += [_list(name, name, kinds.get(name, pa.float32())) for name in OPTIONAL if name in PER_STROKE and name in columns]
    return pa.schema(fields)


def _list(name: str, item: str, kind: pa.DataType) -> pa.Field:
    return pa.field(name, pa.list_(pa.field(item, kind, nullable=False)), nullable=False)


def to_arrow(rallies: Rallies, n_strokes: int) -> pa.RecordBatch:
    """Rallies as a batch of schema :func:`arrow_schema`."""
    columns = dict(rallies.columns())
    columns |= {f"policy_{seat}": rallies.policy[:, seat] for seat in (0, 1)}
    columns |= {name: rallies.score[:, i] for i, name in enumerate(_SCORE)} | {"strokes": rallies.stroke}
    columns["hurried"] = rallies.hurried.astype(np.bool_)
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
    further: dict[str, Array] = {}
    for name in ("hurried", *(name for name in OPTIONAL if name in batch.schema.names)):
        values = batch.column(name)
        if name in PER_STROKE:
            if not np.array_equal(np.diff(values.offsets.to_numpy()), length):
                raise DamagedLogError(f"a rally whose number of strokes differs from the length of its {name}")
            values = values.flatten()
        further[name] = values.to_numpy(zero_copy_only=False)
    further["hurried"] = further["hurried"].astype(np.uint8)
    return Rallies(
        **{name: column[name] for name in ("pairing", "match", "rally", "server", "winner", "reason")},
        policy=np.stack([column["policy_0"], column["policy_1"]], axis=1),
        score=np.stack([column[name] for name in _SCORE], axis=1),
        length=length,
        stroke=strokes.flatten().to_numpy(zero_copy_only=False),
        **further,
    )


def encode(first: int, rallies: Rallies, n_strokes: int) -> memoryview:
    """Message of a batch whose first rally has number ``first``."""
    batch = to_arrow(rallies, n_strokes)
    return memoryview(arrow_stream(batch.replace_schema_metadata({"version": str(VERSION), "first_rally": str(first)})))


def arrow_stream(batch: pa.RecordBatch) -> pa.Buffer:
    """A batch as an Arrow stream."""
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    return sink.getvalue()


def decode(message: Message, header: LogHeader) -> tuple[int, Rallies]:
    """Number of the first rally, and the rallies, with every index in range.

    Raises:
        DamagedLogError: the message is not a batch of rallies.
        pa.ArrowException: the message is not an Arrow stream.
    """
    batch = read_arrow(message.data)
    metadata = batch.schema.metadata or {}
    if (
        not batch.schema.equals(arrow_schema(len(header.strokes), header.columns))
        or metadata.get(b"version") != str(VERSION).encode()
    ):
        raise DamagedLogError(f"a batch with other columns than version {VERSION} has")
    first = int(metadata.get(b"first_rally", b"-1"))
    if first < 0 or first * RALLY_TIME != message.log_time or not 0 < batch.num_rows <= MAX_RALLIES:
        raise DamagedLogError(f"a batch of {batch.num_rows} rallies from rally {first} on, at {message.log_time} ns")
    rallies = from_arrow(batch)
    if len(rallies.stroke) > MAX_STROKES:
        raise DamagedLogError(f"{len(rallies.stroke)} strokes in a batch, expected at most {MAX_STROKES}")
    _check_numbers(rallies, header)
    return first, rallies


def read_arrow(data: bytes) -> pa.RecordBatch:
    """The only batch of an Arrow stream.

    Arrow decompresses without a limit and does not report the compression, so the field ``compression`` of the metadata is read
    from the FlatBuffers table ``RecordBatch`` (https://github.com/apache/arrow/blob/main/format/Message.fbs).

    Raises:
        DamagedLogError: none or several batches, or a compressed one, which would expand to more than its chunk holds.
        pa.ArrowException: not an Arrow stream.
        struct.error: the metadata is damaged.
    """
    try:
        for message in pa.ipc.MessageReader.open_stream(data):
            if message.type == "record batch":
                metadata = message.metadata.to_pybytes()
                header = _field(metadata, struct.unpack_from("<I", metadata)[0], 2)
                batch = header and header + struct.unpack_from("<I", metadata, header)[0]
                if batch and _field(metadata, batch, 3):
                    raise DamagedLogError("a batch whose columns are compressed again")
        with pa.ipc.open_stream(data) as reader:
            batches = list(reader)
    except OSError as error:  # of Arrow, about the bytes: no file is involved
        raise DamagedLogError(f"a batch that is no Arrow stream ({error})") from error
    if len(batches) != 1:
        raise DamagedLogError(f"{len(batches)} batches in an Arrow stream, expected 1")
    batches[0].validate(full=True)
    return batches[0]


def _field(metadata: bytes, table: int, number: int) -> int:
    """Position of a field of a FlatBuffers table; 0 if it is absent."""
    vtable = table - struct.unpack_from("<i", metadata, table)[0]
    if vtable < 0 or 4 + 2 * number >= struct.unpack_from("<H", metadata, vtable)[0]:
        return 0
    offset: int = struct.unpack_from("<H", metadata, vtable + 4 + 2 * number)[0]
    return offset and table + offset


def _check_numbers(rallies: Rallies, header: LogHeader) -> None:
    ranges: list[tuple[str, Array, int]] = [
        ("seat", rallies.server, 2),
        ("seat", rallies.winner, 2),
        ("reason", rallies.reason, 2),
        ("policy", rallies.policy, len(header.policies)),
        ("pairing", rallies.pairing, len(header.pairings)),
        ("stroke", rallies.stroke, len(header.strokes)),
    ]
    if rallies.waited is not None:
        ranges.append(("position", rallies.waited, N_POSITIONS))
    for what, numbers, limit in ranges:
        most, least = int(np.max(numbers)), int(np.min(numbers))
        if least < 0 or most >= limit:
            raise DamagedLogError(f"{what} {most if most >= limit else least} in a batch, expected less than {limit}")
    if int(rallies.length.min()) < 1 or int(rallies.length.sum(dtype=np.int64)) != len(rallies.stroke):
        raise DamagedLogError("a rally without strokes")
    if rallies.hurried[rallies.first_stroke[:-1]].any():
        raise DamagedLogError("a server who is hurried")


def message_of_chunk(body: bytes) -> Message:
    """The one message of a chunk.

    Raises:
        DamagedLogError: checksum or sizes do not match, or not a chunk of a rally log.
    """
    chunk = Chunk.read(stream(body))
    if chunk.compression != _ZSTD or chunk.uncompressed_size > MAX_CHUNK:
        raise DamagedLogError(f"a chunk of {chunk.uncompressed_size} bytes packed as {chunk.compression!r}")
    # Decompression allocates the size in the frame; an unchecked size would let a damaged file use all memory.
    if zstandard.get_frame_parameters(chunk.data).content_size != chunk.uncompressed_size:
        raise DamagedLogError("the sizes in a chunk disagree")
    data = zstandard.decompress(chunk.data)
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamagedLogError("the checksum of a chunk does not match")
    found = [*itertools.islice(records(data), _MAX_RECORDS + 1)]
    messages = [Message.read(stream(inner), len(inner)) for opcode, inner in found if opcode == Opcode.MESSAGE]
    if len(found) > _MAX_RECORDS or len(messages) != 1:
        raise DamagedLogError(f"{len(messages)} messages in the first {len(found)} records of a chunk, expected 1")
    return messages[0]


def records(data: bytes | mmap.mmap, at: int = 0) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record from a position on.

    The readers of the official library stop at the first record that they cannot decode, and trust the sizes in it; here a record
    is decoded on its own, by ``mcap.records``.

    Raises:
        DamagedLogError: the last record is truncated.
    """
    while at < len(data):
        opcode, length = FRAME.unpack(data[at : at + FRAME.size].ljust(FRAME.size, b"\xff"))
        at += FRAME.size
        if not opcode or length > len(data) - at:  # a power failure can leave zeros
            raise DamagedLogError("a record is cut off")
        yield opcode, data[at : at + length]
        at += length


def record(data: bytes | mmap.mmap, at: int, kind: Opcode) -> bytes:
    """Body of the record at a position.

    Raises:
        DamagedLogError: another kind of record, or a truncated one.
    """
    opcode, body = next(records(data, at), (0, b""))
    if opcode != kind:
        raise DamagedLogError(f"no {kind.name} record at byte {at}")
    return body


def stream(body: bytes) -> ReadDataStream:
    """Body of a record, for the decoders of ``mcap.records``."""
    return ReadDataStream(io.BytesIO(body))
