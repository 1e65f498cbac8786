"""One file of a rally log: its name, its MCAP records, and how it is read.

The files are ``NAME.mcap``, and when that is full ``NAME.1.mcap``, ``NAME.2.mcap``, … Nothing is trusted before its checksum was
verified. The records (https://mcap.dev/spec) are decoded by the official ``mcap`` library; framing is done here, because its
readers fail on truncated files and trust every length that they read.
"""

import contextlib
import os
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
import pyarrow as pa
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, DataEnd, Footer, Header, Metadata

from shuttle_marl.base.arrays import U64
from shuttle_marl.base.errors import command
from shuttle_marl.base.files import open_file, problem
from shuttle_marl.game.rally.record import Rallies
from shuttle_marl.recording.chunks import FRAME, UNDECODABLE, decode, message_of_chunk, records, stream
from shuttle_marl.recording.header import DamagedLogError, LogHeader, OtherFileError, RecordingError

PROFILE: Final = "shuttle_marl"
MAGIC: Final = b"\x89MCAP0\r\n"
FOOTER_LENGTH: Final = 20
TOPIC: Final = "/rallies"
METADATA: Final = "shuttle_marl.rally_log"
"""Name of the MCAP metadata record with the header."""
INDEX_NAME: Final = "rally_index"
INDEX_SCHEMA: Final = pa.schema(
    [
        pa.field(name, pa.uint64(), nullable=False)
        for name in ("first_rally", "rallies", "strokes", "offset", "first_match", "last_match")
    ]
)
"""Columns of the attachment ``rally_index``, one row per batch: number of its first rally, numbers of its rallies and strokes,
offset of its chunk [bytes], and the least and greatest 2^32 x pairing + match in it."""
SUFFIX: Final = ".mcap"
_BLOCK: Final = 1 << 20
_UNFINISHED: Final = ".part"
_SET_ASIDE: Final = ".part.old"


def part_path(path: Path, number: int) -> Path:
    """The file of part ``number`` of the log at ``path``."""
    return path.with_name(f"{path.stem}.{number}{path.suffix}") if number else path


def unfinished(path: Path) -> Path:
    """Name of a file until it is finished."""
    return path.with_name(path.name + _UNFINISHED)


def set_aside(path: Path) -> Path:
    """Name of a file while a resumed writer copies from it."""
    return path.with_name(path.name + _SET_ASIDE)


def part_number(path: Path, log: Path) -> int | None:
    """Number of the part of ``log`` in a file, finished or not; None: not a part of it."""
    name = path.name.removesuffix(_SET_ASIDE).removesuffix(_UNFINISHED)
    if name == log.name:
        return 0
    found = re.fullmatch(re.escape(log.stem) + r"\.([1-9]\d{0,8})" + re.escape(log.suffix), name)
    return int(found[1]) if found and path.parent == log.parent else None


def is_further_part(path: Path) -> bool:
    """Whether a file has the name of a part after the first one."""
    return re.search(r"\.[1-9]\d{0,8}$", path.stem) is not None


def existing_parts(log: Path) -> list[int]:
    """Numbers of the existing parts of a log, finished or not."""
    paths = log.parent.iterdir() if log.parent.is_dir() else ()
    return sorted({number for path in paths if (number := part_number(path, log)) is not None})


@contextlib.contextmanager
def damage(path: Path) -> Iterator[None]:
    """Turn errors of decoding into a :class:`RecordingError` with the name of the file and a remedy."""
    try:
        yield
    except DamagedLogError as error:
        raise DamagedLogError(f"{path}: damaged: {error}; {advice(path)}") from error
    except RecordingError as error:
        raise type(error)(f"{path}: {error}") from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({problem(error)})") from error
    except MemoryError as error:  # a damaged length may ask for any memory
        reason = f"there is not enough memory to read it, unless it is damaged ({error})"
        raise RecordingError(f"{path}: {reason}; use a machine with more memory, or {advice(path)}") from error
    except UNDECODABLE as error:
        raise DamagedLogError(f"{path}: damaged: {type(error).__name__}: {error}; {advice(path)}") from error


def advice(path: Path) -> str:
    """Advice for the owner of a damaged log."""
    return f"save its undamaged batches with `{command('recording', 'recover', str(path))}`"


def read_record(file: BinaryIO, offset: int, size: int, expected: Opcode) -> bytes:
    """Body of the record at ``offset`` of a file of ``size`` bytes.

    Raises:
        DamagedLogError: another kind of record, or a truncated one.
    """
    if not 0 <= offset <= size - FRAME.size:
        raise DamagedLogError(f"no {expected.name} record at byte {offset}")
    file.seek(offset)
    opcode, length = FRAME.unpack(file.read(FRAME.size))
    if opcode != expected or length > size - offset - FRAME.size:
        raise DamagedLogError(f"no whole {expected.name} record at byte {offset}")
    return file.read(length)


