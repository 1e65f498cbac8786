"""The parts of an MCAP file that a rally log uses, read defensively: nothing is trusted before its checksum was seen.

Format: https://mcap.dev/spec. The records are decoded by the official ``mcap`` library; framing is done here, because its
readers give up on a file that was cut off, and believe every length they read.
"""

import contextlib
import io
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, Final

import lz4.frame
import numpy as np
import pyarrow as pa
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, Footer, Header, Message, Metadata
from mcap.writer import CompressionType

from shuttle_marl.files import problem
from shuttle_marl.rally.record import PER_STROKE, Rallies
from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.schema import (
    VERSION,
    DamagedLogError,
    OtherFileError,
    RecordingError,
    arrow_schema,
    from_arrow,
    to_arrow,
)

PROFILE: Final = "shuttle_marl"
MAGIC: Final = b"\x89MCAP0\r\n"
FRAME: Final = struct.Struct("<BQ")
"""Head of every record: opcode and length of the body."""
FOOTER_LENGTH: Final = 20
TOPIC: Final = "/rallies"
METADATA: Final = "shuttle_marl.rally_log"
"""Name of the MCAP metadata record that holds the header."""
RALLY_TIME: Final = 1_000_000
"""Log time that a rally takes [ns]: the log time of a batch is the number of its first rally times this."""
INDEX_NAME: Final = "rally_index"
INDEX_SCHEMA: Final = pa.schema(
    [
        pa.field(name, pa.uint64(), nullable=False)
        for name in ("first_rally", "rallies", "strokes", "offset", "first_match", "last_match")
    ]
)
"""Columns of the attachment ``rally_index``, a row a batch: number of its first rally, how many rallies and strokes it holds,
the byte at which its chunk begins, and the least and greatest 2^32 x pairing + match in it."""
MAX_CHUNK: Final = 1 << 28
"""Limit of a batch of rallies, unpacked [bytes]; a file with a larger one is damaged."""


UNDECODABLE: Final = (
    struct.error,
    McapError,
    pa.ArrowException,
    zstandard.ZstdError,
    ValueError,
    LookupError,
    OverflowError,
    MemoryError,
    RuntimeError,
)
"""Errors that the decoders raise for input that they do not expect."""


@contextlib.contextmanager
def damage(path: Path) -> Iterator[None]:
    """Turn any error of decoding into a :class:`RecordingError` that names the file and says what to do."""
    try:
        yield
    except DamagedLogError as error:
        raise DamagedLogError(f"{path}: damaged: {error}; {advice(path)}") from error
    except OtherFileError as error:
        raise OtherFileError(f"{path}: {error}") from error
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({problem(error)})") from error
    except UNDECODABLE as error:
        raise DamagedLogError(f"{path}: damaged: {type(error).__name__}: {error}; {advice(path)}") from error


def advice(path: Path) -> str:
    """Advice for the owner of a damaged log."""
    return f"save its undamaged batches with `python -m shuttle_marl.recording recover {path}`"


def stream(body: bytes) -> ReadDataStream:
    """The body of a record, for the decoders of ``mcap.records``."""
    return ReadDataStream(io.BytesIO(body))


def read_record(file: BinaryIO, offset: int, size: int, expected: Opcode) -> bytes:
    """Body of the record at ``offset`` of a file of ``size`` bytes.

    Raises:
        DamagedLogError: another kind of record stands there, or it reaches beyond the end.
    """
    if not 0 <= offset <= size - FRAME.size:
        raise DamagedLogError(f"no {expected.name} record at byte {offset}")
    file.seek(offset)
    opcode, length = FRAME.unpack(file.read(FRAME.size))
    if opcode != expected or length > size - offset - FRAME.size:
        raise DamagedLogError(f"no whole {expected.name} record at byte {offset}")
    return file.read(length)


