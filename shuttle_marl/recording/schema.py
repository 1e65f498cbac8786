"""One schema for recorded rallies: a row a rally, its strokes in a list. Version 2; see ``docs/rally_log.md``."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.arrays import F32, I32, I64, U8, U16, U32, Bools, UInts
from shuttle_marl.errors import ShuttleError

VERSION: Final = 2

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

UPDATE: Final = "update"
OF_STROKES: Final = ("log_probability", "value")
EXTRA_COLUMNS: Final = (UPDATE, *OF_STROKES)
"""Columns that a log has if its header names them."""


class RecordingError(ShuttleError):
    """A log that cannot be written, or a file that is no rally log of this version."""


class DamagedLogError(RecordingError):
    """A rally log that was cut off or changed after it was written."""


class OtherFileError(RecordingError):
    """A file that is no rally log at all."""


@functools.cache
def arrow_schema(n_strokes: int, columns: tuple[str, ...] = ()) -> pa.Schema:
    """Columns of a log: stroke numbers take one byte in a game of up to 256 strokes, else two.

    Args:
        n_strokes: number of strokes in the game.
        columns: those of :data:`EXTRA_COLUMNS` that the log has.
    """
    fields = [pa.field(name, kind, nullable=False) for name, kind in _ROW]
    if UPDATE in columns:
        fields.append(pa.field(UPDATE, pa.uint32(), nullable=False))
    fields.append(_list("strokes", "stroke", pa.uint8() if n_strokes <= 256 else pa.uint16()))
    fields += [_list(name, name, pa.float32()) for name in OF_STROKES if name in columns]
    return pa.schema(fields)


def _list(name: str, item: str, kind: pa.DataType) -> pa.Field:
    return pa.field(name, pa.list_(pa.field(item, kind, nullable=False)), nullable=False)


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
        update: ``[R]`` uint32 how many updates the learner had made when the rally ended; None: not recorded.
        log_probability: ``[N]`` float32 log of the probability with which the striker chose the stroke, NaN where it is unknown;
            None: not recorded.
        value: ``[N]`` float32 what the striker expected of the rally before the stroke, NaN where it is unknown; None: not
            recorded.
    """

    pairing: U32
    match: U32
    rally: U16
    policy: U16
    server: U8
    winner: U8
    reason: U8
    score: U8
    length: I32
    stroke: UInts
    update: U32 | None = None
    log_probability: F32 | None = None
    value: F32 | None = None

    def __len__(self) -> int:
        return len(self.length)

    @functools.cached_property
    def first_stroke(self) -> I64:
        """``[R + 1]`` index of the first stroke of each rally in ``stroke``, and the number of strokes."""
        return np.r_[0, np.cumsum(self.length, dtype=np.int64)]

    @property
    def columns(self) -> tuple[str, ...]:
        """Those of :data:`EXTRA_COLUMNS` that are recorded."""
        return tuple(name for name in EXTRA_COLUMNS if getattr(self, name) is not None)

    def part(self, first: int, last: int) -> "Rallies":
        """Rows ``first`` up to ``last``, without a copy."""
        a, b = self.first_stroke[[first, last]]
        return Rallies(**{name: column[a:b] if of_strokes else column[first:last] for name, column, of_strokes in self._each()})

    def select(self, rows: Bools) -> "Rallies":
        """The rows where ``rows`` ``[R]`` is true."""
        strokes = np.repeat(rows, self.length)
        return Rallies(**{name: column[strokes if of_strokes else rows] for name, column, of_strokes in self._each()})

    @classmethod
    def join(cls, parts: Sequence["Rallies"]) -> "Rallies":
        """Rows of several parts with the same columns, one after the other."""
        names = [name for name, _, _ in parts[0]._each()]
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    def to_arrow(self, n_strokes: int) -> pa.RecordBatch:
        """The rows as :func:`arrow_schema` has them."""
        schema = arrow_schema(n_strokes, self.columns)
        columns: dict[str, npt.NDArray[Any] | None] = {
            "pairing": self.pairing,
            "match": self.match,
            "rally": self.rally,
            **{f"policy_{seat}": self.policy[:, seat] for seat in (0, 1)},
            "server": self.server,
            "winner": self.winner,
            "reason": self.reason,
            **{name: self.score[:, i] for i, name in enumerate(_SCORE)},
            "update": self.update,
            "strokes": self.stroke,
            "log_probability": self.log_probability,
            "value": self.value,
        }
        offsets = pa.array(self.first_stroke.astype(np.int32))
        arrays = []
        for field in schema:
            column = np.ascontiguousarray(columns[field.name])
            if pa.types.is_list(field.type):
                arrays.append(pa.ListArray.from_arrays(offsets, pa.array(column, field.type.value_type), type=field.type))
            else:
                arrays.append(pa.array(column, field.type))
        return pa.RecordBatch.from_arrays(arrays, schema=schema)

    @classmethod
    def from_arrow(cls, batch: pa.RecordBatch) -> "Rallies":
        """The arrays of a batch with the columns of :func:`arrow_schema`.

        Raises:
            DamagedLogError: lists of different lengths in one row.
        """
        column = {name: batch.column(name).to_numpy(zero_copy_only=False) for name, _ in _ROW}
        strokes = batch.column("strokes")
        length = np.diff(strokes.offsets.to_numpy()).astype(np.int32)
        extra: dict[str, npt.NDArray[Any]] = {}
        for name in (name for name in EXTRA_COLUMNS if name in batch.schema.names):
            found = batch.column(name)
            if name in OF_STROKES:
                if not np.array_equal(np.diff(found.offsets.to_numpy()), length):
                    raise DamagedLogError(f"a rally with another number of strokes than of {name}")
                found = found.flatten()
            extra[name] = found.to_numpy(zero_copy_only=False)
        return cls(
            **{name: column[name] for name in ("pairing", "match", "rally", "server", "winner", "reason")},
            policy=np.stack([column["policy_0"], column["policy_1"]], axis=1),
            score=np.stack([column[name] for name in _SCORE], axis=1),
            length=length,
            stroke=strokes.flatten().to_numpy(zero_copy_only=False),
            **extra,
        )

    def _each(self) -> list[tuple[str, npt.NDArray[Any], bool]]:
        """Name and array of every column that is there, and whether it has a row a stroke."""
        names = [f.name for f in dataclasses.fields(self) if getattr(self, f.name) is not None]
        return [(name, getattr(self, name), name == "stroke" or name in OF_STROKES) for name in names]
