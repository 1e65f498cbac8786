"""Goes on with a rally log that a killed process left unfinished, or that a full disk closed too early."""

import contextlib
import os
from pathlib import Path
from typing import Any

from shuttle_marl.recording.container import damage
from shuttle_marl.recording.header import LogHeader, read_header
from shuttle_marl.recording.parts import existing_parts, part_path, set_aside, unfinished
from shuttle_marl.recording.salvage import salvage
from shuttle_marl.recording.schema import RecordingError
from shuttle_marl.recording.writer import RallyLogWriter


def resume(path: Path, header: LogHeader, rallies: int, **options: Any) -> RallyLogWriter:
    """Keep the first rallies of the log at ``path`` and return a writer that goes on behind them.

    The batches that are kept are the same bytes, so the finished log is the one that an undisturbed process would have
    written, provided that it flushed after as many rallies and with the same options.

    Args:
        path: where the finished log goes.
        header: of the run; the unfinished log must have the same.
        rallies: how many to keep; a batch must end there.
        **options: of :class:`RallyLogWriter`.

    Raises:
        RecordingError: the unfinished log has another header or fewer rallies, is damaged before that, or cannot be written.
    """
    with damage(path):
        last = _last_part(path, rallies)
        if last is None:
            _delete(path, 0, header)
            return RallyLogWriter(path, header, **options)
        source = _source(part_path(path, last))
    before, batches = salvage(source)
    if before != header:
        raise RecordingError(f"{source}: another game, other policies or another seed than this run has; start anew")
    writer = RallyLogWriter(path, before, leave_later=True, **options)
    for first, data, batch in batches:
        if writer.rallies == rallies or first != writer.rallies:
            break
        writer.write_message(first, data, batch)
    if writer.rallies != rallies:
        writer.abort()
        raise RecordingError(f"{source}: {rallies} rallies were played, {writer.rallies} are whole; start anew")
    writer.flush()
    with damage(path):
        _delete(path, last + 1, header)
        source.unlink()
    return writer


def rallies_of_pairings(path: Path, pairings: int) -> int:
    """How many rallies of an unfinished log, all parts together, belong to the pairings below a number.

    Pairings must be recorded in the order of their numbers, each to its end before the next one begins.

    Raises:
        RecordingError: a file cannot be read or is no rally log.
    """
    count = 0
    for number in existing_parts(path):
        for file in _files(part_path(path, number)):
            try:
                _, batches = salvage(file)
            except RecordingError:
                if number:  # begun by a process that was killed before it wrote the header
                    continue
                raise
            for first, _, batch in batches:
                if int(batch.pairing.max()) >= pairings:
                    return count
                count = first + len(batch)
    return count


def _files(part: Path) -> list[Path]:
    """The file of a part: set aside by a resumption that was killed, else finished, else unfinished."""
    return [file for file in (set_aside(part), part, unfinished(part)) if file.exists()][:1]


def _last_part(path: Path, rallies: int) -> int | None:
    """Number of the part that holds the last rally to keep; None: there is none to keep.

    Raises:
        RecordingError: it is gone.
    """
    if not rallies:
        return None
    last = None
    for number in existing_parts(path):
        for file in _files(part_path(path, number)):
            # A process that was killed as it began a file leaves one without a header, hence without rallies.
            with contextlib.suppress(RecordingError), file.open("rb") as opened:
                if read_header(opened, file.stat().st_size)[0].first_rally < rallies:
                    last = number
    if last is None:
        raise RecordingError(f"{unfinished(path).name}: is gone, with the {rallies} rallies that were played; start anew")
    return last


def _source(part: Path) -> Path:
    """Move the file of a part out of the way of its copy."""
    old = set_aside(part)
    if old.exists():
        unfinished(part).unlink(missing_ok=True)  # a copy that was killed; the original is still whole
    else:
        os.replace(_files(part)[0], old)
    return old


def _delete(path: Path, first: int, header: LogHeader) -> None:
    """Delete the parts of a log from this number on, the last one first.

    Raises:
        RecordingError: a finished part is of another log.
    """
    for number in reversed([number for number in existing_parts(path) if number >= first]):
        part = part_path(path, number)
        if part.exists():
            with part.open("rb") as opened:
                if read_header(opened, part.stat().st_size)[0] != header:
                    raise RecordingError(f"{part.name} is the log of another run; delete it or choose another name")
        for file in (unfinished(part), part, set_aside(part)):
            file.unlink(missing_ok=True)
