"""The file of a rally log: batches of rallies, its MCAP records, and how it is read, written and recovered.

A batch is one Arrow stream, the only message of a chunk; ``docs/rally_log.md`` specifies the format. Nothing is trusted before
its checksum was verified.
"""

import contextlib
import dataclasses
import errno
import functools
import io
import itertools
import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final, cast

import numpy as np
import pyarrow as pa
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Chunk, Footer, Header, Message, Metadata
from mcap.writer import CompressionType, Writer

from shuttle_marl.base.arrays import U64, Array
from shuttle_marl.base.errors import command
from shuttle_marl.base.files import FileWriteError, open_file, problem, replacing
from shuttle_marl.game.rally import PER_STROKE, Rallies, stroke_dtype
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.rules import OUTCOMES, REASONS
from shuttle_marl.recording.header import VERSION, DamagedLogError, LogHeader, OtherFileError, RecordingError

FRAME: Final = struct.Struct("<BQ")
MAX_CHUNK: Final = 1 << 25  # limit of an uncompressed batch [bytes]; a file with a larger one is damaged
MAX_RALLIES: Final = 1 << 16
MAX_STROKES: Final = 1 << 22
_MAX_RECORDS: Final = 8  # limit of the records in a chunk: the message, and the channel and its schema in the first chunk
_RALLY_TIME: Final = 1_000_000  # log time of a rally [ns]: the log time of a batch is the number of its first rally times this
# Errors that the decoders raise for input that they do not expect.
_UNDECODABLE: Final = (struct.error, McapError, pa.ArrowException, zstandard.ZstdError, ValueError, LookupError, OverflowError)
_PROFILE: Final = "shuttle_marl"
_MAGIC: Final = b"\x89MCAP0\r\n"
_DATA_END: Final = FRAME.pack(Opcode.DATA_END, 4)
_FOOTER: Final = FRAME.pack(Opcode.FOOTER, 20)
_END: Final = len(_FOOTER) + 20 + len(_MAGIC)  # length of the footer, and of the magic bytes behind it
_METADATA: Final = "shuttle_marl.rally_log"
_INDEX: Final = "rally_index"
_INDEX_NAMES: Final = ("first_rally", "rallies", "strokes", "offset", "first_match", "last_match")
_INDEX_SCHEMA: Final = pa.schema([pa.field(name, pa.uint64(), nullable=False) for name in _INDEX_NAMES])
"""Columns of the attachment ``rally_index``, one row per batch: number of its first rally, numbers of its rallies and strokes,
offset of its chunk [bytes], and the least and greatest 2^32 x pairing + match in it."""
_SCORE: Final = ("points_0", "points_1", "games_0", "games_1")
_ROW: Final[dict[str, pa.DataType]] = {
    **dict.fromkeys(("pairing", "match"), pa.uint32()),
    **dict.fromkeys(("rally", "policy_0", "policy_1"), pa.uint16()),
    **dict.fromkeys(("server", "winner", "reason", *_SCORE), pa.uint8()),
}
_FURTHER: Final = {"seed": pa.uint64(), "episode": pa.uint32(), "ending": pa.uint8(), "update": pa.uint32()}
SUFFIX: Final = ".mcap"


@functools.cache
def arrow_schema(n_strokes: int, columns: tuple[str, ...] = ()) -> pa.Schema:
    """Columns of a log with some of :data:`shuttle_marl.game.rally.OPTIONAL`; strokes take a byte in games of up to 256."""
    rows = _ROW | {name: kind for name, kind in _FURTHER.items() if name in columns}
    kinds = {"stroke": pa.from_numpy_dtype(stroke_dtype(n_strokes)), "hurried": pa.bool_(), "waited": pa.int8()}
    lists = [("strokes", "stroke"), *((name, name) for name in PER_STROKE if name == "hurried" or name in columns)]
    of_item = {name: pa.field(item, kinds.get(item, pa.float32()), nullable=False) for name, item in lists}
    rows |= {name: pa.list_(item) for name, item in of_item.items()}
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in rows.items()])


