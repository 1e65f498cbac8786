"""A new file that never ends in the middle: room is taken before anything is written, and every write is one call."""

import contextlib
import errno
import os
from pathlib import Path
from typing import Final

from shuttle_marl.files import NO_ROOM

_STEP: Final = 1 << 20
"""Room is taken in steps of so many bytes."""


class NoRoomError(OSError):
    """The disk has no room for what would come next; nothing of it was written."""


class Sink:
    """What a log is written to. ``write`` collects, ``commit`` hands over: what it took, no end of the process can take away.

    Where the operating system can set room aside, the file is longer than what was written until it is closed.

    Attributes:
        length: bytes committed.
    """

    def __init__(self, path: Path) -> None:
        """Make the file.

        Raises:
            OSError: it exists, or cannot be made.
        """
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        self._waiting: list[bytes] = []
        self._n_waiting = 0
        self._room = 0
        self.length = 0

    def write(self, data: bytes) -> int:
        """Collect bytes for the next commit."""
        self._waiting.append(bytes(data))
        self._n_waiting += len(data)
        return len(data)

    def tell(self) -> int:
        """Where the next byte will stand."""
        return self.length + self._n_waiting

    def flush(self) -> None:
        """Nothing: :meth:`commit` decides when."""

    def take_room(self, count: int) -> None:
        """Make sure that the next ``count`` bytes can be written.

        Raises:
            NoRoomError: they cannot.
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
        """Write what was collected.

        Raises:
            OSError: it could not be written; the file ends where it ended before.
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
        """Return when all is on the disk itself."""
        os.fsync(self._handle)

    def close(self) -> None:
        """Give unused room back, and close the file."""
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
