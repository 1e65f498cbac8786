"""Files that are complete or not there: written to a temporary file, then moved into place; and files that are safe to open."""

import contextlib
import errno
import hashlib
import json
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

from shuttle_marl.errors import ShuttleError

NO_ROOM: Final = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
"""Errors of the system that say that something does not fit."""
_BINARY: Final = getattr(os, "O_BINARY", 0)  # Windows only
_SEAL: Final = "checksum"
"""Entry of a sealed JSON object."""


class FileWriteError(ShuttleError):
    """A file could not be written; whatever stood there before still does."""


def replace_file(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` atomically, creating its folder. The umask decides who may read it.

    Raises:
        FileWriteError: no space, no permission, an impossible name, or the like; an older file at ``path`` is left as it was.
    """
    with replacing(path) as file:
        file.write(content)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A file to write and read that becomes ``path`` at the end, or is deleted after an error; creates the folder.

    Raises:
        FileWriteError: as :func:`replace_file`. Other errors than an OSError of the block pass through.
    """
    # Not the whole name: with it, the longest names that a file system takes would become too long.
    temporary = path.parent / f".{path.name[:32]}.{secrets.token_hex(6)}.part"
    with _unwritable(path, OSError, ValueError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | _BINARY, 0o666)
    try:
        with _unwritable(path, OSError), os.fdopen(handle, "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        with _unwritable(path, OSError, ValueError):
            os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


@contextlib.contextmanager
def _unwritable(path: Path, *errors: type[Exception]) -> Iterator[None]:
    """Say which file cannot be written. A ValueError is raised for names that no file can have."""
    try:
        yield
    except errors as error:
        raise FileWriteError(f"{path}: cannot be written ({problem(error)}); nothing there was changed") from error


def open_file(path: Path) -> BinaryIO:
    """Open a regular file to read its bytes; never waits for a writer at the other end of a FIFO.

    Raises:
        OSError: it cannot be opened, or is a folder, a FIFO, a socket or a device.
    """
    handle = os.open(path, os.O_RDONLY | _BINARY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "no regular file", str(path))
    return os.fdopen(handle, "rb")


def problem(error: BaseException) -> str:
    """Reason why a file cannot be used, without its name: the words of the operating system, where it has some."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


class FileReadError(ShuttleError):
    """A file cannot be read, or is not what was written."""


def seal(fields: dict[str, Any]) -> bytes:
    """A JSON object that carries the SHA-256 of the rest of itself, so that :func:`read_sealed` notices any change."""
    return (json.dumps({**fields, _SEAL: _digest(fields)}, indent=2, ensure_ascii=False) + "\n").encode(errors="backslashreplace")


def read_sealed(path: Path) -> dict[str, Any]:
    """Read the content of a file that :func:`seal` made.

    Raises:
        FileReadError: it is missing, no JSON object, or was changed after it was written; the message is the reason alone.
    """
    try:
        with open_file(path) as file:
            fields = json.loads(file.read().decode())
        if not isinstance(fields, dict):
            raise FileReadError("no JSON object")
        if fields.pop(_SEAL, None) != _digest(fields):
            raise FileReadError("it was changed after it was written: its checksum does not fit")
        return fields
    except RecursionError as error:
        raise FileReadError("nested too deeply") from error
    except (OSError, ValueError) as error:
        raise FileReadError(problem(error)) from error


def _digest(fields: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()
