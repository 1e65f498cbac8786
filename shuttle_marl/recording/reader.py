"""Reads rally logs: by batch, by rally number, or as tables of rallies and strokes."""

import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, Header, Metadata

from shuttle_marl.recording.batch import decode
from shuttle_marl.recording.container import (
    FRAME,
    INDEX_NAME,
    MAGIC,
    damage,
    message_of_chunk,
    read_record,
    read_summary,
    stream,
)
from shuttle_marl.recording.header import METADATA, LogHeader
from shuttle_marl.recording.schema import DamagedLogError, Rallies, RecordingError, arrow_schema
from shuttle_marl.recording.tables import rally_rows, stroke_rows
from shuttle_marl.recording.writer import INDEX_SCHEMA, PROFILE
from shuttle_marl.stroke import Catalogue, UnknownStrokeError


def read_header(file: BinaryIO, size: int) -> tuple[LogHeader, int]:
    """The header of a rally log, finished or not, and the byte behind it.

    Raises:
        RecordingError: this is no rally log, or one of another version.
        DamagedLogError: the header is cut off or damaged.
    """
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise RecordingError("no rally log: it does not begin as an MCAP file does")
    start = read_record(file, len(MAGIC), size, Opcode.HEADER)
    profile = Header.read(stream(start)).profile
    if profile != PROFILE:
        raise RecordingError(f"no rally log: an MCAP file of profile {profile!r}, expected {PROFILE!r}")
    at = len(MAGIC) + FRAME.size + len(start)
    body = read_record(file, at, size, Opcode.METADATA)
    metadata = Metadata.read(stream(body))
    if metadata.name != METADATA:
        raise DamagedLogError("the header is missing")
    return LogHeader.from_metadata(metadata.metadata), at + FRAME.size + len(body)


class RallyLog:
    """A finished rally log; a context manager that closes the file.

    Attributes:
        path: the file.
        header: what all its rallies share.
        catalogue: the strokes, by number.
        size: length of the file [bytes].
        first_rally: ``[B]`` number of the first rally of each batch.
        rallies: ``[B]`` number of rallies in each batch.
        strokes: ``[B]`` number of strokes in each batch.
    """

    def __init__(self, path: Path) -> None:
        """Open a log.

        Raises:
            RecordingError: the file cannot be read or is no rally log of this version.
            DamagedLogError: it was cut off or changed; says how to save what is whole.
        """
        self.path = path
        with damage(path):
            self._file = path.open("rb")
        try:
            with damage(path):
                self.size = os.fstat(self._file.fileno()).st_size
                self.header, _ = read_header(self._file, self.size)
                self.catalogue = self._read_catalogue()
                self._read_index()
        except RecordingError:
            self._file.close()
            raise

    @property
    def n_rallies(self) -> int:
        """Number of rallies in the log."""
        return int(self.rallies.sum())

    @property
    def n_strokes(self) -> int:
        """Number of strokes in the log."""
        return int(self.strokes.sum())

    def batches(self) -> Iterator[tuple[int, Rallies]]:
        """Number of the first rally, and the rallies, of each batch in order.

        Raises:
            DamagedLogError: a batch does not fit its checksum or the index.
        """
        for i in range(len(self.first_rally)):
            yield self.batch(i)

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

    def rally(self, number: int) -> Rallies:
        """One rally by its number, as a single row.

        Raises:
            RecordingError: the log has no such rally.
            DamagedLogError: its batch does not fit its checksum or the index.
        """
        i = int(np.searchsorted(self.first_rally, number, side="right")) - 1
        if i < 0 or number >= self.first_rally[i] + self.rallies[i]:
            last = self.first_rally[-1] + self.rallies[-1] - 1 if len(self.first_rally) else -1
            raise RecordingError(f"{self.path}: no rally {number}; they are numbered up to {last}")
        first, rallies = self.batch(i)
        return rallies.part(number - first, number - first + 1)

    def numbers_of_match(self, pairing: int, match: int) -> npt.NDArray[np.int64]:
        """Numbers of the rallies of one match, in order; empty if the log has none.

        Raises:
            DamagedLogError: a batch does not fit its checksum or the index.
        """
        # Batches are in the order of pairing and match, so a match begins at the latest in the last batch not after it.
        place = self._pairing.astype(np.int64) << 32 | self._match
        wanted = pairing << 32 | match
        found = [np.empty(0, dtype=np.int64)]
        for i in range(max(0, int(np.searchsorted(place, wanted)) - 1), int(np.searchsorted(place, wanted, side="right"))):
            first, rallies = self.batch(i)
            found.append(first + np.flatnonzero((rallies.pairing == pairing) & (rallies.match == match)))
        return np.concatenate(found)

    def rally_table(self) -> pa.Table:
        """All rallies as one table, see :func:`shuttle_marl.recording.tables.rally_rows`."""
        return pa.concat_tables(
            [rally_rows(self, *batch) for batch in self.batches()] or [rally_rows(self, 0, self.no_rallies())]
        )

    def stroke_table(self) -> pa.Table:
        """All strokes as one table, see :func:`shuttle_marl.recording.tables.stroke_rows`."""
        return pa.concat_tables(
            [stroke_rows(self, *batch) for batch in self.batches()] or [stroke_rows(self, 0, self.no_rallies())]
        )

    def no_rallies(self) -> Rallies:
        """No rows, with the columns of this log."""
        return Rallies.from_arrow(pa.RecordBatch.from_pylist([], schema=arrow_schema(len(self.header.strokes))))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _read_catalogue(self) -> Catalogue:
        try:
            return Catalogue.from_names(self.header.strokes)
        except UnknownStrokeError as error:
            raise RecordingError(f"strokes that this program does not know: {error}") from error

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
        columns = [index.column(field.name).to_numpy() for field in INDEX_SCHEMA]
        self.first_rally, self.rallies, self.strokes, self._offset, self._pairing, self._match = columns
        if (self.first_rally[1:] < self.first_rally[:-1] + self.rallies[:-1]).any():
            raise DamagedLogError("its index is out of order")
