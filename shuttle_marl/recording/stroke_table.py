"""Rallies as a stroke table, in the schema of the annotated matches."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.data import placing
from shuttle_marl.data.schema import STROKES, Outcome, outcome_of
from shuttle_marl.data.upstream import discipline
from shuttle_marl.game import court
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.recording.schema import Rallies
from shuttle_marl.recording.tables import rows_of_strokes

_NO_DISCIPLINE: Final = "MS"


def stroke_table(
    rallies: Rallies, catalogue: Catalogue, players: Sequence[str], matches: Sequence[str], rng: np.random.Generator
) -> pa.Table:
    """Write every stroke of rallies down as an annotated match would have it.

    Decisions, outcomes and scores are those of the rallies. Points on the court and times are drawn
    (:mod:`shuttle_marl.data.placing`): a good stroke lands in its target area, and flight times are medians of the annotated
    matches. A match is filed under the discipline of its first player who has one (:mod:`shuttle_marl.data.upstream`), or
    under men's singles; its time begins with the first of its rallies that is there.

    Args:
        rallies: R rallies, those of a match one after the other.
        catalogue: the strokes of the game.
        players: names by index, as ``rallies.policy`` counts them.
        matches: ``[R]`` name of each rally's match.
        rng: draws points and times.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`, source ``simulated``. ``area`` of a fault is that of its
        landing, as in the annotated data.
    """
    row, position, seat = rows_of_strokes(rallies)
    stroke = rallies.stroke.astype(np.int64)
    outcome = np.full(len(stroke), Outcome.RETURNED)
    outcome[rallies.first_stroke[1:] - 1] = outcome_of(rallies.reason)
    number = np.arange(len(rallies))
    points = rallies.score[:, :2].astype(np.int64)
    game = rallies.score[:, 2:].sum(axis=1, dtype=np.int64)
    new_match = np.diff(rallies.pairing.astype(np.int64) << 32 | rallies.match, prepend=-1) != 0
    new_game = new_match | (np.diff(game, prepend=-1) != 0)
    placed = placing.place(
        placing.Strokes(
            shot=catalogue.shot[stroke].astype(np.int64),
            area=catalogue.area[stroke].astype(np.int64),
            outcome=outcome,
            stroke=position + 1,
            new_game=new_game[row] & (position == 0),
            right=(points[number, rallies.server] % 2 == 0)[row],
        ),
        rng,
    )
    frame = placed.frame - _first_frame(rallies, placed.frame, new_match)[row]
    after = points.copy()
    after[number, rallies.winner] += 1
    names, kinds = pa.array(players, pa.string()), [discipline(name) for name in players]
    filed = pa.array([kinds[a] or kinds[b] or _NO_DISCIPLINE for a, b in rallies.policy.tolist()], pa.string())
    places = {"landing": placed.landing, "contact": placed.contact, "striker": placed.striker, "receiver": placed.receiver}
    landing_x, landing_y = placed.landing.astype(np.float32).T
    columns = {
        "match": pa.array(matches, pa.string()).take(row),
        "source": pa.repeat("simulated", len(stroke)),
        "discipline": filed.take(row),
        "game": game[row] + 1,
        "rally": points.sum(axis=1)[row] + 1,
        "stroke": position + 1,
        "player": names.take(rallies.policy[row, seat]),
        "opponent": names.take(rallies.policy[row, 1 - seat]),
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
        "label_area": pa.nulls(len(stroke), pa.int8()),
    }
    return pa.table([_array(columns[field.name], field.type) for field in STROKES], schema=STROKES)


def _first_frame(rallies: Rallies, frame: npt.NDArray[np.int64], new_match: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """``[R]`` frame of the first stroke of each rally's match."""
    return frame[rallies.first_stroke[:-1][new_match]][np.cumsum(new_match) - 1]


def _array(values: pa.Array | npt.NDArray[np.generic], kind: pa.DataType) -> pa.Array:
    return values if isinstance(values, pa.Array) else pa.array(values, kind, from_pandas=True)
