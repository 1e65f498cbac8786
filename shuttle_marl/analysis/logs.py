"""Stroke tables from anything that holds strokes: annotated matches, stroke tables, rally logs."""

from pathlib import Path

import numpy as np
import pyarrow as pa

from shuttle_marl.analysis.errors import AnalysisError
from shuttle_marl.data import load_strokes, placing
from shuttle_marl.data.players import discipline
from shuttle_marl.data.schema import FAULT, RETURNED, STROKES, WINNER
from shuttle_marl.game import court
from shuttle_marl.game.rally import WINNER as WON
from shuttle_marl.recording import Rallies, RallyLog
from shuttle_marl.recording.parts import SUFFIX
from shuttle_marl.recording.tables import rows_of_strokes

RALLIES = 20_000
"""About so many rallies of a log are looked at, unless more are asked for."""
_NO_DISCIPLINE = "MS"


def strokes_of(path: Path, *, rallies: int = RALLIES, seed: int = 0) -> pa.Table:
    """The strokes of a rally log (a file or a folder of logs), of a Parquet file, or of a folder with annotated matches.

    Args:
        path: where they are.
        rallies: about how many rallies of a log are taken.
        seed: of the places and times that a log does not hold.

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

    A log holds decisions and outcomes. Points on the court and times are dressed up as in simulated tables
    (:mod:`shuttle_marl.data.placing`): a good stroke lands in its target area, and flight times are medians of the annotated
    matches. A match is named by its pairing and its number; where every rally stands for itself, it is a match of its own.

    Args:
        log: the log.
        rallies: about how many rallies are taken; all if the log has no more.
        seed: of places and times.

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
    catalogue = log.catalogue
    row, position, seat = rows_of_strokes(rallies)
    stroke = rallies.stroke.astype(np.int64)
    outcome = np.full(len(stroke), RETURNED)
    outcome[rallies.first_stroke[1:] - 1] = np.where(rallies.reason == WON, WINNER, FAULT)
    points = rallies.score[:, :2].astype(np.int64)
    server_points = points[np.arange(len(rallies)), rallies.server]
    game = rallies.score[:, 2:].sum(axis=1, dtype=np.int64)
    match = rallies.pairing.astype(np.int64) << 32 | rallies.match
    new_match = np.diff(match, prepend=-1) != 0
    new_game = new_match | (np.diff(game, prepend=-1) != 0)
    placed = placing.place(
        placing.Played(
            shot=catalogue.shot[stroke].astype(np.int64),
            area=catalogue.area[stroke].astype(np.int64),
            outcome=outcome,
            stroke=position + 1,
            new_game=new_game[row] & (position == 0),
            right=(server_points % 2 == 0)[row],
        ),
        rng,
    )
    # Every match's own film begins with its first stroke.
    begins = rallies.first_stroke[:-1][new_match]
    frame = placed.frame - placed.frame[begins][np.cumsum(new_match) - 1][row]
    after = points.copy()
    after[np.arange(len(rallies)), rallies.winner] += 1
    names = np.array([player.name for player in log.policies])
    kinds = np.array([discipline(name) or _NO_DISCIPLINE for name in names.tolist()])
    landing_x, landing_y = placed.landing.astype(np.float32).T
    places = {"landing": placed.landing, "contact": placed.contact, "striker": placed.striker, "receiver": placed.receiver}
    matches = np.array([f"{pairing}-{number}" for pairing, number in zip(rallies.pairing, rallies.match, strict=True)])
    columns = {
        "match": matches[row],
        "source": np.full(len(stroke), "simulated"),
        "discipline": kinds[rallies.policy[row, 0]],
        "game": game[row] + 1,
        "rally": points.sum(axis=1)[row] + 1,
        "stroke": position + 1,
        "player": names[rallies.policy[row, seat]],
        "opponent": names[rallies.policy[row, 1 - seat]],
        "shot": catalogue.shot[stroke],
        "height": catalogue.height[stroke],
        "technique": catalogue.technique[stroke],
        "area": court.area_of(landing_x, landing_y),
        "in_court": court.in_court(landing_x, landing_y),
        **{f"{name}_{axis}": xy[:, i].astype(np.float32) for name, xy in places.items() for i, axis in enumerate("xy")},
        "clock": frame // placing.FRAME_RATE,
        "frame": frame,
        "outcome": outcome,
        "reason": placed.reason,
        "points": after[row, seat],
        "points_opponent": after[row, 1 - seat],
        "label_area": None,
    }
    arrays = [
        pa.nulls(len(stroke), field.type)
        if columns[field.name] is None
        else pa.array(columns[field.name], field.type, from_pandas=True)
        for field in STROKES
    ]
    return pa.table(arrays, schema=STROKES)