def to_arrow(rallies: Rallies, n_strokes: int) -> pa.RecordBatch:
    """Rallies as a batch of schema :func:`arrow_schema`."""
    columns = dict(rallies.columns()) | {"strokes": rallies.stroke, "hurried": rallies.hurried.astype(np.bool_)}
    columns |= {f"policy_{seat}": rallies.policy[:, seat] for seat in (0, 1)}
    columns |= {name: rallies.score[:, i] for i, name in enumerate(_SCORE)}
    offsets, arrays = pa.array(rallies.first_stroke.astype(np.int32)), []
    for field in (schema := arrow_schema(n_strokes, rallies.optional_columns)):
        is_list = pa.types.is_list(field.type)
        values = pa.array(np.ascontiguousarray(columns[field.name]), field.type.value_type if is_list else field.type)
        arrays.append(pa.ListArray.from_arrays(offsets, values, type=field.type) if is_list else values)
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def from_arrow(batch: pa.RecordBatch) -> Rallies:
    """Rallies of a batch of schema :func:`arrow_schema`."""
    length = np.diff(batch.column("strokes").offsets.to_numpy()).astype(np.int32)
    column: dict[str, Array] = {}
    for name, values in zip(batch.schema.names, batch.columns, strict=True):
        is_list = pa.types.is_list(values.type)
        if is_list and not np.array_equal(np.diff(values.offsets.to_numpy()), length):
            raise DamagedLogError(f"a rally whose number of strokes differs from the length of its {name}")
        column[name] = (values.flatten() if is_list else values).to_numpy(zero_copy_only=False)
    column["hurried"] = column["hurried"].astype(np.uint8)
    policy = np.stack([column.pop("policy_0"), column.pop("policy_1")], axis=1)
    score = np.stack([column.pop(name) for name in _SCORE], axis=1)
    return Rallies(policy=policy, score=score, length=length, stroke=column.pop("strokes"), **column)


def encode(first: int, rallies: Rallies, n_strokes: int) -> memoryview:
    """Message of a batch whose first rally has number ``first``."""
    batch = to_arrow(rallies, n_strokes)
    return memoryview(_arrow_stream(batch.replace_schema_metadata({"version": str(VERSION), "first_rally": str(first)})))


def _arrow_stream(batch: pa.RecordBatch) -> pa.Buffer:
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    return sink.getvalue()


def decode(message: Message, header: LogHeader) -> tuple[int, Rallies]:
    """Number of the first rally, and the rallies, with every index in range."""
    batch = _read_arrow(message.data)
    metadata = batch.schema.metadata or {}
    expected = arrow_schema(len(header.strokes), header.columns)
    if not batch.schema.equals(expected) or metadata.get(b"version") != str(VERSION).encode():
        raise DamagedLogError(f"a batch with other columns than version {VERSION} has")
    first = int(metadata.get(b"first_rally", b"-1"))
    if first < 0 or first * _RALLY_TIME != message.log_time or not 0 < batch.num_rows <= MAX_RALLIES:
        raise DamagedLogError(f"a batch of {batch.num_rows} rallies from rally {first} on, at {message.log_time} ns")
    rallies = from_arrow(batch)
    if len(rallies.stroke) > MAX_STROKES:
        raise DamagedLogError(f"{len(rallies.stroke)} strokes in a batch, expected at most {MAX_STROKES}")
    _check_numbers(rallies, header)
    return first, rallies


def _read_arrow(data: bytes) -> pa.RecordBatch:
    """The only batch of an Arrow stream."""
    try:
        # Arrow decompresses without a limit and does not report the compression, so that is read from the FlatBuffers table
        # RecordBatch: https://github.com/apache/arrow/blob/main/format/Message.fbs.
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
    ranges: list[tuple[str, Array | None, int]] = [
        ("seat", rallies.server, 2),
        ("seat", rallies.winner, 2 if rallies.ending is None else 3),
        ("reason", rallies.reason, 2 if rallies.ending is None else len(REASONS)),
        ("outcome", rallies.ending, len(OUTCOMES)),
        ("policy", rallies.policy, len(header.policies)),
        ("pairing", rallies.pairing, len(header.pairings)),
        ("stroke", rallies.stroke, len(header.strokes)),
        ("position", rallies.waited, N_POSITIONS),
    ]
    for what, numbers, limit in ranges:
        most, least = (0, 0) if numbers is None or not len(numbers) else (int(np.max(numbers)), int(np.min(numbers)))
        if least < 0 or most >= limit:
            raise DamagedLogError(f"{what} {most if most >= limit else least} in a batch, expected less than {limit}")
    if (rallies.finished & ((rallies.winner > 1) | (rallies.endings != rallies.reason))).any():
        raise DamagedLogError("a rally that ended and has no winner, or another end than its last stroke")
    if (
        int(rallies.length.min()) < 0
        or (rallies.length[rallies.finished] < 1).any()
        or int(rallies.length.sum(dtype=np.int64)) != len(rallies.stroke)
    ):
        raise DamagedLogError("a rally without strokes")
    if rallies.hurried[rallies.first_stroke[:-1][rallies.length > 0]].any():
        raise DamagedLogError("a server who is hurried")


