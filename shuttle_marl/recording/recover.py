"""Makes a rally log whole that was cut off or damaged.

A chunk is found by how it begins and believed if its checksum fits, so batches behind a damaged stretch are saved too.
"""

import dataclasses
import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mcap.opcode import Opcode
from mcap.records import Message

from shuttle_marl.recording.batch import decode
from shuttle_marl.recording.container import FRAME, UNDECODABLE, damage, message_of_chunk
from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.reader import read_header
from shuttle_marl.recording.schema import DamagedLogError, Rallies, RecordingError
from shuttle_marl.recording.writer import RallyLogWriter, part_of

_COMPRESSION: Final = struct.pack("<I", 4) + b"zstd"
_BEFORE_COMPRESSION: Final = FRAME.size + 8 + 8 + 8 + 4
"""Bytes of a chunk record before the name of its compression: the frame, two times, a size and a checksum."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recovery:
    """What :func:`recover` found.

    Attributes:
        path: the new log.
        rallies: number of rallies saved.
        strokes: number of strokes saved.
        lost: number of rallies known to be lost between those that were saved; what was cut off behind them is unknown.
    """

    path: Path
    rallies: int
    strokes: int
    lost: int


def salvage(path: Path) -> tuple[LogHeader, Iterator[tuple[int, bytes, Rallies]]]:
    """The header of a log in any condition, and the number, message and rallies of every whole batch, in order.

    Raises:
        RecordingError: the file cannot be read or is no rally log; its header must be whole.
    """
    with damage(path), path.open("rb") as file:
        header, start = read_header(file, path.stat().st_size)
    return header, _whole_batches(path, header, start)


def _whole_batches(path: Path, header: LogHeader, start: int) -> Iterator[tuple[int, bytes, Rallies]]:
    done = 0
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = start
        while (found := data.find(_COMPRESSION, at)) >= 0:
            at = found + 1
            chunk = found - _BEFORE_COMPRESSION
            message = _message(data, chunk) if chunk >= start else None
            if message is None:
                continue
            try:
                first, rallies = decode(message, header)
            except (DamagedLogError, *UNDECODABLE):
                continue
            if first >= done:
                yield first, message.data, rallies
                done = first + len(rallies)
            at = chunk + FRAME.size + FRAME.unpack_from(data, chunk)[1]


def _message(data: mmap.mmap, chunk: int) -> Message | None:
    opcode, length = FRAME.unpack_from(data, chunk)
    begin = chunk + FRAME.size
    if opcode != Opcode.CHUNK or length > len(data) - begin:
        return None
    try:
        return message_of_chunk(data[begin : begin + length])
    except (DamagedLogError, *UNDECODABLE):
        return None


def recover(source: Path, target: Path | None = None) -> Recovery:
    """Write a whole log of every batch that can be read from a damaged or unfinished one; ``source`` stays as it is.

    Args:
        source: a log in any condition, ``FILE.part`` included.
        target: the new log; must not exist. Default: ``FILE`` for ``FILE.part``, else ``NAME.recovered.mcap`` beside it.

    Raises:
        RecordingError: the source is no rally log or its header is damaged, or the target exists or cannot be written.
    """
    if target is None:
        target = source.with_suffix("") if source.suffix == ".part" else source.with_name(f"{source.stem}.recovered.mcap")
    header, batches = salvage(source)
    # Written under a name of its own, because ``target.part`` may be the source.
    making = target.with_name(target.name + ".recovering")
    if target.exists():
        raise RecordingError(f"{target}: exists already; name another file for the recovered log")
    for left_by_a_kill in (making, part_of(making)):
        left_by_a_kill.unlink(missing_ok=True)
    saved = strokes = lost = 0
    with RallyLogWriter(making, header) as log:
        for first, data, rallies in batches:
            lost += first - log.rallies
            log.write_message(first, data, rallies)
            saved, strokes = saved + len(rallies), strokes + len(rallies.stroke)
    making.replace(target)
    return Recovery(path=target, rallies=saved, strokes=strokes, lost=lost)
