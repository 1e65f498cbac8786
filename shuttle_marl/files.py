"""Files that are whole or not there: written beside, then moved into place."""

import contextlib
import errno
import os
import tempfile
from pathlib import Path
from typing import Final

from shuttle_marl.errors import ShuttleError

NO_ROOM: Final = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
"""Errors of the system that say that something does not fit."""


class FileWriteError(ShuttleError):
    """A file could not be written; whatever stood there before still does."""


def replace_file(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` atomically, creating its folder.

    Raises:
        FileWriteError: no space, no permission, or the like; an older file at ``path`` is left as it was.
    """
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
        raise FileWriteError(f"{path}: cannot be written ({error.strerror}); nothing there was changed") from error
