"""Recorded rallies as Arrow tables with names in place of numbers: a row a rally, or a row a stroke."""

from typing import Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.rally import OUTCOMES, RETURNED_BELOW
from shuttle_marl.recording.header import LogHeader
from shuttle_marl.recording.schema import Rallies
from shuttle_marl.stroke import Catalogue


class _Log(Protocol):
    @property
    def header(self) -> LogHeader: ...
    @property
    def catalogue(self) -> Catalogue: ...


def rows_of_strokes(rallies: Rallies) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """``[N]`` each: row of the rally a stroke belongs to, its position in it from 0, and the seat that struck it."""
    row = np.repeat(np.arange(len(rallies)), rallies.length)
    position = np.arange(len(row)) - rallies.first_stroke[row]
    return row, position, (rallies.server[row] + position) & 1


def outcomes(rallies: Rallies, catalogue: Catalogue) -> npt.NDArray[np.int8]:
    """``[N]`` outcome of every stroke (index into OUTCOMES): the contact of a return is the height of the next stroke."""
    following = np.r_[catalogue.height[rallies.stroke[1:]], np.int8(0)][: len(rallies.stroke)] + RETURNED_BELOW
    following[rallies.first_stroke[1:] - 1] = rallies.reason
    return following.astype(np.int8)


def rally_rows(log: _Log, first: int, rallies: Rallies) -> pa.Table:
    """A batch as a table of rallies.

    Returns:
        Columns ``number`` (uint64, the rally's number in the log), the columns of the log with the names of the policies
        (dictionary) in ``policy_0`` and ``policy_1``, ``reason`` in words (dictionary), and ``length`` (int32) before
        ``strokes``.
    """
    table = pa.Table.from_batches([rallies.to_arrow(len(log.catalogue))])
    names = [player.name for player in log.header.policies]
    for seat in (0, 1):
        at = table.schema.get_field_index(f"policy_{seat}")
        table = table.set_column(at, f"policy_{seat}", _words(rallies.policy[:, seat], names))
    table = table.set_column(table.schema.get_field_index("reason"), "reason", _words(rallies.reason, OUTCOMES[:2]))
    table = table.add_column(table.num_columns - 1, "length", pa.array(rallies.length))
    return table.add_column(0, "number", pa.array(np.arange(first, first + len(rallies), dtype=np.uint64)))


def stroke_rows(log: _Log, first: int, rallies: Rallies) -> pa.Table:
    """A batch as a table of strokes.

    Returns:
        Columns ``number`` (uint64, of the rally), ``position`` (int32, from 0), ``seat`` (uint8), and as dictionaries
        ``policy``, ``stroke`` (its name) and ``outcome``.
    """
    row, position, seat = rows_of_strokes(rallies)
    return pa.table(
        {
            "number": (first + row).astype(np.uint64),
            "position": position.astype(np.int32),
            "seat": seat.astype(np.uint8),
            "policy": _words(rallies.policy[row, seat], [player.name for player in log.header.policies]),
            "stroke": _words(rallies.stroke, log.catalogue.names),
            "outcome": _words(outcomes(rallies, log.catalogue), OUTCOMES),
        }
    )


def _words(numbers: npt.NDArray[np.integer], words: tuple[str, ...] | list[str]) -> pa.DictionaryArray:
    return pa.DictionaryArray.from_arrays(pa.array(numbers.astype(np.int32)), pa.array(words, pa.string()))
