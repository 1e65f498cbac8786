"""Evaluations of a training run, in the order in which they were made."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from shuttle_marl.files import problem, replace_file
from shuttle_marl.training.config import TrainingError


class Metrics:
    """The file of evaluations, one JSON object a line, of which checkpoints know the length and the hash.

    Args:
        path: of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def append(self, line: dict[str, Any]) -> None:
        """Add a line."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def mark(self) -> dict[str, Any]:
        """Have everything on the disk; returns what :meth:`cut` needs to find its end again."""
        with self._path.open("ab+") as file:
            os.fsync(file.fileno())
            file.seek(0)
            content = file.read()
        return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}

    def cut(self, mark: dict[str, Any] | None) -> None:
        """Take away what was written after a mark; None: everything.

        Raises:
            TrainingError: what was written before the mark is damaged.
        """
        try:
            content = self._path.read_bytes() if mark is not None else b""
        except OSError as error:
            raise TrainingError(f"{self._path}: cannot be read ({problem(error)}); train again with --overwrite") from error
        kept = content[: mark["bytes"]] if mark is not None else b""
        if mark is not None and mark != {"bytes": len(kept), "sha256": hashlib.sha256(kept).hexdigest()}:
            raise TrainingError(f"{self._path}: was changed after it was written; train again with --overwrite")
        if kept != content or mark is None:
            replace_file(self._path, kept)
