"""Recover truncated or damaged rally logs, and resume unfinished ones.

A batch is accepted if its checksum matches, so batches after a damaged one are found too, as long as lengths of records are not
damaged.
"""

import contextlib
import dataclasses
import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode

from shuttle_marl.base.files import FileWriteError, problem, replacing
from shuttle_marl.game.rally import Rallies
from shuttle_marl.recording.chunks import UNDECODABLE, decode, message_of_chunk, records
from shuttle_marl.recording.file_writer import LogFileWriter
from shuttle_marl.recording.header import DamagedLogError, LogHeader, RecordingError
from shuttle_marl.recording.log_file import (
    SUFFIX,
    content_of,
    damage,
    existing_parts,
    part_path,
    read_header,
    set_aside,
    unfinished,
)
from shuttle_marl.recording.recorder import RallyLogWriter


def salvage(path: Path) -> tuple[LogHeader, Iterator[tuple[int, bytes, Rallies]]]:
    """Header of a log file in any condition, and the number, message and rallies of every undamaged batch, in order.

    Raises:
        RecordingError: the file cannot be read or is not a rally log, or its header is damaged.
    """
    with damage(path):
        data = content_of(path)
        header, start = read_header(data)
    return header, _whole_batches(records(data, start), header)


def _whole_batches(found: Iterator[tuple[int, bytes]], header: LogHeader) -> Iterator[tuple[int, bytes, Rallies]]:
    done = header.first_rally
    with contextlib.suppress(DamagedLogError):  # the last record is cut off
        for opcode, body in found:
            if opcode != Opcode.CHUNK:
                continue
            try:
                message = message_of_chunk(body)
                first, rallies = decode(message, header)
            except (DamagedLogError, *UNDECODABLE):
                continue
            if first >= done:
                yield first, message.data, rallies
                done = first + len(rallies)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recovery:
    """Result of :func:`recover`.

    Attributes:
        lost: number of rallies known to be lost between those recovered; the number lost after the last one is unknown.
    """

    path: Path
    rallies: int
    strokes: int
    lost: int


def recover(source: Path, target: Path | None = None) -> Recovery:
    """Write a finished file with every undamaged batch of a damaged or unfinished one; ``source`` is not changed.

    Args:
        source: a file of a log in any condition, ``FILE.part`` included.
        target: the new file; must not exist. Default, in the same folder: ``FILE`` for ``FILE.part``, else
            ``NAME.recovered.mcap``.

    Raises:
        RecordingError: the source is not a rally log, or its header or all of its batches are damaged; or the target exists or
            cannot be written. No file is left behind.
    """
    if target is None:
        target = source.with_suffix("") if source.suffix == ".part" else source.with_name(f"{source.stem}.recovered.mcap")
    header, batches = salvage(source)
    rallies = strokes = lost = 0
    try:
        if target.exists():
            raise FileExistsError(errno.EEXIST, "exists already")
        with replacing(target, new=True) as file:
            log = LogFileWriter(file, header)
            for first, data, batch in batches:
                lost += first - log.rallies
                log.write(first, data, batch)
                rallies, strokes = rallies + len(batch), strokes + len(batch.stroke)
            if not rallies:
                raise RecordingError(f"{source}: nothing could be recovered: all its batches of rallies are damaged")
            log.finish()
    except (OSError, FileWriteError) as error:
        raise RecordingError(
            f"{target}: cannot be written ({problem(error.__cause__ or error)}); {source} is unchanged: "
            "free disk space, or choose another file"
        ) from error
    return Recovery(path=target, rallies=rallies, strokes=strokes, lost=lost)


def recoverable_files(folder: Path) -> list[Path]:
    """Unfinished files of a folder without a finished file of the same name.

    Raises:
        RecordingError: there are none.
    """
    found = [path for path in unfinished_files(folder) if not path.with_suffix("").exists()]
    if not found:
        raise RecordingError(f"{folder}: holds no unfinished rally log; name a damaged file to recover that")
    return found


def unfinished_files(path: Path) -> list[Path]:
    """Unfinished files of the logs in a folder, or of the log at a path."""
    if path.is_dir():
        return sorted(path.glob(f"*{unfinished(Path(SUFFIX)).name}"))
    parts = [unfinished(part_path(path, number)) for number in existing_parts(path)]
    return [part for part in parts if part.exists()]


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
    with damage(path):
        last = _last_part(path, rallies)
        if last is None:
            _delete(path, 0, header)
            return RallyLogWriter(path, header, **options)
        source = _source(part_path(path, last))
    before, batches = salvage(source)
    if before != header:
        raise RecordingError(f"{source}: another game, other policies or another seed than this run has; start again")
    writer = RallyLogWriter(path, before, leave_later=True, **options)
    for first, data, batch in batches:
        if writer.rallies == rallies or first != writer.rallies:
            break
        writer.write_message(first, data, batch)
    if writer.rallies != rallies:
        writer.abort()
        raise RecordingError(f"{source}: {rallies} rallies were played, {writer.rallies} are undamaged; start again")
    writer.flush()
    with damage(path):
        _delete(path, last + 1, header)
        source.unlink()
    return writer


def rallies_of_pairings(path: Path, pairings: int) -> int:
    """Number of rallies of an unfinished log, in all parts, of pairings below a number.

    Pairings must be recorded one after the other, in the order of their numbers.

    Raises:
        RecordingError: a file cannot be read or is not a rally log.
    """
    count = 0
    for number in existing_parts(path):
        for file in _files(part_path(path, number)):
            try:
                _, batches = salvage(file)
            except RecordingError:
                if number:  # the process was killed before it wrote the header
                    continue
                raise
            for first, _, batch in batches:
                if int(batch.pairing.max()) >= pairings:
                    return count
                count = first + len(batch)
    return count


def _files(part: Path) -> list[Path]:
    """The file of a part: set aside by a killed resumption, else finished, else unfinished."""
    return [file for file in (set_aside(part), part, unfinished(part)) if file.exists()][:1]


def _last_part(path: Path, rallies: int) -> int | None:
    """Number of the part with the last rally to keep; None: no rallies are kept.

    Raises:
        RecordingError: the part is missing.
    """
    if not rallies:
        return None
    last = None
    for number in existing_parts(path):
        for file in _files(part_path(path, number)):
            # A file without a header, of a process that was killed as it started the file, has no rallies.
            with contextlib.suppress(RecordingError):
                if read_header(content_of(file))[0].first_rally < rallies:
                    last = number
    if last is None:
        raise RecordingError(f"{unfinished(path).name}: is missing, with the {rallies} rallies that were played; start again")
    return last


def _source(part: Path) -> Path:
    old = set_aside(part)
    if old.exists():
        unfinished(part).unlink(missing_ok=True)  # an incomplete copy; the original is intact
    else:
        os.replace(_files(part)[0], old)
    return old


def _delete(path: Path, first: int, header: LogHeader) -> None:
    """Delete the parts of a log from this number on, the last part first.

    Raises:
        RecordingError: a finished part is of another log.
    """
    for number in reversed([number for number in existing_parts(path) if number >= first]):
        part = part_path(path, number)
        if part.exists() and read_header(content_of(part))[0] != header:
            raise RecordingError(f"{part.name} is the log of another run; delete it or choose another name")
        for file in (unfinished(part), part, set_aside(part)):
            file.unlink(missing_ok=True)
