"""Rallies written as text."""

from typing import Any

import pyarrow as pa

from shuttle_marl.data.schema import REASONS, STROKES, stroke_table
from shuttle_marl.game.stroke import SHOTS

SERVE, LIFT = SHOTS.index("short-serve"), SHOTS.index("lift")


def strokes_of(*rallies: str, game: str = "", match: str = "", **columns: Any) -> pa.Table:
    """Rallies, each as letters of who strikes (A or B), and the last one's outcome: w, f or u; of shot types by number."""
    rows: list[dict[str, Any]] = []
    for number, text in enumerate(rallies):
        who, end = text[:-1], text[-1]
        for k, player in enumerate(who):
            last = k == len(who) - 1
            rows.append({
                "match": match[number] if match else "m", "source": "s", "discipline": "MS",
                "game": int(game[number]) if game else 1,
                "rally": number + 1, "stroke": k + 1, "player": player, "opponent": "AB"[player == "A"],
                "shot": SERVE if not k else LIFT,
                "height": 0, "technique": 0, "outcome": "rfwu".index(end) if last else 0,
                "reason": 0 if not last else REASONS.index({"w": "landed", "f": "out"}.get(end, "unknown")),
            })  # fmt: skip
    names = {name for row in rows for name in row} | columns.keys()
    table = {name: pa.array(columns.get(name, [row.get(name) for row in rows]), STROKES.field(name).type) for name in names}
    return stroke_table(table, {})