def message_of_chunk(body: bytes) -> Message:
    """The one message of a chunk."""
    chunk = Chunk.read(_stream(body))
    if chunk.compression != "zstd" or chunk.uncompressed_size > MAX_CHUNK:
        raise DamagedLogError(f"a chunk of {chunk.uncompressed_size} bytes packed as {chunk.compression!r}")
    # Decompression allocates the size in the frame; an unchecked size would let a damaged file use all memory.
    if zstandard.get_frame_parameters(chunk.data).content_size != chunk.uncompressed_size:
        raise DamagedLogError("the sizes in a chunk disagree")
    data = zstandard.decompress(chunk.data)
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamagedLogError("the checksum of a chunk does not match")
    found = [*itertools.islice(_records(data), _MAX_RECORDS + 1)]
    messages = [Message.read(_stream(inner), len(inner)) for opcode, inner in found if opcode == Opcode.MESSAGE]
    if len(found) > _MAX_RECORDS or len(messages) != 1:
        raise DamagedLogError(f"{len(messages)} messages in the first {len(found)} records of a chunk, expected 1")
    return messages[0]


def _records(data: bytes | mmap.mmap, at: int = 0) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record; the official readers stop at one that they cannot decode, and trust the sizes in it."""
    while at < len(data):
        opcode, length = FRAME.unpack(data[at : at + FRAME.size].ljust(FRAME.size, b"\xff"))
        at += FRAME.size
        if not opcode or length > len(data) - at:  # a power failure can leave zeros
            raise DamagedLogError("a record is cut off")
        yield opcode, data[at : at + length]
        at += length


def _record(data: bytes | mmap.mmap, at: int, kind: Opcode) -> bytes:
    opcode, body = next(_records(data, at), (0, b""))
    if opcode != kind:
        raise DamagedLogError(f"no {kind.name} record at byte {at}")
    return body


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(body))


def unfinished(path: Path) -> Path:
    """Name of a file until it is finished."""
    return path.with_name(f"{path.name}.part")


def set_aside(path: Path) -> Path:
    """Name of a file while a resumed writer copies from it."""
    return path.with_name(f"{path.name}.part.old")


def files_of(log: Path) -> list[Path]:
    """The existing files of a log: set aside by a killed resumption, finished, and unfinished."""
    return [file for file in (set_aside(log), log, unfinished(log)) if file.exists()]


@contextlib.contextmanager
def damage(path: Path, remedy: str | None = None) -> Iterator[None]:
    """Turn errors of decoding into a :class:`RecordingError` with the name of the file and a remedy; None: :func:`advice`."""
    try:
        yield
    except DamagedLogError as error:
        raise DamagedLogError(f"{path}: damaged: {error}; {remedy or advice(path)}") from error
    except RecordingError as error:
        raise type(error)(f"{path}: {error}") from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({problem(error)})") from error
    except _UNDECODABLE as error:
        raise DamagedLogError(f"{path}: damaged: {type(error).__name__}: {error}; {remedy or advice(path)}") from error


def advice(path: Path) -> str:
    """Advice for the owner of a damaged log."""
    return f"save its undamaged batches with `{command('recording', 'recover', str(path))}`"


def open_log(path: Path) -> tuple[mmap.mmap, LogHeader, int]:
    """Content of a rally log, finished or not, which is read where it is used, its header, and the offset of the next record."""
    with damage(path, "no rally can be read without its header, restore a copy of the file"):
        with open_file(path) as file:
            if not os.fstat(file.fileno()).st_size:
                raise OtherFileError("no rally log: it is empty")
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return data, *_read_header(data)


def _read_header(data: mmap.mmap) -> tuple[LogHeader, int]:
    if data[: len(_MAGIC)] != _MAGIC:
        raise OtherFileError("no rally log: it does not start as an MCAP file does")
    start = _record(data, len(_MAGIC), Opcode.HEADER)
    profile = Header.read(_stream(start)).profile
    if profile != _PROFILE:
        raise OtherFileError(f"no rally log: an MCAP file of profile {profile!r}, expected {_PROFILE!r}")
    at = len(_MAGIC) + FRAME.size + len(start)
    about = _record(data, at, Opcode.METADATA)
    metadata = Metadata.read(_stream(about))
    if metadata.name != _METADATA:
        raise DamagedLogError("the header is missing")
    return LogHeader.from_metadata(metadata.metadata), at + FRAME.size + len(about)


class LogFile:
    """A finished rally log of B batches.

    Attributes:
        size: length of the file [bytes].
        first_rally: ``[B]`` int64 number of the first rally of each batch.
        rallies, strokes: ``[B]`` int64 numbers of them in each batch.
        first_match, last_match: ``[B]`` uint64 least and greatest 2^32 x pairing + match of each batch.
    """

    def __init__(self, path: Path) -> None:
        """Open a file."""
        self.path = path
        self._data, self.header, _ = open_log(path)
        self.size, self.close = len(self._data), self._data.close
        with damage(path):
            self._read_index()

    @property
    def end(self) -> int:
        """Number of the last rally plus one."""
        return int(self.first_rally[-1] + self.rallies[-1]) if len(self.rallies) else 0

    def batch(self, i: int) -> tuple[int, Rallies]:
        """Number of the first rally, and the rallies, of the i-th batch."""
        with damage(self.path):
            first, rallies = decode(message_of_chunk(_record(self._data, int(self._offset[i]), Opcode.CHUNK)), self.header)
            if (first, len(rallies), len(rallies.stroke)) != (self.first_rally[i], self.rallies[i], self.strokes[i]):
                raise DamagedLogError(f"batch {i} is not what the index says")
            return first, rallies

    def check_data(self) -> None:
        """Verify the checksum of all bytes before the summary."""
        with damage(self.path):
            end = self._summary - len(_DATA_END) - 4
            checksum = zlib.crc32(memoryview(self._data)[:end])
            if self._data[end : self._summary] != _DATA_END + checksum.to_bytes(4, "little"):
                raise DamagedLogError("the checksum of its data does not match")

    def _read_index(self) -> None:
        end = self._data[-_END:]
        if not (end.startswith(_FOOTER) and end.endswith(_MAGIC)):
            raise DamagedLogError("it was not closed")
        footer = Footer.read(_stream(end[len(_FOOTER) :]))
        self._summary = footer.summary_start
        summary = self._data[self._summary : -len(_MAGIC)]
        if zlib.crc32(summary[:-4]) != footer.summary_crc:
            raise DamagedLogError("the checksum of its summary does not match")
        found = [AttachmentIndex.read(_stream(body)) for opcode, body in _records(summary) if opcode == Opcode.ATTACHMENT_INDEX]
        places = [attachment.offset for attachment in found if attachment.name == _INDEX]
        if len(places) != 1:
            raise DamagedLogError("the index of its rallies is missing")
        body = _record(self._data, places[0], Opcode.ATTACHMENT)
        if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
            raise DamagedLogError("the checksum of its index does not match")
        index = _read_arrow(Attachment.read(_stream(body)).data)
        if index.schema != _INDEX_SCHEMA:
            raise DamagedLogError("its index has other columns than this version has")
        columns = {name: index.column(name).to_numpy() for name in index.schema.names}
        counts = [columns[name] for name in ("first_rally", "rallies", "strokes", "offset")]
        if any((column > np.iinfo(np.int64).max >> 1).any() for column in counts):
            raise DamagedLogError("its index holds numbers that no log reaches")
        self.first_rally, self.rallies, self.strokes, self._offset = (column.astype(np.int64) for column in counts)
        self.first_match: U64 = columns["first_match"]
        self.last_match: U64 = columns["last_match"]
        ends = self.first_rally + self.rallies
        if (self.first_rally < np.r_[0, ends[:-1]][: len(ends)]).any() or (self.rallies < 1).any():
            raise DamagedLogError("its index is out of order")


class LogFileWriter:
    """Writes a log; each call passes what it writes to the operating system, or raises an OSError."""

    size: int  # bytes written so far
    rallies: int  # number of the last rally plus one

    def __init__(self, file: BinaryIO, header: LogHeader) -> None:
        """Write the header."""
        self._file = file
        self._index: list[tuple[int, ...]] = []
        self.rallies = 0
        self._mcap = Writer(file, chunk_size=1, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._mcap.start(profile=_PROFILE, library=header.software)
        self._mcap.add_metadata(_METADATA, header.to_metadata())
        columns = arrow_schema(len(header.strokes), header.columns).serialize().to_pybytes()
        schema = self._mcap.register_schema("shuttle_marl.Rallies", "arrow", columns)
        self._channel = self._mcap.register_channel("/rallies", "arrow_stream", schema)
        self._flush()

    def write(self, first: int, data: bytes | memoryview, rallies: Rallies) -> None:
        """Write one batch, encoded by :func:`encode`, whose first rally has a number not below :attr:`rallies`."""
        match = rallies.pairing.astype(np.uint64) << np.uint64(32) | rallies.match
        row = (first, len(rallies), len(rallies.stroke), self.size, int(match.min()), int(match.max()))
        # One message per chunk, so a kill loses at most the batch that is being written.
        self._mcap.add_message(self._channel, first * _RALLY_TIME, cast(bytes, data), first * _RALLY_TIME, len(self._index))
        self._flush()
        self._index.append(row)
        self.rallies = first + len(rallies)

    def finish(self) -> None:
        """Write the index."""
        columns = np.array(self._index, np.uint64).reshape(-1, len(_INDEX_SCHEMA)).T
        index = _arrow_stream(pa.RecordBatch.from_arrays([pa.array(column) for column in columns], schema=_INDEX_SCHEMA))
        self._mcap.add_attachment(
            0, self.rallies * _RALLY_TIME, _INDEX, "application/vnd.apache.arrow.stream", index.to_pybytes()
        )
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self._flush()

    def _flush(self) -> None:
        self._file.flush()
        self.size = self._file.tell()


def salvage(path: Path) -> tuple[LogHeader, Iterator[tuple[int, bytes, Rallies]]]:
    """Header of a log file in any condition, and the number, message and rallies of every undamaged batch, in order."""
    data, header, start = open_log(path)
    return header, _whole_batches(_records(data, start), header)


def _whole_batches(found: Iterator[tuple[int, bytes]], header: LogHeader) -> Iterator[tuple[int, bytes, Rallies]]:
    done = 0
    with contextlib.suppress(DamagedLogError):  # the last record is cut off
        for opcode, body in found:
            if opcode != Opcode.CHUNK:
                continue
            try:
                message = message_of_chunk(body)
                first, rallies = decode(message, header)
            except (DamagedLogError, *_UNDECODABLE):
                continue
            if first >= done:
                yield first, message.data, rallies
                done = first + len(rallies)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recovery:
    """Result of :func:`recover`."""

    path: Path
    rallies: int
    strokes: int
    lost: int  # number of rallies known to be lost between those recovered; the number lost after the last one is unknown


def recover(source: Path, target: Path | None = None) -> Recovery:
    """Write a finished file with every undamaged batch of a damaged or unfinished one; ``source`` is not changed.

    Args:
        source: a log in any condition, ``FILE.part`` included.
        target: the new file; must not exist. Default, in the same folder: ``FILE`` for ``FILE.part``, else
            ``NAME.recovered.mcap``.

    Raises:
        RecordingError: the source is not a rally log, or its header or all of its batches are damaged; or the target exists or
            cannot be written. No file is left behind.
    """
    if target is None:
        target = source.with_suffix("") if source.suffix == ".part" else source.with_name(f"{source.stem}.recovered.mcap")
    header, batches = salvage(source)
    rallies = strokes = lost = 0
    try:
        if target.exists():
            raise FileExistsError(errno.EEXIST, "exists already")
        with replacing(target, new=True) as file:
            log = LogFileWriter(file, header)
            for first, data, batch in batches:
                lost += first - log.rallies
                log.write(first, data, batch)
                rallies, strokes = rallies + len(batch), strokes + len(batch.stroke)
            if not rallies:
                raise RecordingError(f"{source}: nothing could be recovered: all its batches of rallies are damaged")
            log.finish()
    except (OSError, FileWriteError) as error:
        told = f"{target}: cannot be written ({problem(error.__cause__ or error)})"
        raise RecordingError(f"{told}; {source} is unchanged: free disk space, or choose another file") from error
    return Recovery(path=target, rallies=rallies, strokes=strokes, lost=lost)


def recoverable_files(folder: Path) -> list[Path]:
    """Unfinished files of a folder without a finished file of the same name. Raises RecordingError: there are none."""
    found = [path for path in unfinished_files(folder) if not path.with_suffix("").exists()]
    if not found:
        raise RecordingError(f"{folder}: holds no unfinished rally log; name a damaged file to recover that")
    return found


def unfinished_files(path: Path) -> list[Path]:
    """Unfinished files of the logs in a folder, or of the log at a path."""
    if path.is_dir():
        return sorted(path.glob(f"*{unfinished(Path(SUFFIX)).name}"))
    return [unfinished(path)] if unfinished(path).exists() else []
