"""The paper's first table: how well the next stroke is predicted (top-1 to top-4), per player and over all.

    python -m experiments.next_stroke --data DATA [--split validation] [--json]

ShuttleEnv (arXiv 2603.17324) reports two players of its own private data; ours are other matches of other players, so the
figures stand side by side, not against each other. The shot type is scored on all strokes, the area on those that were no
fault (a fault does not say where it was aimed). The contact height is part of the state, so it is known.
"""

import json as json_format
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from shuttle_marl.commands.cli import run
from shuttle_marl.data import load_strokes
from shuttle_marl.data.upstream import Split
from shuttle_marl.dynamics.evaluate import next_stroke_scores
from shuttle_marl.dynamics.features import rows_from_strokes
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.make import rows_of
from shuttle_marl.game import model_folder

PAPER: Final = {
    "Lin Dan": {"shot_type": [0.473, 0.664, 0.785, 0.880], "area": [0.580, 0.763, 0.854, 0.898]},
    "Lee Chong Wei": {"shot_type": [0.438, 0.689, 0.816, 0.871], "area": [0.594, 0.796, 0.884, 0.924]},
}
"""Rows of the paper's table, on its own private data."""
LEAST_ROWS: Final = 200
"""A player with fewer strokes in the split gets no row."""
LEAST_PLAYERS: Final = 4
"""At least the players with most strokes get one."""


def next_stroke(data: Path, split: Split = "validation", model: str = "default", json: bool = False) -> None:
    """Print the table.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: matches to score on.
        model: a shipped model or a model folder.
        json: print JSON instead.
    """
    rows = rows_of(rows_from_strokes(load_strokes(data)), split)
    models = FittedModels.load(model_folder(model))
    names, counts = np.unique(rows.striker, return_counts=True)
    ranked = [str(names[i]) for i in np.lexsort((names, -counts))]
    listed = [name for i, name in enumerate(ranked) if i < LEAST_PLAYERS or (rows.striker == name).sum() >= LEAST_ROWS]
    result: dict[str, Any] = {
        "all": next_stroke_scores(models, rows),
        "all, average player's model": next_stroke_scores(models, rows, own=False),
    }
    for name in listed:
        scores = next_stroke_scores(models, rows.take(rows.striker == name))
        result[name] = {**scores, "own_model": name in models.choices.players}
    if json:
        sys.stdout.write(json_format.dumps({"split": split, "rows": result, "paper": PAPER}) + "\n")
        return
    table = Table(title=f"Next stroke, {split} matches: top-1 to top-4")
    for column in ("player", "strokes", "shot type", "area", "area, shot type known"):
        table.add_column(column, justify="left" if column == "player" else "right")
    for name, scores in result.items():
        label = f"{name} *" if scores.get("own_model") is False else name
        cells = (" ".join(f"{x:.3f}" for x in scores[key]) for key in ("shot_type", "area", "area_given_type"))
        table.add_row(label, f"{scores['rows']:,}", *cells)
    table.add_section()
    for name, paper in PAPER.items():
        cells = (" ".join(f"{x:.3f}" for x in paper[key]) for key in ("shot_type", "area"))
        table.add_row(f"paper: {name}", "private", *cells, "")
    console = Console(highlight=False)
    console.print(table)
    console.print("* no model of their own (too few train strokes): the average player's.")
    console.print("The paper's rows are of its own private matches; the data differ, so the rows cannot be ranked.")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line."""
    return run(next_stroke, prog="experiments.next_stroke", description=__doc__ or "", argv=argv)


if __name__ == "__main__":
    sys.exit(main())
