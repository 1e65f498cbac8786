"""One file of a rally log: its name, its MCAP records, and how it is read.

The files are ``NAME.mcap``, and when that is full ``NAME.1.mcap``, ``NAME.2.mcap``, … Nothing is trusted before its checksum was
verified. The records (https://mcap.dev/spec) are those of the official ``mcap`` library.
"""

import contextlib
import mmap
import os
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Footer, Header, Metadata

from shuttle_marl.base.arrays import U64
from shuttle_marl.base.errors import command
from shuttle_marl.base.files import open_file, problem
from shuttle_marl.game.rally import Rallies
from shuttle_marl.recording.chunks import FRAME, UNDECODABLE, decode, message_of_chunk, read_arrow, record, records, stream
from shuttle_marl.recording.header import DamagedLogError, LogHeader, OtherFileError, RecordingError

PROFILE: Final = "shuttle_marl"
MAGIC: Final = b"\x89MCAP0\r\n"
_DATA_END: Final = FRAME.pack(Opcode.DATA_END, 4)
_FOOTER: Final = FRAME.pack(Opcode.FOOTER, 20)
_END: Final = len(_FOOTER) + 20 + len(MAGIC)
"""Length of the footer, and of the magic bytes behind it."""
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
    except UNDECODABLE as error:
        raise DamagedLogError(f"{path}: damaged: {type(error).__name__}: {error}; {advice(path)}") from error


def advice(path: Path) -> str:
    """Advice for the owner of a damaged log."""
    return f"save its undamaged batches with `{command('recording', 'recover', str(path))}`"


def content_of(path: Path) -> mmap.mmap:
    """Content of a file, which is read where it is used.

    Raises:
        OSError: it cannot be opened, or is not a regular file.
        OtherFileError: it is empty.
    """
    with open_file(path) as file:
        if not os.fstat(file.fileno()).st_size:
            raise OtherFileError("no rally log: it is empty")
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def read_header(data: mmap.mmap) -> tuple[LogHeader, int]:
    """Header of a rally log, finished or not, and the offset of the next record.

    Raises:
        OtherFileError: not a rally log.
        RecordingError: a rally log of another version.
        DamagedLogError: the header is truncated or damaged.
    """
    if data[: len(MAGIC)] != MAGIC:
        raise OtherFileError("no rally log: it does not start as an MCAP file does")
    start = record(data, len(MAGIC), Opcode.HEADER)
    profile = Header.read(stream(start)).profile
    if profile != PROFILE:
        raise OtherFileError(f"no rally log: an MCAP file of profile {profile!r}, expected {PROFILE!r}")
    at = len(MAGIC) + FRAME.size + len(start)
    about = record(data, at, Opcode.METADATA)
    metadata = Metadata.read(stream(about))
    if metadata.name != METADATA:
        raise DamagedLogError("the header is missing")
    return LogHeader.from_metadata(metadata.metadata), at + FRAME.size + len(about)


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
        with damage(path):
            self._data = content_of(path)
            self.size, self.close = len(self._data), self._data.close
            self.header, _ = read_header(self._data)
            self._read_index()

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
            first, rallies = decode(message_of_chunk(record(self._data, int(self._offset[i]), Opcode.CHUNK)), self.header)
            if (first, len(rallies), len(rallies.stroke)) != (self.first_rally[i], self.rallies[i], self.strokes[i]):
                raise DamagedLogError(f"batch {i} is not what the index says")
            return first, rallies

    def check_data(self) -> None:
        """Verify the checksum of all bytes before the summary.

        Raises:
            DamagedLogError: it does not match.
        """
        with damage(self.path):
            end = self._summary - len(_DATA_END) - 4
            checksum = zlib.crc32(memoryview(self._data)[:end])
            if self._data[end : self._summary] != _DATA_END + checksum.to_bytes(4, "little"):
                raise DamagedLogError("the checksum of its data does not match")

    def _read_index(self) -> None:
        end = self._data[-_END:]
        if not (end.startswith(_FOOTER) and end.endswith(MAGIC)):
            raise DamagedLogError("it was not closed")
        footer = Footer.read(stream(end[len(_FOOTER) :]))
        self._summary = footer.summary_start
        summary = self._data[self._summary : -len(MAGIC)]
        if zlib.crc32(summary[:-4]) != footer.summary_crc:
            raise DamagedLogError("the checksum of its summary does not match")
        found = [AttachmentIndex.read(stream(body)) for opcode, body in records(summary) if opcode == Opcode.ATTACHMENT_INDEX]
        places = [attachment.offset for attachment in found if attachment.name == INDEX_NAME]
        if len(places) != 1:
            raise DamagedLogError("the index of its rallies is missing")
        body = record(self._data, places[0], Opcode.ATTACHMENT)
        if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
            raise DamagedLogError("the checksum of its index does not match")
        index = read_arrow(Attachment.read(stream(body)).data)
        if index.schema != INDEX_SCHEMA:
            raise DamagedLogError("its index has other columns than this version has")
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