def records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of the records in ``data``, which must hold nothing else.

    Raises:
        DamagedLogError: the last one is cut off.
    """
    at = 0
    while at < len(data):
        if at + FRAME.size > len(data):
            raise DamagedLogError("a record is cut off")
        opcode, length = FRAME.unpack_from(data, at)
        at += FRAME.size
        if length > len(data) - at:
            raise DamagedLogError("a record is cut off")
        yield opcode, data[at : at + length]
        at += length


def compression(header: LogHeader) -> CompressionType:
    """The compression of the chunks of a log.

    LZ4 where training records figures of single strokes: there are millions a second, and it takes half of the time of zstd.
    """
    return CompressionType.LZ4 if set(PER_STROKE) & set(header.columns) else CompressionType.ZSTD


_SAYS: Final[dict[str, Callable[[bytes], int]]] = {
    "zstd": lambda packed: zstandard.get_frame_parameters(packed).content_size,
    "lz4": lambda packed: lz4.frame.get_frame_info(packed)["content_size"],
}
"""The number of bytes that a frame says it unpacks to, by the name that MCAP gives the compression."""
_UNPACK: Final[dict[str, Callable[[bytes, int], bytes]]] = {
    "zstd": lambda packed, size: zstandard.ZstdDecompressor().decompress(packed, max_output_size=size),
    "lz4": lambda packed, size: lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size),
}
"""What unpacks a frame to so many bytes at most."""


def message_of_chunk(body: bytes) -> Message:
    """The one message of a chunk.

    Raises:
        DamagedLogError: the checksum or the sizes do not fit, or it is no chunk of a rally log.
    """
    chunk = Chunk.read(stream(body))
    if chunk.compression not in _UNPACK or chunk.uncompressed_size > MAX_CHUNK:
        raise DamagedLogError(f"a chunk of {chunk.uncompressed_size} bytes packed as {chunk.compression!r}")
    # The frame says how much will be unpacked; to believe it unseen would let a damaged file take all memory.
    if _SAYS[chunk.compression](chunk.data) != chunk.uncompressed_size:
        raise DamagedLogError("the sizes in a chunk disagree")
    data = _UNPACK[chunk.compression](chunk.data, chunk.uncompressed_size)
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamagedLogError("the checksum of a chunk does not fit")
    messages = [Message.read(stream(inner), len(inner)) for opcode, inner in records(data) if opcode == Opcode.MESSAGE]
    if len(messages) != 1:
        raise DamagedLogError(f"{len(messages)} messages in a chunk, expected 1")
    return messages[0]


def read_summary(file: BinaryIO, size: int) -> list[tuple[int, bytes]]:
    """The records of the summary section, after its checksum was verified.

    Raises:
        DamagedLogError: the file was not closed, or its end is damaged.
    """
    tail = FRAME.size + FOOTER_LENGTH + len(MAGIC)
    if size < len(MAGIC) + tail:
        raise DamagedLogError("too short for a rally log")
    file.seek(size - tail)
    end = file.read(tail)
    if not end.endswith(MAGIC) or FRAME.unpack_from(end) != (Opcode.FOOTER, FOOTER_LENGTH):
        raise DamagedLogError("it was not closed")
    footer = Footer.read(stream(end[FRAME.size :]))
    if not len(MAGIC) <= footer.summary_start <= size - tail:
        raise DamagedLogError("it has no summary")
    file.seek(footer.summary_start)
    summary = file.read(size - tail - footer.summary_start)
    if zlib.crc32(end[: FRAME.size + FOOTER_LENGTH - 4], zlib.crc32(summary)) != footer.summary_crc:
        raise DamagedLogError("the checksum of its summary does not fit")
    return list(records(summary))


def read_header(file: BinaryIO, size: int) -> tuple[LogHeader, int]:
    """The header of a rally log, finished or not, and the byte behind it.

    Raises:
        OtherFileError: this is no rally log.
        RecordingError: it is one of another version.
        DamagedLogError: the header is cut off or damaged.
    """
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise OtherFileError("no rally log: it does not start as an MCAP file does")
    start = read_record(file, len(MAGIC), size, Opcode.HEADER)
    profile = Header.read(stream(start)).profile
    if profile != PROFILE:
        raise OtherFileError(f"no rally log: an MCAP file of profile {profile!r}, expected {PROFILE!r}")
    at = len(MAGIC) + FRAME.size + len(start)
    body = read_record(file, at, size, Opcode.METADATA)
    metadata = Metadata.read(stream(body))
    if metadata.name != METADATA:
        raise DamagedLogError("the header is missing")
    return LogHeader.from_metadata(metadata.metadata), at + FRAME.size + len(body)


def encode(first: int, rallies: Rallies, n_strokes: int) -> memoryview:
    """The message of a batch whose first rally has number ``first``."""
    batch = to_arrow(rallies, n_strokes)
    batch = batch.replace_schema_metadata({"version": str(VERSION), "first_rally": str(first)})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    return memoryview(sink.getvalue())


def decode(message: Message, header: LogHeader) -> tuple[int, Rallies]:
    """Number of the first rally, and the rallies; every number in them points at something.

    Raises:
        DamagedLogError: the message holds something else.
        pa.ArrowException: it holds no Arrow stream.
    """
    batch = _arrow_batch(message.data)
    metadata = batch.schema.metadata or {}
    if (
        not batch.schema.equals(arrow_schema(len(header.strokes), header.columns))
        or metadata.get(b"version") != str(VERSION).encode()
    ):
        raise DamagedLogError(f"a batch with other columns than version {VERSION} has")
    first = int(metadata.get(b"first_rally", b"-1"))
    if first < 0 or first * RALLY_TIME != message.log_time or not batch.num_rows:
        raise DamagedLogError("a batch without a place in the log")
    rallies = from_arrow(batch)
    _check_numbers(rallies, header)
    return first, rallies


def _arrow_batch(data: bytes) -> pa.RecordBatch:
    try:
        with pa.ipc.open_stream(data) as reader:
            batches = list(reader)
    except OSError as error:  # of Arrow, about the bytes: no file is involved
        raise DamagedLogError(f"a batch that is no Arrow stream ({error})") from error
    if len(batches) != 1:
        raise DamagedLogError(f"{len(batches)} Arrow batches in a message, expected 1")
    batches[0].validate(full=True)
    return batches[0]


def _check_numbers(rallies: Rallies, header: LogHeader) -> None:
    for what, numbers, limit in (
        ("seat", rallies.server, 2),
        ("seat", rallies.winner, 2),
        ("reason", rallies.reason, 2),
        ("policy", rallies.policy, len(header.policies)),
        ("pairing", rallies.pairing, len(header.pairings)),
        ("stroke", rallies.stroke, len(header.strokes)),
    ):
        most = int(np.max(numbers))
        if most >= limit:
            raise DamagedLogError(f"{what} {most} in a batch, expected less than {limit}")
    if int(rallies.length.min()) < 1 or int(rallies.length.sum(dtype=np.int64)) != len(rallies.stroke):
        raise DamagedLogError("a rally without strokes")
