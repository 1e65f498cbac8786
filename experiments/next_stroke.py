"""The paper's first table: accuracy of predictions of the next stroke (top-1 to top-4), overall and by player.

    python -m experiments.next_stroke --data DATA [--split validation] [--out FILE] [--json]

Compared are the average clone (``bc``) and each player's own clone (``bc:<player>``), which read the state of the game alone: two
strokes and the contact height. Rows: all strokes, as in the paper; and those that are no serves, which are easy to predict. The
area is scored on strokes that are no faults (the target of a fault is unknown).

ShuttleEnv (arXiv 2603.17324) reports two players of its own private data, so its figures are not directly comparable.
"""

import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from docs.tools.results import show
from experiments.truth.matches import of_splits, strokes_of
from shuttle_marl.base.arrays import Bools
from shuttle_marl.base.runs import describe
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import Split, read_matches
from shuttle_marl.dynamics.evaluate import next_stroke_probabilities, prediction_scores
from shuttle_marl.dynamics.features import Rows, load_hurry
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.game import model_folder

PAPER: Final = {
    "Lin Dan": {"shot_type": [0.473, 0.664, 0.785, 0.880], "area": [0.580, 0.763, 0.854, 0.898]},
    "Lee Chong Wei": {"shot_type": [0.438, 0.689, 0.816, 0.871], "area": [0.594, 0.796, 0.884, 0.924]},
}
"""Rows of the paper's table, on its own private data."""
LEAST_ROWS: Final = 200  # minimum number of strokes of a player for a row


def next_stroke(
    data: Path, split: Split = "validation", model: str = "default", out: Path | None = None, json: bool = False
) -> None:
    """Print the table.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: matches to score on.
        model: a shipped model or a model folder.
        out: JSON file to write the result to, with its origin.
        json: print JSON instead of the table.
    """
    folder = model_folder(model)
    rows = of_splits(strokes_of(read_matches(data)).marked(load_hurry(folder)), split).rows
    about = {**describe(("numpy",)), "split": split, "matches": len(np.unique(rows.match))}
    show({**about, **table(FittedModels.load(folder), rows), "paper": PAPER}, "next_stroke", as_json=json, out=out)


def table(models: FittedModels, rows: Rows) -> dict[str, Any]:
    """Scores of the clones of the game.

    Returns:
        ``rows``: by strokes scored, then by predictor, scores as of :func:`~shuttle_marl.dynamics.evaluate.prediction_scores`;
        ``players``: of the players with most strokes the scores of their own clone, and whether it is one (``own_model``).
    """
    predicted = {
        name: next_stroke_probabilities(models, rows, own=name == "own clone") for name in ("own clone", "average clone")
    }

    def scores(by: str, which: Bools) -> dict[str, Any]:
        shot, area, given = (part[which] for part in predicted[by])
        return prediction_scores(shot, area, given, rows.take(which))

    scored = {"all strokes": np.ones(len(rows), dtype=bool), "rally strokes": rows.stroke > 1}
    names, counts = np.unique(rows.striker, return_counts=True)
    most = [str(names[i]) for i in np.lexsort((names, -counts)) if counts[i] >= LEAST_ROWS]
    return {
        "rows": {name: {by: scores(by, which) for by in predicted} for name, which in scored.items()},
        "players": {
            name: {"own_model": name in models.choices.players, "own clone": scores("own clone", rows.striker == name)}
            for name in most
        },
    }


main = entry_point(next_stroke, "python -m experiments.next_stroke", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
