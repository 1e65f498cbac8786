"""Annotated strokes of two small matches, in which some are missing."""

from pathlib import Path
from typing import Any

import pyarrow as pa

from shuttle_marl.court.recorded import RealRallies
from shuttle_marl.data import read_matches
from shuttle_marl.data.schema import Outcome
from shuttle_marl.game.tables import Game

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
FAULT, WINNER, BACK = int(Outcome.FAULT), int(Outcome.WINNER), int(Outcome.RETURNED)


NAMES = ("match", "game", "rally", "stroke", "player", "opponent", "points", "points_opponent", "shot", "outcome")


EVENT = "Ada_LEE_Bea_KOREA_OPEN_2019_Final"


SERVE, LIFT = 0, 3


ROWS: list[tuple[Any, ...]] = [
    (EVENT, 1, 1, 1, "ada-lee", "bea", 0, 1, SERVE, BACK), (EVENT, 1, 1, 2, "bea", "ada-lee", 1, 0, LIFT, WINNER),
    (EVENT, 1, 2, 1, "bea", "ada-lee", 1, 1, SERVE, FAULT),
    (EVENT, 1, 3, 1, "ada-lee", "bea", 2, 1, SERVE, BACK), (EVENT, 1, 3, 3, "ada-lee", "bea", 2, 1, LIFT, WINNER),  # 2 is missing
    (EVENT, 1, 4, 1, "ada-lee", "bea", None, None, SERVE, WINNER),
    (EVENT, 1, 5, 1, "ada-lee", "bea", 4, 1, LIFT, WINNER),  # no serve
    (EVENT, 1, 6, 1, "ada-lee", "bea", 5, 1, SERVE, BACK),  # no end
    (EVENT, 2, 1, 1, "ada-lee", "bea", 0, 1, SERVE, FAULT),
    (EVENT, 3, 1, 1, "bea", "ada-lee", 0, 1, SERVE, BACK), (EVENT, 3, 1, 2, "ada-lee", "bea", 1, 0, LIFT, BACK),
    (EVENT, 3, 1, 3, "bea", "ada-lee", 0, 1, LIFT, FAULT),
    ("Club_final", 1, 1, 1, "cem", "ada-lee", 1, 0, SERVE, WINNER),
]  # fmt: skip
"""Annotated strokes; points are those after the rally."""


def with_column(strokes: pa.Table, name: str, values: Any) -> pa.Table:
    """The table with other values in one column."""
    field = strokes.schema.field(name)
    return strokes.set_column(strokes.schema.get_field_index(name), field, pa.array(values, field.type))


def annotated_rallies(game: Game) -> RealRallies:
    table = with_column(read_matches(SAMPLE).slice(0, len(ROWS)), "hurried", [False] * len(ROWS))
    for name, values in zip(NAMES, zip(*ROWS, strict=True), strict=True):
        table = with_column(table, name, values)
    return RealRallies(SAMPLE, game, table)
