"""Logs with accidents and with malice in them, for the fuzz test of all formats and the tests of hostile files."""

import dataclasses
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from mcap.reader import make_reader

from shuttle_marl.base.files import seal, unsealed
from shuttle_marl.recording import LogHeader, Rallies, RallyLog, RallyLogWriter
from shuttle_marl.recording.log_file import LogFileWriter, encode
from tests.recording.conftest import a_header, some_rallies

LENGTHS = (0, 1, 2**16, 2**31, 2**32 - 1, 2**32, 2**62, 2**63 - 1, 2**64 - 1)
JUNK: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    2**40,
    2**70,
    1.5,
    "",
    "x",
    [],
    [1, "a"],
    {},
    {"a": 1},
    ["smash:front-left:above:forehand"] * 300,
)


def mutated(content: bytes | memoryview, rng: np.random.Generator) -> bytes:
    """One to three of the usual accidents: bits flipped, bytes overwritten, a stretch cut out or doubled, the end cut off."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(max(1, len(data))))
        match rng.integers(7):
            case 0:
                data[at : at + 1] = bytes(byte ^ 1 << rng.integers(8) for byte in data[at : at + 1])
            case 1:
                data[at : at + 8] = rng.bytes(8)
            case 2:
                del data[at : at + int(rng.integers(1, 200))]
            case 3:
                data[at:at] = data[at : at + int(rng.integers(1, 200))]
            case 4:
                del data[at:]
            case 5:
                data[at : at + 8] = LENGTHS[rng.integers(len(LENGTHS))].to_bytes(8, "little")
            case _:
                data[at : at + 4] = (LENGTHS[rng.integers(len(LENGTHS))] & 0xFFFFFFFF).to_bytes(4, "little")
    return bytes(data)


class Mutator:
    """Makes bad logs out of good ones.

    Args:
        folder: an empty folder to work in.
        seed: of the mutations.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.path = folder / "bad.mcap"
        self.header = a_header(columns=("update", "value"))
        n = int((whole := some_rallies(60)).length.sum())
        extra: dict[str, Any] = {"update": np.arange(60, dtype=np.uint32), "value": np.linspace(-1, 1, n, dtype=np.float32)}
        self.rallies: Rallies = dataclasses.replace(whole, **extra)
        self.good = folder / "good.mcap"
        with RallyLogWriter(self.good, self.header, batch_rallies=16) as log:
            log.append(self.rallies)
        self.content = self.good.read_bytes()
        self.strokes = {first: batch.stroke.tobytes() for first, batch in RallyLog(self.good).batches()}
        assert len(self.strokes) == 4

    def make(self, kind: str) -> None:
        """Write the bad log of a kind."""
        self.path.unlink(missing_ok=True)
        getattr(self, kind)()

    def accident(self) -> None:
        """A file that was damaged."""
        self.path.write_bytes(mutated(self.content, self.rng))

    def message(self) -> None:
        """A wrong message with a right checksum."""
        part = self.rallies.slice(0, 30)
        self._write(self.header, mutated(encode(0, part, len(self.header.strokes)), self.rng), part)

    def index(self) -> None:
        """A wrong index with a right checksum."""
        content = bytearray(self.content)
        with self.good.open("rb") as file:
            [place] = make_reader(file).get_summary().attachment_indexes
        begin, end = place.offset + 9, place.offset + place.length
        at = int(self.rng.integers(begin, end - 4))
        value = LENGTHS[self.rng.integers(len(LENGTHS))].to_bytes(8, "little")[: end - 4 - at]
        content[at : at + len(value)] = value
        content[end - 4 : end] = zlib.crc32(content[begin : end - 4]).to_bytes(4, "little")
        self.path.write_bytes(content)

    def head(self) -> None:
        """A wrong header with a right checksum."""
        name = str(self.rng.choice([f.name for f in dataclasses.fields(LogHeader)]))
        self._write_strange(name, JUNK[self.rng.integers(len(JUNK))])

    def bomb(self) -> None:
        """A message of some kilobytes whose Arrow columns are compressed again: one rally of a hundred million strokes."""
        part = self.rallies.slice(0, 1)
        with pa.ipc.open_stream(encode(0, part, len(self.header.strokes))) as reader:
            batch = reader.read_next_batch()
        strokes = dict.fromkeys(batch.schema.names, None)
        for name in strokes:
            column = batch.column(name)
            if pa.types.is_list(column.type):
                values = np.zeros(100_000_000, column.type.value_type.to_pandas_dtype())
                offsets = pa.array([0, len(values)], pa.int32())
                column = pa.ListArray.from_arrays(offsets, pa.array(values, column.type.value_type), type=column.type)
            strokes[name] = column
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, batch.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as writer:
            writer.write_batch(pa.RecordBatch.from_arrays(list(strokes.values()), schema=batch.schema))
        self._write(self.header, sink.getvalue().to_pybytes(), part)

    def zeros(self) -> None:
        """A log with a chunk of zeros, in the place of its second quarter."""
        content = bytearray(self.content)
        begin = len(content) // 4
        content[begin : 2 * begin] = bytes(begin)
        self.path.write_bytes(content)

    def names(self) -> None:
        """A log whose policies have names of a million characters."""
        self._write_strange("policies", [{"name": f"{i}" * 10**6, "hash": ""} for i in range(3)])

    def _write_strange(self, name: str, value: Any) -> None:
        header = StrangeHeader(**{f.name: getattr(self.header, f.name) for f in dataclasses.fields(LogHeader)})
        header.strange[name] = value
        part = self.rallies.slice(0, 30)
        self._write(header, encode(0, part, len(header.strokes)), part)

    def _write(self, header: LogHeader, message: bytes | memoryview, part: Rallies) -> None:
        with self.path.open("wb") as file:
            log = LogFileWriter(file, header)
            log.write(0, message, part)
            log.finish()


class StrangeHeader(LogHeader):
    """A header that is written with other values in some fields."""

    @property
    def strange(self) -> dict[str, Any]:
        return self.__dict__.setdefault("_strange", {})

    def to_metadata(self) -> dict[str, str]:
        metadata = super().to_metadata()
        fields = {**unsealed(metadata["header"].encode()), **self.strange}
        return {**metadata, "header": seal(fields).decode()}
