"""Exports of a log as CSV, Parquet and Arrow tables, and columns of strokes that follow from the game."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from shuttle_marl.base.files import replacing
from shuttle_marl.base.table_files import PARQUET, seal_parquet, without_formulas
from shuttle_marl.game.rally.record import Rallies
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.recording.header import RecordingError
from shuttle_marl.recording.reader import RallyLog, rally_rows, stroke_rows
from shuttle_marl.recording.replay import require_game

_WRITERS: Final[dict[str, Callable[[BinaryIO, pa.Schema], Any]]] = {
    ".parquet": lambda file, schema: pyarrow.parquet.ParquetWriter(file, schema, **PARQUET),
    ".csv": pyarrow.csv.CSVWriter,
    ".arrow": pa.ipc.new_file,
}


class Derived:
    """Columns of strokes that follow from the game; the ``derive`` of :meth:`shuttle_marl.recording.RallyLog.stroke_table`.

    Args:
        policies: tabulated policies by name; adds the probability with which they chose each stroke.

    Raises:
        RecordingError: the log was played on another game.
    """

    def __init__(self, log: RallyLog, game: Game, policies: Mapping[str, TabulatedPolicy] | None = None) -> None:
        require_game(log, game)
        self._game = game
        chosen = policies or {}
        self._policies = {i: chosen[player.name] for i, player in enumerate(log.policies) if player.name in chosen}

    def __call__(self, rallies: Rallies) -> dict[str, npt.NDArray[np.generic]]:
        """Columns of the strokes of a batch.

        Returns:
            ``[N]`` each: ``state`` (int32), ``p_succ`` that the stroke is good, ``p_ret`` that a good one is returned and
            ``p_above`` that this happens above the net (float64), and with policies ``probability`` (float64) with which
            the striker's policy chooses the stroke, NaN for other policies. Illegal strokes have state -1 and probabilities NaN.
        """
        state, k = rallies.legal(self._game)
        pair = self._game.pair_at(np.maximum(state, 0), np.maximum(k, 0))
        names = ("p_succ", "p_ret", "p_above")
        first, second = (tables.stroke_probabilities(pair) for tables in self._game.seats)
        known = [np.where(rallies.striker, *both) for both in zip(second, first, strict=True)]
        columns = {name: np.where(state < 0, np.nan, p) for name, p in zip(names, known, strict=True)}
        found: dict[str, npt.NDArray[np.generic]] = {"state": state, **columns}
        if self._policies:
            striker = rallies.policy[rallies.row_of_stroke, rallies.striker]
            probability = np.full(len(state), np.nan)
            for i, policy in self._policies.items():
                mine = (striker == i) & (state >= 0)
                probability[mine] = policy.probability_of(pair[mine])
            found["probability"] = probability
        return found


def export(source: Path, target: Path, rows: Literal["rallies", "strokes"], game: Game | None = None) -> int:
    """Write a log as a table, complete or not at all.

    Args:
        target: replaced if it exists. Ends in ``.parquet`` (with checksums, see :mod:`shuttle_marl.base.table_files`), ``.csv``
            (lists as texts with spaces between their items; names that a spreadsheet would take for formulas begin with an
            apostrophe) or ``.arrow``.
        rows: one row a rally or a stroke, with the columns of :mod:`shuttle_marl.recording.reader`.
        game: adds to strokes what follows from the game that was played on, see :class:`Derived`.

    Returns:
        The number of rows.

    Raises:
        RecordingError: an unknown suffix, or a log that cannot be read or was played on another game.
        FileWriteError: the table cannot be written.
    """
    open_writer = _WRITERS.get(target.suffix)
    if open_writer is None:
        raise RecordingError(f"{target}: expected a name that ends in {', '.join(_WRITERS)}")
    flat = target.suffix == ".csv"
    count = 0
    with RallyLog(source) as log:
        derive = None if game is None else Derived(log, game)

        def rows_of(first: int, rallies: Rallies) -> pa.Table:
            table = rally_rows(log, first, rallies) if rows == "rallies" else stroke_rows(log, first, rallies, derive)
            return _columns(table, log, flat)

        with replacing(target) as file:
            with open_writer(file, rows_of(0, log.no_rallies()).schema) as writer:
                for batch in log.batches():
                    table = rows_of(*batch)
                    writer.write_table(table)
                    count += table.num_rows
            if target.suffix == ".parquet":
                seal_parquet(file)
    return count


def _columns(table: pa.Table, log: RallyLog, flat: bool) -> pa.Table:
    if not flat:
        return table
    table = without_formulas(table)
    for at, field in enumerate(table.schema):
        column = table.column(at)
        if pa.types.is_list(field.type):
            names = pa.array(log.catalogue.names) if field.name == "strokes" else None
            words = [chunk.values.cast(pa.string()) if names is None else names.take(chunk.values) for chunk in column.chunks]
            texts = [
                pa.compute.binary_join(pa.ListArray.from_arrays(chunk.offsets, values), " ")
                for chunk, values in zip(column.chunks, words, strict=True)
            ]
            table = table.set_column(at, field.name, pa.chunked_array(texts, pa.string()))
    return table
