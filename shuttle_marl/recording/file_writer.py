"""Write one file of a rally log.

A batch of rallies is one message in one chunk, and is passed to the operating system before a call returns. The file is named
``FILE.part`` until it is closed. With every batch, disk space for the end of the file is reserved, so that the file is complete
even when the disk is full.
"""

import contextlib
import errno
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final, cast

import numpy as np
import pyarrow as pa
from mcap.writer import Writer

from shuttle_marl.base.files import NO_ROOM, problem
from shuttle_marl.game.rally.record import Rallies
from shuttle_marl.recording.chunks import COMPRESSION, MAX_CHUNK, MAX_RALLIES, MAX_STROKES, RALLY_TIME, arrow_schema
from shuttle_marl.recording.header import LogHeader, RecordingError
from shuttle_marl.recording.log_file import INDEX_NAME, INDEX_SCHEMA, METADATA, PROFILE, TOPIC, advice, unfinished

_END: Final = 4096
_END_OF_BATCH: Final = 256
"""Upper bounds of the size of the end of a file, and of its growth per batch [bytes]."""


_STEP: Final = 1 << 20
"""Disk space is reserved in steps of this size [bytes]."""


class NoRoomError(OSError):
    """The disk is full; nothing was written."""


class Sink:
    """Output file of a log: ``write`` buffers, ``commit`` passes the buffer to the operating system.

    Committed bytes survive any end of the process. Until it is closed, the file is longer than ``length`` if the file system can
    reserve space.
    """

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises:
            OSError: the file exists, or cannot be created.
        """
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        self._waiting: list[bytes] = []
        self._n_waiting = 0
        self._room = 0
        self.length = 0

    def write(self, data: bytes) -> int:
        """Buffer bytes for the next commit."""
        self._waiting.append(bytes(data))
        self._n_waiting += len(data)
        return len(data)

    def tell(self) -> int:
        """Position of the next byte."""
        return self.length + self._n_waiting

    def flush(self) -> None:
        """Do nothing: :meth:`commit` writes."""

    def reserve(self, count: int) -> None:
        """Reserve disk space for the next ``count`` bytes.

        Raises:
            NoRoomError: the disk is full.
            OSError: the file cannot be written.
        """
        needed = self.length + count
        if needed <= self._room or not hasattr(os, "posix_fallocate"):
            return
        for room in (max(needed, self.length + _STEP), needed):
            try:
                os.posix_fallocate(self._handle, self._room, room - self._room)
            except OSError as error:
                if error.errno in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):  # not on this file system
                    return
                if error.errno not in NO_ROOM:
                    raise
                full = error
            else:
                self._room = room
                return
        raise NoRoomError(full.errno, full.strerror)

    def commit(self) -> None:
        """Write the buffer.

        Raises:
            OSError: the buffer could not be written; the file is unchanged.
        """
        view = memoryview(b"".join(self._waiting))
        self._waiting, self._n_waiting = [], 0
        position = self.length
        try:
            while view:
                count = os.write(self._handle, view)
                position += count
                view = view[count:]
        except OSError:
            self._cut()
            raise
        self.length = position

    def sync(self) -> None:
        """Flush the file to the disk with ``fsync``."""
        os.fsync(self._handle)

    def close(self) -> None:
        """Release reserved space, and close the file."""
        if self._handle >= 0:
            if self._room > self.length:
                self._cut()
            os.close(self._handle)
            self._handle = -1

    def _cut(self) -> None:
        with contextlib.suppress(OSError):
            os.ftruncate(self._handle, self.length)
        self._room = 0
        with contextlib.suppress(OSError):
            os.lseek(self._handle, self.length, os.SEEK_SET)


class LogFileWriter:
    """Writes one file of a log."""

    def __init__(self, path: Path, header: LogHeader, *, fsync_seconds: float) -> None:
        """Start a file.

        Args:
            path: path of the finished file; neither it nor ``path.part`` may exist.
            fsync_seconds: longest time between two calls of ``fsync``.

        Raises:
            RecordingError: the file exists or cannot be created.
        """
        self.path, self.header = path, header
        self.rallies = header.first_rally
        self.closed = False
        self._fsync_seconds = fsync_seconds
        self._index: list[tuple[int, ...]] = []
        part = unfinished(path)
        try:
            if path.exists():
                raise RecordingError(f"{path}: there is a rally log already; delete it or choose another name")
            if part.exists():
                raise RecordingError(f"{part}: an unfinished log stands there; {advice(part)}, or delete it")
            path.parent.mkdir(parents=True, exist_ok=True)
            self._sink = Sink(part)
        except (OSError, ValueError) as error:  # ValueError: an invalid file name
            raise RecordingError(f"{part}: cannot be written ({problem(error)})") from error
        try:
            self._start()
        except OSError as error:
            self.abort()
            part.unlink(missing_ok=True)
            raise RecordingError(f"{part}: cannot be written ({error.strerror}); nothing was recorded") from error

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._sink.length

    def write(self, first: int, data: bytes | memoryview, rallies: Rallies) -> None:
        """Write one batch.

        Args:
            first: number of its first rally, not below :attr:`rallies`.
            data: the batch, encoded by :func:`shuttle_marl.recording.chunks.encode`.

        Raises:
            RecordingError: the disk is full or fails; the file holds every earlier batch.
        """
        if self.closed:
            raise RecordingError(f"{self.path}: is closed; nothing more can be recorded in it")
        if len(data) > MAX_CHUNK or len(rallies) > MAX_RALLIES or len(rallies.stroke) > MAX_STROKES:
            raise RecordingError(f"{self.path}: a batch of {len(rallies)} rallies is too large; choose fewer rallies per batch")
        offset = self._sink.length
        with self._guarded():
            self._sink.reserve(len(data) + _END + self._end_of_file(len(self._index) + 1))
            # One message per chunk, so a kill loses at most the batch that is being written.
            self._mcap.add_message(self._channel, first * RALLY_TIME, cast(bytes, data), first * RALLY_TIME, len(self._index))
            self._sink.commit()
            if time.monotonic() - self._synced > self._fsync_seconds:
                self._sync()
        match = rallies.pairing.astype(np.uint64) << np.uint64(32) | rallies.match
        row = (first, len(rallies), len(rallies.stroke), offset, int(match.min()), int(match.max()))
        self._index.append(row)
        self.rallies = first + len(rallies)

    def sync(self) -> None:
        """Flush the file to the disk with ``fsync``, so that it survives a power failure.

        Raises:
            RecordingError: the disk failed.
        """
        with self._guarded():
            if not self.closed:
                self._sync()

    def close(self) -> None:
        """Write the index and move the file into place.

        Raises:
            RecordingError: the disk is full or fails; ``FILE.part`` holds every batch.
        """
        with self._guarded():
            if not self.closed:
                self._finish()

    def abort(self) -> None:
        """Leave ``FILE.part`` behind, for :func:`shuttle_marl.recording.recover` or a resumed run."""
        if not self.closed:
            self._sink.close()
            self.closed = True

    def _start(self) -> None:
        self._mcap = Writer(cast(IO[Any], self._sink), chunk_size=1, compression=COMPRESSION, enable_data_crcs=True)
        self._mcap.start(profile=PROFILE, library=self.header.software)
        self._mcap.add_metadata(METADATA, self.header.to_metadata())
        self._columns = arrow_schema(len(self.header.strokes), self.header.columns).serialize().to_pybytes()
        schema = self._mcap.register_schema("shuttle_marl.Rallies", "arrow", self._columns)
        self._channel = self._mcap.register_channel(TOPIC, "arrow_stream", schema)
        self._sink.reserve(self._sink.tell() + self._end_of_file(0))
        self._sink.commit()
        self._synced = time.monotonic()

    def _end_of_file(self, batches: int) -> int:
        return _END + len(self._columns) + _END_OF_BATCH * batches

    def _sync(self) -> None:
        self._sink.sync()
        self._synced = time.monotonic()

    def _finish(self) -> None:
        columns = list(zip(*self._index, strict=True)) or [()] * len(INDEX_SCHEMA)
        index = pa.RecordBatch.from_arrays(
            [pa.array(column, field.type) for column, field in zip(columns, INDEX_SCHEMA, strict=True)], schema=INDEX_SCHEMA
        )
        buffer = pa.BufferOutputStream()
        with pa.ipc.new_stream(buffer, INDEX_SCHEMA) as writer:
            writer.write_batch(index)
        end = self.rallies * RALLY_TIME
        self._mcap.add_attachment(0, end, INDEX_NAME, "application/vnd.apache.arrow.stream", buffer.getvalue().to_pybytes())
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self._sink.commit()
        self._sink.sync()
        self._sink.close()
        self.closed = True
        os.replace(unfinished(self.path), self.path)

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """After an error finish the file with its present batches, or leave ``FILE.part`` behind, and say which."""
        try:
            yield
        except OSError as error:
            raise self._given_up(error) from error

    def _given_up(self, error: OSError) -> RecordingError:
        reason = f"({error.strerror}); the {self.rallies} rallies before it are complete"
        if isinstance(error, NoRoomError):
            with contextlib.suppress(OSError):
                self._finish()
                return RecordingError(f"{self.path}: cannot be written any further {reason}: free disk space and resume")
        self.abort()
        part = unfinished(self.path)
        return RecordingError(f"{part}: cannot be written {reason}: free disk space and resume, or {advice(part)}")
