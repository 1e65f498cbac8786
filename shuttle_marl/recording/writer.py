"""Writes rally logs: a batch of rallies is one message is one chunk, and is on disk before the call returns.

A log is written to ``FILE.part`` and moved to ``FILE`` when it is closed. A process that is killed leaves every batch that
:meth:`RallyLogWriter.flush` counted; :mod:`shuttle_marl.recording.recover` makes a log of them.
"""

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self, cast

import pyarrow as pa
from mcap.writer import CompressionType, Writer

from shuttle_marl.recording.batch import RALLY_TIME, encode
from shuttle_marl.recording.container import INDEX_NAME, TOPIC, advice
from shuttle_marl.recording.header import METADATA, LogHeader
from shuttle_marl.recording.schema import Rallies, RecordingError, arrow_schema

PROFILE: Final = "shuttle_marl"
BATCH_RALLIES: Final = 4096
INDEX_SCHEMA: Final = pa.schema(
    [
        pa.field("first_rally", pa.uint64(), nullable=False),
        pa.field("rallies", pa.uint64(), nullable=False),
        pa.field("strokes", pa.uint64(), nullable=False),
        pa.field("offset", pa.uint64(), nullable=False),
        pa.field("pairing", pa.uint32(), nullable=False),
        pa.field("match", pa.uint32(), nullable=False),
    ]
)
"""Columns of the attachment ``rally_index``, a row a batch: its first rally, how many rallies and strokes it holds, the byte
at which its chunk begins, and the pairing and match of its first rally."""


def part_of(path: Path) -> Path:
    """Where a log is written until it is closed."""
    return path.with_name(path.name + ".part")


class RallyLogWriter:
    """Writes one rally log; a context manager that closes it, or leaves ``FILE.part`` behind after an error.

    Attributes:
        path: where the log will stand when it is closed.
        header: what all its rallies share.
        rallies: number of rallies on disk.
    """

    def __init__(self, path: Path, header: LogHeader, *, batch_rallies: int = BATCH_RALLIES, fsync_seconds: float = 5.0) -> None:
        """Start a log.

        Args:
            path: where the finished log goes; must not exist yet, nor ``path.part``.
            header: what all rallies share.
            batch_rallies: rallies to a batch; 1,024 to 4,096 are cheap, less is not.
            fsync_seconds: at most this long what was written may wait in the operating system.

        Raises:
            RecordingError: a file is there already, or none can be made.
        """
        self.path, self.header = path, header
        self.rallies = 0
        self._batch_rallies, self._fsync_seconds = batch_rallies, fsync_seconds
        self._waiting: list[Rallies] = []
        self._index: list[tuple[int, ...]] = []
        if path.exists():
            raise RecordingError(f"{path}: there is a rally log already; delete it or choose another name")
        part = part_of(path)
        if part.exists():
            raise RecordingError(f"{part}: an unfinished log stands there; {advice(part)}, or delete it")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._sink = _Sink(part)
        except OSError as error:
            raise RecordingError(f"{part}: cannot be written ({error.strerror})") from error
        self._written(self._start)

    def append(self, rallies: Rallies) -> None:
        """Add rallies; those that fill a batch are on disk when this returns, the others wait for more.

        Raises:
            RecordingError: no space or the like; ``FILE.part`` holds every batch before this one, whole.
        """
        self._waiting.append(rallies)
        waiting = sum(map(len, self._waiting))
        if waiting < self._batch_rallies:
            return
        whole = Rallies.join(self._waiting)
        last = waiting - waiting % self._batch_rallies
        for first in range(0, last, self._batch_rallies):
            self._write_batch(whole.part(first, first + self._batch_rallies))
        self._waiting = [whole.part(last, waiting)]

    def flush(self, *, sync: bool = True) -> int:
        """Write the rallies that wait as a shorter batch.

        Args:
            sync: whether to return only when all is on the disk itself, so that it also outlives a power cut.

        Returns:
            The number of rallies that no end of this process can take away any more.

        Raises:
            RecordingError: no space or the like.
        """
        if sum(map(len, self._waiting)):
            rest = Rallies.join(self._waiting)
            self._waiting = []
            self._write_batch(rest)
        if sync:
            self._written(self._sink.sync)
        return self.rallies

    def close(self) -> None:
        """Write the rest and the index, and move the log into place.

        Raises:
            RecordingError: no space or the like; ``FILE.part`` holds every batch.
        """
        self.flush(sync=False)
        self._written(self._finish)

    def abort(self) -> None:
        """Stop writing and leave ``FILE.part`` behind, for :func:`shuttle_marl.recording.recover` or a resumed run."""
        self._sink.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def _start(self) -> None:
        # One message is one chunk, so what a kill can take is never more than the batch being written.
        self._mcap = Writer(cast(IO[Any], self._sink), chunk_size=1, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._mcap.start(profile=PROFILE, library=self.header.software)
        self._mcap.add_metadata(METADATA, self.header.to_metadata())
        columns = arrow_schema(len(self.header.strokes)).serialize().to_pybytes()
        schema = self._mcap.register_schema("shuttle_marl.Rallies", "arrow", columns)
        self._channel = self._mcap.register_channel(TOPIC, "arrow_stream", schema)
        self._synced = time.monotonic()

    def _write_batch(self, rallies: Rallies) -> None:
        first = self.rallies
        self.write_message(first, encode(first, rallies, len(self.header.strokes)), rallies)

    def write_message(self, first: int, data: bytes, rallies: Rallies) -> None:
        """Write one batch as it was encoded before; for copies of a log.

        Args:
            first: number of its first rally, not below the number of rallies written so far.
            data: what :func:`shuttle_marl.recording.batch.encode` made.
            rallies: the same, decoded.

        Raises:
            RecordingError: no space or the like; ``FILE.part`` holds every batch before this one, whole.
        """
        offset = self._sink.tell()

        def write() -> None:
            self._mcap.add_message(self._channel, first * RALLY_TIME, data, first * RALLY_TIME, len(self._index))
            if time.monotonic() - self._synced > self._fsync_seconds:
                self._sink.sync()
                self._synced = time.monotonic()

        self._written(write, offset)
        self._index.append((first, len(rallies), len(rallies.stroke), offset, int(rallies.pairing[0]), int(rallies.match[0])))
        self.rallies = first + len(rallies)

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
        self._sink.sync()
        self._sink.close()
        os.replace(part_of(self.path), self.path)

    def _written(self, write: Callable[[], None], whole: int | None = None) -> None:
        """Call ``write``; if the disk fails it, cut the file back to ``whole`` bytes and say what is left."""
        whole = self._sink.tell() if whole is None else whole
        try:
            write()
        except OSError as error:
            self._sink.cut(whole)
            self._sink.close()
            part = part_of(self.path)
            raise RecordingError(
                f"{part}: cannot be written ({error.strerror}); it holds the {self.rallies} rallies before that, whole: "
                f"make room and resume, or {advice(part)}"
            ) from error


class _Sink:
    """A new file without a buffer: what :meth:`write` took, no end of the process can take away."""

    def __init__(self, path: Path) -> None:
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        self._position = 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            count = os.write(self._handle, view)
            self._position += count
            view = view[count:]
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Nothing waits here."""

    def sync(self) -> None:
        os.fsync(self._handle)

    def cut(self, length: int) -> None:
        with contextlib.suppress(OSError):
            os.ftruncate(self._handle, length)

    def close(self) -> None:
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1
