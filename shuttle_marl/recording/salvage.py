"""Finds the whole batches of a rally log in any condition.

A chunk is found by how it begins and believed if its checksum fits, so batches behind a damaged stretch are found too.
"""

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mcap.opcode import Opcode
from mcap.records import Message

from shuttle_marl.recording.batch import decode
from shuttle_marl.recording.container import FRAME, UNDECODABLE, damage, message_of_chunk
from shuttle_marl.recording.header import LogHeader, read_header
from shuttle_marl.recording.schema import DamagedLogError, Rallies

_COMPRESSION: Final = struct.pack("<I", 4) + b"zstd"
_BEFORE_COMPRESSION: Final = FRAME.size + 8 + 8 + 8 + 4
"""Bytes of a chunk record before the name of its compression: the frame, two times, a size and a checksum."""


def salvage(path: Path) -> tuple[LogHeader, Iterator[tuple[int, bytes, Rallies]]]:
    """The header of a log file in any condition, and the number, message and rallies of every whole batch, in order.

    Raises:
        RecordingError: the file cannot be read or is no rally log; its header must be whole.
    """
    with damage(path), path.open("rb") as file:
        header, start = read_header(file, path.stat().st_size)
    return header, _whole_batches(path, header, start)


def _whole_batches(path: Path, header: LogHeader, start: int) -> Iterator[tuple[int, bytes, Rallies]]:
    done = header.first_rally
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
