"""One file of a rally log: its name, and how it is read.

The files are ``NAME.mcap``, and when that is full ``NAME.1.mcap``, ``NAME.2.mcap``, …
"""

import os
import re
import zlib
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex

from shuttle_marl.arrays import U64
from shuttle_marl.files import open_file
from shuttle_marl.rally.record import Rallies
from shuttle_marl.recording.container import (
    INDEX_NAME,
    INDEX_SCHEMA,
    damage,
    decode,
    message_of_chunk,
    read_header,
    read_record,
    read_summary,
    stream,
)
from shuttle_marl.recording.schema import DamagedLogError, RecordingError

SUFFIX: Final = ".mcap"
_UNFINISHED: Final = ".part"
_SET_ASIDE: Final = ".part.old"


def part_path(path: Path, number: int) -> Path:
    """The file of part ``number`` of the log at ``path``."""
    return path.with_name(f"{path.stem}.{number}{path.suffix}") if number else path


def unfinished(path: Path) -> Path:
    """Name of a file until it is closed."""
    return path.with_name(path.name + _UNFINISHED)


def set_aside(path: Path) -> Path:
    """Name of a file while a resumed writer copies from it."""
    return path.with_name(path.name + _SET_ASIDE)


def part_number(path: Path, log: Path) -> int | None:
    """Which part of ``log`` this file is, finished or not; None: none of it."""
    name = path.name.removesuffix(_SET_ASIDE).removesuffix(_UNFINISHED)
    if name == log.name:
        return 0
    found = re.fullmatch(re.escape(log.stem) + r"\.([1-9]\d{0,8})" + re.escape(log.suffix), name)
    return int(found[1]) if found and path.parent == log.parent else None


def is_further_part(path: Path) -> bool:
    """Whether a file is named as a part behind the first one is."""
    return re.search(r"\.[1-9]\d{0,8}$", path.stem) is not None


def existing_parts(log: Path) -> list[int]:
    """Numbers of the parts of a log of which there is a file, finished or not."""
    paths = log.parent.iterdir() if log.parent.is_dir() else ()
    return sorted({number for path in paths if (number := part_number(path, log)) is not None})


class LogFile:
    """A finished file of a rally log.

    Attributes:
        path: the file.
        header: what all its rallies share.
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
            OtherFileError: it is no rally log.
            RecordingError: it cannot be read, or is of another version.
            DamagedLogError: it was cut off or changed; says how to save what is whole.
        """
        self.path = path
        with damage(path):
            self._file = open_file(path)
        try:
            with damage(path):
                self.size = os.fstat(self._file.fileno()).st_size
                self.header, _ = read_header(self._file, self.size)
                self._read_index()
        except RecordingError:
            self._file.close()
            raise

    @property
    def end(self) -> int:
        """Number behind that of the last rally."""
        return int(self.first_rally[-1] + self.rallies[-1]) if len(self.rallies) else self.header.first_rally

    def batch(self, i: int) -> tuple[int, Rallies]:
        """Number of the first rally, and the rallies, of the i-th batch.

        Raises:
            DamagedLogError: the batch does not fit its checksum or the index.
        """
        with damage(self.path):
            body = read_record(self._file, int(self._offset[i]), self.size, Opcode.CHUNK)
            first, rallies = decode(message_of_chunk(body), self.header)
            if (first, len(rallies), len(rallies.stroke)) != (self.first_rally[i], self.rallies[i], self.strokes[i]):
                raise DamagedLogError(f"batch {i} is not what the index says")
            return first, rallies

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read_index(self) -> None:
        summary = read_summary(self._file, self.size)
        attachments = [AttachmentIndex.read(stream(body)) for opcode, body in summary if opcode == Opcode.ATTACHMENT_INDEX]
        places = [attachment.offset for attachment in attachments if attachment.name == INDEX_NAME]
        if len(places) != 1:
            raise DamagedLogError("the index of its rallies is missing")
        body = read_record(self._file, places[0], self.size, Opcode.ATTACHMENT)
        if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
            raise DamagedLogError("the checksum of its index does not fit")
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
