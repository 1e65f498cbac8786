"""One schema for recorded rallies: a row a rally, its strokes in a list. Version 1; see ``docs/rally_log.md``."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.errors import ShuttleError

VERSION: Final = 1

_ROW: Final = (
    ("pairing", pa.uint32()),
    ("match", pa.uint32()),
    ("rally", pa.uint16()),
    ("policy_0", pa.uint16()),
    ("policy_1", pa.uint16()),
    ("server", pa.uint8()),
    ("winner", pa.uint8()),
    ("reason", pa.uint8()),
    ("points_0", pa.uint8()),
    ("points_1", pa.uint8()),
    ("games_0", pa.uint8()),
    ("games_1", pa.uint8()),
)
_SCORE: Final = ("points_0", "points_1", "games_0", "games_1")


class RecordingError(ShuttleError):
    """A log that cannot be written, or a file that is no rally log of this version."""


class DamagedLogError(RecordingError):
    """A rally log that was cut off or changed after it was written."""


@functools.cache
def arrow_schema(n_strokes: int) -> pa.Schema:
    """Columns of a log of a game with ``n_strokes`` strokes: stroke numbers take one byte up to 256 strokes, else two."""
    stroke = pa.uint8() if n_strokes <= 256 else pa.uint16()
    strokes = pa.list_(pa.field("stroke", stroke, nullable=False))
    fields = [pa.field(name, kind, nullable=False) for name, kind in _ROW]
    return pa.schema([*fields, pa.field("strokes", strokes, nullable=False)])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rallies:
    """R rallies of N strokes in all, as arrays.

    Attributes:
        pairing: ``[R]`` uint32 index into the pairings of the log's header.
        match: ``[R]`` uint32 number of the match within its pairing.
        rally: ``[R]`` uint16 number of the rally within its match.
        policy: ``[R, 2]`` uint16 who sat at seats 0 and 1, an index into the policies of the header.
        server: ``[R]`` uint8 seat that served; seats then strike in turn.
        winner: ``[R]`` uint8 seat that won the rally.
        reason: ``[R]`` uint8 how the last stroke ended it: 0 a fault, 1 a winner.
        score: ``[R, 4]`` uint8 points of seats 0 and 1 and games of seats 0 and 1 before the rally.
        length: ``[R]`` int32 number of strokes, at least 1.
        stroke: ``[N]`` uint8 or uint16 catalogue index of every stroke, rally after rally.
    """

    pairing: npt.NDArray[np.uint32]
    match: npt.NDArray[np.uint32]
    rally: npt.NDArray[np.uint16]
    policy: npt.NDArray[np.uint16]
    server: npt.NDArray[np.uint8]
    winner: npt.NDArray[np.uint8]
    reason: npt.NDArray[np.uint8]
    score: npt.NDArray[np.uint8]
    length: npt.NDArray[np.int32]
    stroke: npt.NDArray[np.unsignedinteger]

    def __len__(self) -> int:
        return len(self.length)

    @functools.cached_property
    def first_stroke(self) -> npt.NDArray[np.int64]:
        """``[R + 1]`` where the strokes of each rally begin in ``stroke``, and their number."""
        return np.r_[0, np.cumsum(self.length, dtype=np.int64)]

    def part(self, first: int, last: int) -> "Rallies":
        """Rows ``first`` up to ``last``, without a copy."""
        a, b = self.first_stroke[[first, last]]
        columns = {f.name: getattr(self, f.name)[first:last] for f in dataclasses.fields(self) if f.name != "stroke"}
        return Rallies(**columns, stroke=self.stroke[a:b])

    @classmethod
    def join(cls, parts: Sequence["Rallies"]) -> "Rallies":
        """Rows of several parts, one after the other."""
        return cls(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(cls)})

    def to_arrow(self, n_strokes: int) -> pa.RecordBatch:
        """The rows as :func:`arrow_schema` has them."""
        schema = arrow_schema(n_strokes)
        columns = {
            "pairing": self.pairing,
            "match": self.match,
            "rally": self.rally,
            **{f"policy_{seat}": self.policy[:, seat] for seat in (0, 1)},
            "server": self.server,
            "winner": self.winner,
            "reason": self.reason,
            **{name: self.score[:, i] for i, name in enumerate(_SCORE)},
        }
        arrays = [pa.array(np.ascontiguousarray(columns[name]), kind) for name, kind in _ROW]
        kind = schema.field("strokes").type
        offsets = pa.array(self.first_stroke.astype(np.int32))
        values = pa.array(np.ascontiguousarray(self.stroke), kind.value_type)
        return pa.RecordBatch.from_arrays([*arrays, pa.ListArray.from_arrays(offsets, values, type=kind)], schema=schema)

    @classmethod
    def from_arrow(cls, batch: pa.RecordBatch) -> "Rallies":
        """The arrays of a batch with the columns of :func:`arrow_schema`."""
        column = {name: batch.column(name).to_numpy(zero_copy_only=False) for name, _ in _ROW}
        strokes = batch.column("strokes")
        return cls(
            **{name: column[name] for name in ("pairing", "match", "rally", "server", "winner", "reason")},
            policy=np.stack([column["policy_0"], column["policy_1"]], axis=1),
            score=np.stack([column[name] for name in _SCORE], axis=1),
            length=np.diff(strokes.offsets.to_numpy()).astype(np.int32),
            stroke=strokes.flatten().to_numpy(zero_copy_only=False),
        )
