"""One batch of rallies as the data of one MCAP message: an Arrow stream that holds one record batch."""

import numpy as np
import pyarrow as pa
from mcap.records import Message

from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.schema import VERSION, DamagedLogError, Rallies, arrow_schema

RALLY_TIME = 1_000_000
"""Log time that a rally takes [ns]: the log time of a batch is the number of its first rally times this."""


def encode(first: int, rallies: Rallies, n_strokes: int) -> bytes:
    """The message of a batch whose first rally has number ``first``."""
    batch = rallies.to_arrow(n_strokes)
    batch = batch.replace_schema_metadata({"version": str(VERSION), "first_rally": str(first)})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    data: bytes = sink.getvalue().to_pybytes()
    return data


def decode(message: Message, header: LogHeader) -> tuple[int, Rallies]:
    """Number of the first rally, and the rallies; every number in them points at something.

    Raises:
        DamagedLogError: the message holds something else.
        pa.ArrowException: it holds no Arrow stream.
    """
    batch = _read(message.data)
    metadata = batch.schema.metadata or {}
    if (
        not batch.schema.equals(arrow_schema(len(header.strokes), header.columns))
        or metadata.get(b"version") != str(VERSION).encode()
    ):
        raise DamagedLogError(f"a batch with other columns than version {VERSION} has")
    first = int(metadata.get(b"first_rally", b"-1"))
    if first < 0 or first * RALLY_TIME != message.log_time or not batch.num_rows:
        raise DamagedLogError("a batch without a place in the log")
    rallies = Rallies.from_arrow(batch)
    _check(rallies, header)
    return first, rallies


def _read(data: bytes) -> pa.RecordBatch:
    try:
        with pa.ipc.open_stream(data) as reader:
            batches = list(reader)
    except OSError as error:  # of Arrow, about the bytes: no file is involved
        raise DamagedLogError(f"a batch that is no Arrow stream ({error})") from error
    if len(batches) != 1:
        raise DamagedLogError(f"{len(batches)} Arrow batches in a message, expected 1")
    batches[0].validate(full=True)
    return batches[0]


def _check(rallies: Rallies, header: LogHeader) -> None:
    for what, numbers, limit in (
        ("seat", rallies.server, 2),
        ("seat", rallies.winner, 2),
        ("reason", rallies.reason, 2),
        ("policy", rallies.policy, len(header.policies)),
        ("pairing", rallies.pairing, len(header.pairings)),
        ("stroke", rallies.stroke, len(header.strokes)),
    ):
        most = int(np.max(numbers))
        if most >= limit:
            raise DamagedLogError(f"{what} {most} in a batch, expected less than {limit}")
    if int(rallies.length.min()) < 1 or int(rallies.length.sum(dtype=np.int64)) != len(rallies.stroke):
        raise DamagedLogError("a rally without strokes")
