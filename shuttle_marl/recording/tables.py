"""Recorded rallies as Arrow tables with names in place of numbers: a row a rally, or a row a stroke."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.arrays import Ints
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.rally.record import PER_STROKE, Rallies
from shuttle_marl.recording.header import Player
from shuttle_marl.recording.log_file import LogFile
from shuttle_marl.recording.schema import to_arrow

Derive = Callable[[Rallies], dict[str, npt.NDArray[np.generic]]]
"""Makes further columns ``[N]`` of the strokes of a batch."""


class _Log(Protocol):
    @property
    def policies(self) -> Sequence[Player]: ...
    @property
    def catalogue(self) -> Catalogue: ...
    @property
    def files(self) -> Sequence[LogFile]: ...
    def file_of(self, number: int) -> int: ...


def rally_rows(log: _Log, first: int, rallies: Rallies) -> pa.Table:
    """A batch as a table of rallies.

    Returns:
        Columns ``number`` (uint64, the rally's number in the log), ``file`` (dictionary) and ``seed`` (uint64) of the file
        it stands in, the columns of the log with the names of the policies (dictionary) in ``policy_0`` and ``policy_1``,
        ``reason`` in words (dictionary), and ``length`` (int32) before ``strokes``.
    """
    table = pa.Table.from_batches([to_arrow(rallies, len(log.catalogue))])
    names = [player.name for player in log.policies]
    for seat in (0, 1):
        at = table.schema.get_field_index(f"policy_{seat}")
        table = table.set_column(at, f"policy_{seat}", _words(rallies.policy[:, seat], names))
    table = table.set_column(table.schema.get_field_index("reason"), "reason", _words(rallies.reason, OUTCOMES[:2]))
    table = table.add_column(table.schema.get_field_index("strokes"), "length", pa.array(rallies.length))
    file = np.full(len(rallies), log.file_of(first))
    seeds = np.array([file.header.seed % 2**64 for file in log.files], dtype=np.uint64)
    table = table.add_column(0, "seed", pa.array(seeds[file]))
    table = table.add_column(0, "file", _words(file, [file.path.name for file in log.files]))
    return table.add_column(0, "number", pa.array(np.arange(first, first + len(rallies), dtype=np.uint64)))


def stroke_rows(log: _Log, first: int, rallies: Rallies, derive: Derive | None = None) -> pa.Table:
    """A batch as a table of strokes.

    Args:
        log: where it stands.
        first: number of its first rally.
        rallies: the batch.
        derive: makes further columns, which stand behind the others.

    Returns:
        Columns ``number`` (uint64, of the rally), ``position`` (int32, from 0), ``seat`` (uint8), and as dictionaries
        ``policy``, ``stroke`` (its name) and ``outcome``; then those that the log has of ``log_probability`` and ``value``.
    """
    row, seat = rallies.row_of_stroke, rallies.striker
    further = {name: getattr(rallies, name) for name in rallies.optional_columns if name in PER_STROKE}
    if derive is not None:
        further |= derive(rallies)
    return pa.table(
        {
            "number": (first + row).astype(np.uint64),
            "position": rallies.position.astype(np.int32),
            "seat": seat.astype(np.uint8),
            "policy": _words(rallies.policy[row, seat], [player.name for player in log.policies]),
            "stroke": _words(rallies.stroke, log.catalogue.names),
            "outcome": _words(rallies.outcome(log.catalogue), OUTCOMES),
            **further,
        }
    )


def _words(numbers: Ints, words: Sequence[str]) -> pa.DictionaryArray:
    unique = list(dict.fromkeys(words))
    if len(unique) < len(words):  # policies of several runs that differ in more than their names
        numbers = np.array([unique.index(word) for word in words], dtype=np.int32)[numbers]
    return pa.DictionaryArray.from_arrays(pa.array(numbers.astype(np.int32)), pa.array(unique, pa.string()))
