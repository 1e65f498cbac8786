"""Write the records of a rally log to an open file.

A batch of rallies is one message in one chunk, and is passed to the operating system before a call returns.
"""

from typing import BinaryIO, Final, cast

import numpy as np
import pyarrow as pa
from mcap.writer import CompressionType, Writer

from shuttle_marl.game.rally import Rallies
from shuttle_marl.recording.chunks import RALLY_TIME, arrow_schema, arrow_stream
from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.log_file import INDEX_NAME, INDEX_SCHEMA, METADATA, PROFILE, TOPIC

_ARROW_STREAM: Final = "application/vnd.apache.arrow.stream"


class LogFileWriter:
    """Writes one file of a log.

    Attributes:
        size: bytes written so far.
        rallies: number of the last rally plus one.
    """

    def __init__(self, file: BinaryIO, header: LogHeader) -> None:
        """Write the header.

        Raises:
            OSError: the disk is full or fails.
        """
        self._file = file
        self._index: list[tuple[int, ...]] = []
        self.header, self.rallies = header, header.first_rally
        self._mcap = Writer(file, chunk_size=1, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._mcap.start(profile=PROFILE, library=header.software)
        self._mcap.add_metadata(METADATA, header.to_metadata())
        columns = arrow_schema(len(header.strokes), header.columns).serialize().to_pybytes()
        schema = self._mcap.register_schema("shuttle_marl.Rallies", "arrow", columns)
        self._channel = self._mcap.register_channel(TOPIC, "arrow_stream", schema)
        self._flush()

    def write(self, first: int, data: bytes | memoryview, rallies: Rallies) -> None:
        """Write one batch.

        Args:
            first: number of its first rally, not below :attr:`rallies`.
            data: the batch, encoded by :func:`shuttle_marl.recording.chunks.encode`.

        Raises:
            OSError: the disk is full or fails.
        """
        match = rallies.pairing.astype(np.uint64) << np.uint64(32) | rallies.match
        row = (first, len(rallies), len(rallies.stroke), self.size, int(match.min()), int(match.max()))
        # One message per chunk, so a kill loses at most the batch that is being written.
        self._mcap.add_message(self._channel, first * RALLY_TIME, cast(bytes, data), first * RALLY_TIME, len(self._index))
        self._flush()
        self._index.append(row)
        self.rallies = first + len(rallies)

    def finish(self) -> None:
        """Write the index.

        Raises:
            OSError: the disk is full or fails.
        """
        columns = np.array(self._index, np.uint64).reshape(-1, len(INDEX_SCHEMA)).T
        index = arrow_stream(pa.RecordBatch.from_arrays([pa.array(column) for column in columns], schema=INDEX_SCHEMA))
        self._mcap.add_attachment(0, self.rallies * RALLY_TIME, INDEX_NAME, _ARROW_STREAM, index.to_pybytes())
        self._mcap.finish()  # type: ignore[no-untyped-call]
        self._flush()

    def _flush(self) -> None:
        self._file.flush()
        self.size = self._file.tell()