def read_summary(file: BinaryIO, size: int) -> tuple[int, list[tuple[int, bytes]]]:
    """Offset and records of the summary section, with a verified checksum.

    Raises:
        DamagedLogError: the file was not finished, or its end is damaged.
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
        raise DamagedLogError("the checksum of its summary does not match")
    return footer.summary_start, list(records(summary))


def read_header(file: BinaryIO, size: int) -> tuple[LogHeader, int]:
    """Header of a rally log, finished or not, and the offset of the next record.

    Raises:
        OtherFileError: not a rally log.
        RecordingError: a rally log of another version.
        DamagedLogError: the header is truncated or damaged.
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


class LogFile:
    """A finished file of a rally log.

    Attributes:
        size: length of the file [bytes].
        first_rally: ``[B]`` int64 number of the first rally of each batch, counted from the start of the log.
        rallies: ``[B]`` int64 number of rallies in each batch.
        strokes: ``[B]`` int64 number of strokes in each batch.
        first_match: ``[B]`` uint64 least 2^32 x pairing + match of each batch.
        last_match: ``[B]`` uint64 greatest of these.
    """

    def __init__(self, path: Path) -> None:
        """Open a file.

        Raises:
            OtherFileError: not a rally log.
            RecordingError: the file cannot be read, or has another version.
            DamagedLogError: the file is truncated or damaged.
        """
        self.path = path
        with damage(path), contextlib.ExitStack() as opened:
            self._file = opened.enter_context(open_file(path))
            self.size = os.fstat(self._file.fileno()).st_size
            self.header, _ = read_header(self._file, self.size)
            self._read_index()
            self.close = opened.pop_all().close

    @property
    def end(self) -> int:
        """Number of the last rally plus one."""
        return int(self.first_rally[-1] + self.rallies[-1]) if len(self.rallies) else self.header.first_rally

    def batch(self, i: int) -> tuple[int, Rallies]:
        """Number of the first rally, and the rallies, of the i-th batch.

        Raises:
            DamagedLogError: the batch does not match its checksum or the index.
        """
        with damage(self.path):
            body = read_record(self._file, int(self._offset[i]), self.size, Opcode.CHUNK)
            first, rallies = decode(message_of_chunk(body), self.header)
            if (first, len(rallies), len(rallies.stroke)) != (self.first_rally[i], self.rallies[i], self.strokes[i]):
                raise DamagedLogError(f"batch {i} is not what the index says")
            return first, rallies

    def check_data(self) -> None:
        """Verify the checksum of all bytes before the summary.

        Raises:
            DamagedLogError: it does not match.
        """
        with damage(self.path):
            # The record DataEnd, with the checksum as its body, ends where the summary starts.
            crc, remaining = 0, self._summary - FRAME.size - 4
            self._file.seek(0)
            while remaining > 0 and (block := self._file.read(min(_BLOCK, remaining))):
                crc, remaining = zlib.crc32(block, crc), remaining - len(block)
            if FRAME.unpack(self._file.read(FRAME.size)) != (Opcode.DATA_END, 4):
                raise DamagedLogError("its data does not end where the summary says")
            if DataEnd.read(stream(self._file.read(4))).data_section_crc != crc:
                raise DamagedLogError("the checksum of its data does not match")

    def _read_index(self) -> None:
        self._summary, summary = read_summary(self._file, self.size)
        attachments = [AttachmentIndex.read(stream(body)) for opcode, body in summary if opcode == Opcode.ATTACHMENT_INDEX]
        places = [attachment.offset for attachment in attachments if attachment.name == INDEX_NAME]
        if len(places) != 1:
            raise DamagedLogError("the index of its rallies is missing")
        body = read_record(self._file, places[0], self.size, Opcode.ATTACHMENT)
        if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
            raise DamagedLogError("the checksum of its index does not match")
        with pa.ipc.open_stream(Attachment.read(stream(body)).data) as reader:
            if reader.schema != INDEX_SCHEMA:
                raise DamagedLogError("its index has other columns than this version has")
            index = reader.read_all()
        index.validate(full=True)
        columns = {name: index.column(name).to_numpy() for name in index.schema.names}
        counts = [columns[name] for name in ("first_rally", "rallies", "strokes", "offset")]
        if any((column > np.iinfo(np.int64).max >> 1).any() for column in counts):
            raise DamagedLogError("its index holds numbers that no log reaches")
        self.first_rally, self.rallies, self.strokes, self._offset = (column.astype(np.int64) for column in counts)
        self.first_match: U64 = columns["first_match"]
        self.last_match: U64 = columns["last_match"]
        ends = self.first_rally + self.rallies
        if (self.first_rally < np.r_[self.header.first_rally, ends[:-1]][: len(ends)]).any() or (self.rallies < 1).any():
            raise DamagedLogError("its index is out of order")
