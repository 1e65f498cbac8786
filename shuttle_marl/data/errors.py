"""Errors of reading match data."""

from pathlib import Path

from shuttle_marl.errors import ShuttleError


class DataError(ShuttleError):
    """Match data that cannot be read; the message names file, line and value."""

    def __init__(self, path: Path, message: str, *, line: int | None = None) -> None:
        where = f"{path}" if line is None else f"{path}, line {line}"
        super().__init__(f"{where}: {message}")
        self.path = path
        self.line = line
