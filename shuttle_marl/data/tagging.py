"""Strokes that a person tags beside a video: a table that ``data import`` and the reports read, and a journal of the inputs.

A journal keeps each input, so tagging continues where it stopped.
"""

import contextlib
import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shuttle_marl.base import files
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import check_replaceable, read_file, replace_file
from shuttle_marl.base.runs import Journal, locked
from shuttle_marl.data.schema import NAMES


class TaggingError(ShuttleError):
    """Tagged strokes that cannot be continued."""


class TaggedStrokes:
    """The table of tagged strokes, with the journal of the inputs beside it.

    Args:
        out: the table, a CSV file; continued if its journal exists.
        columns: of the table.

    Attributes:
        inputs: that hold; an input of None takes the last one back.
        rows: lines of the table.
        last: input, and the hash of the inputs before it.

    Raises:
        TaggingError: the table exists without a journal, or is no longer the one that was saved.
        RunError: the journal is damaged, or another process writes the table.
    """

    def __init__(self, out: Path, columns: Sequence[str]) -> None:
        if out.suffix.lower() != ".csv":
            raise TaggingError(f"--out {out}: expected a name that ends in .csv")
        journal = out.with_suffix(".inputs.jsonl")
        if out.exists() and not journal.exists():
            raise TaggingError(f"--out {out}: exists, without its inputs, {journal.name}; choose another name")
        for path in (out, journal):
            check_replaceable(path)
        out.parent.mkdir(parents=True, exist_ok=True)
        self.path, self._header, self._writer = out, ",".join(columns), contextlib.ExitStack()
        self._writer.enter_context(locked(out, out.with_suffix(".inputs.lock")))
        self._journal = Journal(journal, "enter the next input", f"move it away, and {out.name} too, and begin again")
        lines = self._journal.read()
        self._journal.keep(len(lines))  # without the half line of a process that was killed
        self.inputs: list[str] = []
        self.last: tuple[str | None, str] = "", ""
        for line in lines:
            if not isinstance(entered := line.get("input"), str | None):
                raise TaggingError(f"{journal}: {entered!r:.50} is no input; move it away, and {out.name} too, and begin again")
            self._enter(entered)
        self.rows = self._saved() if out.exists() else []

    def close(self) -> None:
        """Let other processes write the table."""
        self._writer.close()

    def enter(self, entered: str | None) -> None:
        """Keep an input.

        Raises:
            RunError: the journal cannot be written.
        """
        self._journal.append([{"input": entered}])
        self._enter(entered)

    def replace(self, first: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """Replace the rows from a number on.

        Raises:
            FileWriteError: the table cannot be written.
        """
        if rows or first < len(self.rows):
            self.rows[first:] = map(_line, rows)
            replace_file(self.path, "\n".join((self._header, *self.rows, "")).encode())

    @property
    def hash(self) -> str:
        """What pages compare: they must show the same inputs, not only as many."""
        return content_hash(self.inputs)

    def _enter(self, entered: str | None) -> None:
        self.last = entered, self.hash
        if entered is not None:
            self.inputs.append(entered)
        elif self.inputs:
            self.inputs.pop()

    def _saved(self) -> list[str]:
        """Rows of the table, in which a spreadsheet may have corrected names."""
        try:
            header, *rows = read_file(self.path, files.MAX_LINES).decode("utf-8-sig").replace("\r\n", "\n").split("\n")
        except (OSError, UnicodeDecodeError):
            header, rows = "", []
        if header != self._header:
            raise TaggingError(
                f"--out {self.path}: another program saved it with other columns, or not with commas and in UTF-8; save it so, "
                "or move it away: the inputs beside it write it again"
            )
        return [row for row in rows if row]


def content_hash(inputs: Sequence[str]) -> str:
    """Hash of inputs."""
    return files.content_hash("\n".join(inputs).encode(errors="surrogatepass"))[:16]


def _line(row: Mapping[str, Any]) -> str:
    """A row of the table, with names for codes."""
    text = io.StringIO()
    values = (NAMES[name][value] if name in NAMES and isinstance(value, int) else value for name, value in row.items())
    csv.writer(text, lineterminator="").writerow("" if value is None else value for value in values)
    return text.getvalue()
