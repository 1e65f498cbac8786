"""Stroke tables from anything that holds strokes: annotated matches, stroke tables, rally logs."""

from pathlib import Path

import numpy as np
import pyarrow as pa

from shuttle_marl.analysis.summary import AnalysisError
from shuttle_marl.data import load_strokes
from shuttle_marl.data.schema import STROKES
from shuttle_marl.recording import Rallies, RallyLog
from shuttle_marl.recording.log_file import SUFFIX
from shuttle_marl.recording.stroke_table import stroke_table

RALLIES = 20_000
"""About so many rallies of a log are looked at, unless more are asked for."""


def strokes_of(path: Path, *, rallies: int = RALLIES, seed: int = 0) -> pa.Table:
    """The strokes of a rally log (a file or a folder of logs), of a Parquet file, or of a folder with annotated matches.

    Args:
        path: where they are.
        rallies: about how many rallies of a log are taken.
        seed: of the points and times that a log does not hold.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`.

    Raises:
        RecordingError: a log that cannot be read.
        DataError: no such file, or an unreadable one.
        AnalysisError: there is no stroke in it.
    """
    if path.suffix == SUFFIX or (path.is_dir() and any(path.glob(f"*{SUFFIX}"))):
        with RallyLog(path) as log:
            strokes = strokes_of_log(log, rallies=rallies, seed=seed)
    else:
        strokes = load_strokes(path)
    if not strokes.num_rows:
        raise AnalysisError(f"{path}: holds no stroke; play or convert some first")
    return strokes


def strokes_of_log(log: RallyLog, *, rallies: int = RALLIES, seed: int = 0) -> pa.Table:
    """Strokes of a rally log in the schema of annotated matches, whole batches of it evenly spread over the log.

    A log holds decisions and outcomes; points on the court and times are drawn as in simulated tables
    (:func:`shuttle_marl.recording.stroke_table.stroke_table`). A match is named by its pairing and its number; where every
    rally stands for itself, it is a match of its own.

    Args:
        log: the log.
        rallies: about how many rallies are taken; all if the log has no more.
        seed: of points and times.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`, source ``simulated``.
    """
    batches = len(log.rallies)
    wanted = min(batches, max(1, round(batches * min(1.0, rallies / max(1, log.n_rallies)))))
    rng = np.random.default_rng([seed, wanted])
    if not batches:
        return STROKES.empty_table()
    chosen = np.unique(np.linspace(0, batches - 1, wanted).round().astype(int))
    return pa.concat_tables([_table(log, log.batch(int(i))[1], rng) for i in chosen])


def _table(log: RallyLog, rallies: Rallies, rng: np.random.Generator) -> pa.Table:
    matches = [f"{pairing}-{number}" for pairing, number in zip(rallies.pairing, rallies.match, strict=True)]
    return stroke_table(rallies, log.catalogue, [player.name for player in log.policies], matches, rng)
