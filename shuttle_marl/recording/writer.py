"""Writes rally logs: collects rallies into batches, and continues in another file when one is full.

A file is written to ``FILE.part`` and moved to ``FILE`` when it is closed. A process that is killed leaves every rally that
:meth:`RallyLogWriter.flush` counted; :mod:`shuttle_marl.recording.recover` makes a whole file of them.
"""

import dataclasses
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from shuttle_marl.rally.record import Rallies
from shuttle_marl.recording.container import encode
from shuttle_marl.recording.file_writer import LogFileWriter
from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.log_file import existing_parts, part_path
from shuttle_marl.recording.schema import RecordingError

BATCH_RALLIES: Final = 4096
MAX_BYTES: Final = 1 << 30
"""A file as large as this is full, unless another size is asked for."""


class RallyLogWriter:
    """Writes one rally log; a context manager that closes it, or leaves ``FILE.part`` behind after an error.

    Attributes:
        path: where the log will stand when it is closed; its further parts are named by :func:`part_path`.
        header: what all its rallies share.
        rallies: number of rallies that survive any end of the process.
    """

    def __init__(
        self,
        path: Path,
        header: LogHeader,
        *,
        batch_rallies: int = BATCH_RALLIES,
        max_bytes: int = MAX_BYTES,
        fsync_seconds: float = 5.0,
        leave_later: bool = False,
    ) -> None:
        """Start a log, or continue with the part that the header names.

        Args:
            path: where the finished log goes; no file of it may exist from the part of the header on.
            header: what all rallies share.
            batch_rallies: rallies to a batch; 1,024 to 4,096 are cheap, less is not.
            max_bytes: a file that has reached this size is closed, and another part started.
            fsync_seconds: at most this long what was written may wait in the operating system.
            leave_later: do not refuse to start where there are later parts; the caller, who resumes a log, deletes them later.

        Raises:
            RecordingError: a file is there already, or none can be made.
        """
        if batch_rallies < 1 or max_bytes < 1:
            raise RecordingError(f"batch_rallies {batch_rallies}, max_bytes {max_bytes}: expected 1 or more")
        self.path, self.header = path, header
        later = [number for number in existing_parts(path) if number > header.part]
        if later and not leave_later:
            raise RecordingError(
                f"{part_path(path, later[0])}: there is a part of a rally log already; delete it or choose another name"
            )
        self._batch_rallies, self._max_bytes, self._fsync_seconds = batch_rallies, max_bytes, fsync_seconds
        self._waiting: list[Rallies] = []
        self._open(header)

    @property
    def rallies(self) -> int:
        """Number of rallies that were handed to the operating system and survive any end of this process."""
        return self._file.rallies

    def append(self, rallies: Rallies) -> None:
        """Add rallies; those that fill a batch are written when this returns, the others wait for more.

        Raises:
            RecordingError: other columns than the header names; or no space or the like, and every batch before is there.
        """
        if rallies.optional_columns != self.header.columns:
            raise RecordingError(f"{self.path}: rallies with columns {rallies.optional_columns}, expected {self.header.columns}")
        waiting, first = sum(map(len, self._waiting)), 0
        while waiting + len(rallies) - first >= self._batch_rallies:
            last = first + self._batch_rallies - waiting
            batch = rallies.slice(first, last)
            self._write(Rallies.concatenate([*self._waiting, batch]) if self._waiting else batch)
            self._waiting, waiting, first = [], 0, last
        if first < len(rallies):
            self._waiting.append(rallies.slice(first, len(rallies)))

    def flush(self, *, sync: bool = True) -> int:
        """Write the rallies that wait as a shorter batch.

        Args:
            sync: whether to return only when all is on the disk itself, so that it also outlives a power cut.

        Returns:
            The number of rallies that survive any end of this process.

        Raises:
            RecordingError: no space or the like.
        """
        if sum(map(len, self._waiting)):
            rest = Rallies.concatenate(self._waiting)
            self._waiting = []
            self._write(rest)
        if sync:
            self._file.sync()
        return self.rallies

    def write_message(self, first: int, data: bytes | memoryview, rallies: Rallies) -> None:
        """Write one batch as it was encoded before; for copies of a log.

        Args:
            first: number of its first rally, not below the number of rallies written so far.
            data: what :func:`shuttle_marl.recording.container.encode` made.
            rallies: the same, decoded.

        Raises:
            RecordingError: no space or the like; every batch before this one is there.
        """
        # A full file is closed only when there is something for the next one, so that no part is empty.
        if self._file.size >= self._max_bytes and self._file.rallies > self._file.header.first_rally:
            self._file.close()
            self._open(dataclasses.replace(self.header, part=self._file.header.part + 1, first_rally=self._file.rallies))
        self._file.write(first, data, rallies)

    def close(self) -> None:
        """Write the rest and the index, and move the log into place.

        Raises:
            RecordingError: no space or the like; ``FILE.part`` holds every batch.
        """
        self.flush(sync=False)
        self._file.close()

    def abort(self) -> None:
        """Stop writing and leave ``FILE.part`` behind, for :func:`shuttle_marl.recording.recover` or a resumed run."""
        self._file.abort()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def _open(self, header: LogHeader) -> None:
        self._file = LogFileWriter(part_path(self.path, header.part), header, fsync_seconds=self._fsync_seconds)

    def _write(self, rallies: Rallies) -> None:
        self.write_message(self.rallies, encode(self.rallies, rallies, len(self.header.strokes)), rallies)
