"""The parts of an MCAP file that a rally log uses, read defensively: nothing is trusted before its checksum was seen.

Format: https://mcap.dev/spec. The records are decoded by the official ``mcap`` library; framing is done here, because its
readers give up on a file that was cut off, and believe every length they read.
"""

import contextlib
import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

import pyarrow as pa
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, Footer, Message

from shuttle_marl.recording.schema import DamagedLogError, OtherFileError, RecordingError

PROFILE: Final = "shuttle_marl"
MAGIC: Final = b"\x89MCAP0\r\n"
FRAME: Final = struct.Struct("<BQ")
"""Head of every record: opcode and length of the body."""
FOOTER_LENGTH: Final = 20
TOPIC: Final = "/rallies"
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
"""No batch of rallies is as large as this, unpacked [bytes]; a file that says so is damaged."""


UNDECODABLE: Final = (
    struct.error,
    McapError,
    pa.ArrowException,
    zstandard.ZstdError,
    ValueError,
    LookupError,
    OverflowError,
    MemoryError,
)
"""What the decoders raise when they are given anything but what they expect."""


@contextlib.contextmanager
def damage(path: Path) -> Iterator[None]:
    """Turn whatever goes wrong in decoding into a :class:`RecordingError` that names the file and the way out."""
    try:
        yield
    except DamagedLogError as error:
        raise DamagedLogError(f"{path}: damaged: {error}; {advice(path)}") from error
    except OtherFileError as error:
        raise OtherFileError(f"{path}: {error}") from error
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UNDECODABLE as error:
        raise DamagedLogError(f"{path}: damaged: {type(error).__name__}: {error}; {advice(path)}") from error


def advice(path: Path) -> str:
    """What to do about a damaged log."""
    return f"save what is whole with `python -m shuttle_marl.recording recover {path}`"


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


def message_of_chunk(body: bytes) -> Message:
    """The one message of a chunk.

    Raises:
        DamagedLogError: the checksum or the sizes do not fit, or it is no chunk of a rally log.
    """
    chunk = Chunk.read(stream(body))
    if chunk.compression != "zstd" or chunk.uncompressed_size > MAX_CHUNK:
        raise DamagedLogError(f"a chunk of {chunk.uncompressed_size} bytes packed as {chunk.compression!r}")
    # The frame says how much will be unpacked; to believe it unseen would let a damaged file take all memory.
    if zstandard.get_frame_parameters(chunk.data).content_size != chunk.uncompressed_size:
        raise DamagedLogError("the sizes in a chunk disagree")
    data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.uncompressed_size)
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
