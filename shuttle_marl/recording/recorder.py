"""Write rally logs: in batches, resumed, or from a thread beside the program.

A file is written to ``FILE.part`` and moved to ``FILE`` when it is closed. After a kill, the log holds every rally that
:meth:`RallyLogWriter.flush` counted; :func:`shuttle_marl.recording.recover` makes a finished file of them.
"""

import contextlib
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from shuttle_marl.base.errors import counted
from shuttle_marl.base.files import problem
from shuttle_marl.game.rally import Rallies
from shuttle_marl.recording import log_file
from shuttle_marl.recording.header import LogHeader, RecordingError
from shuttle_marl.recording.log_file import advice, encode, files_of, salvage, set_aside, unfinished

T = TypeVar("T")


class LogContext:
    """Context of a log: finished by ``close`` at the end, and left unfinished by ``abort`` after an error."""

    close: Callable[[], None]
    abort: Callable[[], None]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


class RallyLogWriter(LogContext):
    """Writes one rally log; a context manager that closes it, or leaves ``FILE.part`` behind after an error.

    If the disk is full or fails, each call is a :class:`RecordingError`, and earlier batches are complete.
    """

    def __init__(self, path: Path | str, header: LogHeader, *, batch_rallies: int = 4096, fsync_seconds: float = 5.0) -> None:
        """Start a log.

        Args:
            path: path of the finished log.
            batch_rallies: rallies per batch; fewer than about 1,024 are slow.
            fsync_seconds: longest time between two calls of ``fsync``.

        Raises:
            RecordingError: a file exists or cannot be created.
        """
        if batch_rallies < 1:
            raise RecordingError(f"batch_rallies {batch_rallies}: expected 1 or more")
        self.path, self.header = Path(path), header
        self._part = part = unfinished(self.path)
        self._batch_rallies, self._fsync_seconds = batch_rallies, fsync_seconds
        self._waiting: list[Rallies] = []
        try:
            if self.path.exists():
                raise RecordingError(f"{path}: there is a rally log already; delete it or choose another name")
            if part.exists():
                raise RecordingError(f"{part}: an unfinished log stands there; {advice(part)}, or delete it")
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = part.open("xb")
        except (OSError, ValueError) as error:  # ValueError: an invalid file name
            raise RecordingError(f"{part}: cannot be written ({problem(error)})") from error
        try:
            self._log = log_file.LogFileWriter(self._file, header)
        except OSError as error:
            self.abort()
            part.unlink()
            raise RecordingError(f"{part}: cannot be written ({error.strerror}); nothing was recorded") from error
        self._synced = time.monotonic()

    @property
    def rallies(self) -> int:
        """Number of rallies that were handed to the operating system and survive any end of this process."""
        return self._log.rallies

    def append(self, rallies: Rallies) -> None:
        """Add rallies; full batches are written when this returns, the remaining rallies are buffered."""
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
        """Write the buffered rallies as a shorter batch.

        Args:
            sync: whether to call ``fsync``, so that the rallies also survive a power failure.

        Returns:
            The number of rallies that survive any end of this process.

        Raises:
            RecordingError: the disk is full or fails.
        """
        if sum(map(len, self._waiting)):
            rest = Rallies.concatenate(self._waiting)
            self._waiting = []
            self._write(rest)
        if sync and not self._file.closed:
            with self._guarded():
                self._sync()
        return self.rallies

    def write_message(self, first: int, data: bytes | memoryview, rallies: Rallies) -> None:
        """Write one batch, encoded by :func:`~shuttle_marl.recording.log_file.encode`, whose first rally has this number."""
        if self._file.closed:
            raise RecordingError(f"{self.path}: is closed; nothing more can be recorded in it")
        if len(data) > log_file.MAX_CHUNK or len(rallies) > log_file.MAX_RALLIES or len(rallies.stroke) > log_file.MAX_STROKES:
            raise RecordingError(f"{self.path}: a batch of {len(rallies)} rallies is too large; choose fewer rallies per batch")
        with self._guarded():
            self._log.write(first, data, rallies)
            if time.monotonic() - self._synced > self._fsync_seconds:
                self._sync()

    def close(self) -> None:
        """Write the buffered rallies and the index, and move the log into place."""
        self.flush(sync=False)
        if not self._file.closed:
            with self._guarded():
                self._log.finish()
                self._sync()
                self._file.close()
                os.replace(self._part, self.path)

    def abort(self) -> None:
        """Stop writing and leave ``FILE.part`` behind, for :func:`shuttle_marl.recording.recover` or a resumed run."""
        with contextlib.suppress(OSError):  # it writes what an earlier error left in its buffer
            self._file.close()

    def _sync(self) -> None:
        os.fsync(self._file.fileno())
        self._synced = time.monotonic()

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """After an error leave ``FILE.part`` behind with its complete batches, and say so."""
        try:
            yield
        except OSError as error:
            self.abort()
            kept = f"cannot be written ({error.strerror}); it holds {counted(self.rallies, 'complete rally', 'complete rallies')}"
            raise RecordingError(f"{self._part}: {kept}: free disk space and resume, or {advice(self._part)}") from error

    def _write(self, rallies: Rallies) -> None:
        self.write_message(self.rallies, encode(self.rallies, rallies, len(self.header.strokes)), rallies)


def resume(path: Path, header: LogHeader, rallies: int, **options: Any) -> RallyLogWriter:
    """Keep the first rallies of the log at ``path`` and return a writer that continues after them.

    Their batches are copied byte for byte, so the finished log equals that of an uninterrupted process with the same options
    that flushed after the same number of rallies.

    Args:
        header: header of the run; the unfinished log must have the same.
        rallies: number of rallies to keep; a batch must end there.
        **options: options of :class:`RallyLogWriter`.

    Raises:
        RecordingError: the unfinished log has another header or fewer undamaged rallies, or cannot be written.
    """
    source = set_aside(path)
    told = counted(rallies, "rally", "rallies")
    with log_file.damage(path):
        if not rallies:
            if path.exists() and log_file.open_log(path)[1] != header:
                raise RecordingError("the log of another run; delete it or choose another name")
            for file in files_of(path):
                file.unlink()
            return RallyLogWriter(path, header, **options)
        if source.exists():
            unfinished(path).unlink(missing_ok=True)  # an incomplete copy; the original is intact
        elif files := files_of(path):
            os.replace(files[0], source)
        else:
            raise RecordingError(f"{unfinished(path).name}: is missing, with {told} that the run has played; start again")
    before, batches = salvage(source)
    if before != header:
        raise RecordingError(f"{source}: another game, other policies or another seed than this run has; start again")
    writer = RallyLogWriter(path, before, **options)
    for first, data, batch in batches:
        if writer.rallies == rallies or first != writer.rallies:
            break
        writer.write_message(first, data, batch)
    if writer.rallies != rallies:
        writer.abort()
        raise RecordingError(f"{source}: the run has played {told}, of which {writer.rallies:,} undamaged; start again")
    writer.flush()
    source.unlink()
    return writer


class RallyRecorder(LogContext):
    """Records finished rallies in a background thread.

    A context manager that closes the log, or leaves it unfinished after an error. Compression and checksums run without the
    GIL. An error in the thread is raised by the next call: a :class:`RecordingError` if the log cannot be written any further;
    earlier batches are complete.
    """

    def __init__(self, log: RallyLogWriter, *, waiting_strokes: int = 1 << 24) -> None:
        """Record into a log.

        Args:
            log: a new log, or the result of :func:`resume`. The recorder closes it.
            waiting_strokes: strokes in the queue from which :meth:`add` blocks.
        """
        self.path = log.path
        self._log, self._limit = log, waiting_strokes
        self._queue: deque[tuple[int, Future[None]]] = deque()
        self._waiting = 0
        self._error: BaseException | None = None
        self._thread = ThreadPoolExecutor(1, f"recording {log.path.name}")

    @classmethod
    def create(cls, path: Path, header: LogHeader, **options: Any) -> Self:
        """Start a log, with options of :class:`RallyLogWriter`, and record into it."""
        return cls(RallyLogWriter(path, header, **options))

    def add(self, rallies: Rallies) -> None:
        """Record finished rallies, whose arrays must not be changed afterwards; blocks while the queue is full."""
        if len(rallies):
            self._raise()
            while self._queue and (self._queue[0][1].done() or self._waiting > self._limit):
                strokes, appended = self._queue.popleft()
                self._waiting -= strokes
                appended.result()
            self._queue.append((len(rallies.stroke), self._submitted(rallies)))
            self._waiting += len(rallies.stroke)

    def request_flush(self, *, sync: bool = True) -> "Future[int]":
        """Request :meth:`RallyLogWriter.flush` for all rallies added so far, and return its future result at once."""
        return self._thread.submit(self._guarded, lambda: self._log.flush(sync=sync))

    def flush(self, *, sync: bool = True) -> int:
        """Flush all rallies added so far; see :meth:`RallyLogWriter.flush`."""
        return self.request_flush(sync=sync).result()

    def close(self) -> None:
        """Write all rallies, and move the log into place."""
        self._thread.shutdown()
        if self._error is not None:
            self._log.abort()
        self._raise()
        self._log.close()

    def abort(self) -> None:
        """Write all rallies, and leave ``FILE.part`` behind."""
        self._thread.shutdown()
        self._log.abort()

    def _submitted(self, rallies: Rallies) -> "Future[None]":
        try:
            return self._thread.submit(self._guarded, self._log.append, rallies)
        except RuntimeError:  # the interpreter ends: the thread has, and its queue is empty
            done: Future[None] = Future()
            done.set_result(self._guarded(self._log.append, rallies))
            return done

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _guarded(self, work: Callable[..., T], *arguments: Any) -> T:
        """Call in the thread; after an error every later call raises it."""
        self._raise()
        try:
            return work(*arguments)
        except BaseException as error:
            self._error = error
            raise
