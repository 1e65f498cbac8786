"""The paper's first table: accuracy of predictions of the next stroke (top-1 to top-4), overall and by player.

    python -m experiments.next_stroke --data DATA [--split validation] [--out FILE] [--json]

Three models are compared. The **imitator** reads everything that is visible at the hit: positions, tempo, the four previous
strokes, the players. It is fitted here on the training matches. The **average clone** (``bc``) and each player's **own clone**
(``bc:<player>``) read only the state of the game: two strokes and the contact height.

Rows: all strokes, as in the paper; strokes without serves, which are easy to predict; and these without the contact height, which
is informative about the shot type. Without it the clones are averaged over the heights that the game expects.

ShuttleEnv (arXiv 2603.17324) reports two players of its own private data, so its figures are not directly comparable. The shot
type is scored on all strokes, the area on strokes that are no faults (the target of a fault is unknown).
"""

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from docs.tools.results import show
from experiments.imitator import Imitator
from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.runs import describe
from shuttle_marl.commands.cli import entry_point
from shuttle_marl.data import read_matches
from shuttle_marl.data.upstream import Split, matches_of
from shuttle_marl.dynamics.evaluate import next_stroke_probabilities, prediction_scores
from shuttle_marl.dynamics.features import Hurry, Rows, load_hurry, rows_from_strokes
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.game import model_folder
from shuttle_marl.game.court import N_AREAS, mirrored
from shuttle_marl.game.stroke import N_SHOTS

PAPER: Final = {
    "Lin Dan": {"shot_type": [0.473, 0.664, 0.785, 0.880], "area": [0.580, 0.763, 0.854, 0.898]},
    "Lee Chong Wei": {"shot_type": [0.438, 0.689, 0.816, 0.871], "area": [0.594, 0.796, 0.884, 0.924]},
}
"""Rows of the paper's table, on its own private data."""
LEAST_ROWS: Final = 200
"""Minimum number of strokes of a player for a row."""
LEAST_PLAYERS: Final = 4
"""Minimum number of players with a row."""

Prediction = tuple[F64, F64, F64]
"""``[N, 13]`` shot type; ``[N, 9]`` area; ``[N, 9]`` area given the shot type that was played."""


def next_stroke(
    data: Path, split: Split = "validation", model: str = "default", seed: int = 0, out: Path | None = None, json: bool = False
) -> None:
    """Fit the imitator on the train matches and print the table.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        split: matches to score on.
        model: a shipped model or a model folder.
        seed: of the fit of the imitator.
        out: JSON file to write the result to, with its origin.
        json: print JSON instead of the table.
    """
    strokes = read_matches(data)
    scored, train = _of_split(strokes, split), _of_split(strokes, "train")
    began = time.monotonic()
    imitator = Imitator.fit(train, seed=seed)
    fit = {
        "strokes": train.num_rows,
        "matches": len(train["match"].unique()),
        "seconds": round(time.monotonic() - began),
        "seed": seed,
        "config": dataclasses.asdict(imitator.config),
    }
    models, hurry = FittedModels.load(model_folder(model)), load_hurry(model_folder(model))
    scores = table(imitator, models, scored, hurry)
    result = {**describe(("lightgbm", "numpy")), "split": split, "fit": fit, **scores, "paper": PAPER}
    show(result, "next_stroke", as_json=json, out=out)


def table(imitator: Imitator, models: FittedModels, strokes: pa.Table, hurry: Hurry | None = None) -> dict[str, Any]:
    """Scores of the imitator and of the game's clones.

    Args:
        imitator: fitted on other matches.
        models: of the game.
        strokes: to score on, whole matches in playing order.
        hurry: index of hurried strikers of the models, if they have one.

    Returns:
        ``rows``: by strokes scored, then by predictor, scores as of
        :func:`shuttle_marl.dynamics.evaluate.prediction_scores`; ``players``: by player, then by predictor, on all their
        strokes, with ``own_model``.
    """
    # The index reads the contact height.
    heightless = rows_from_strokes(strokes)
    rows = heightless if hurry is None else hurry.marked(heightless)
    seen: dict[str, Prediction] = {
        "imitator": _of_joint(imitator.predict(strokes), rows),
        "own clone": next_stroke_probabilities(models, rows),
        "average clone": next_stroke_probabilities(models, rows, own=False),
    }
    hidden: dict[str, Prediction] = {
        "imitator": _of_joint(imitator.predict(strokes, height_known=False), rows),
        "own clone": without_height(models, heightless),
        "average clone": without_height(models, heightless, own=False),
    }
    everything, rally = np.ones(len(rows), dtype=bool), rows.stroke > 1
    listed: dict[str, Any] = {}
    for name in _most_strokes(rows):
        mine = rows.striker == name
        scores = {by: _scores(seen[by], rows, mine) for by in ("imitator", "own clone")}
        listed[name] = {"own_model": name in models.choices.players, **scores}
    return {
        "rows": {
            name: {by: _scores(prediction, rows, which) for by, prediction in predictions.items()}
            for name, predictions, which in (
                ("all strokes", seen, everything),
                ("rally strokes", seen, rally),
                ("rally strokes, contact height not known", hidden, rally),
            )
        },
        "players": listed,
    }


def without_height(models: FittedModels, rows: Rows, *, own: bool = True) -> Prediction:
    """Choices of the game's players without their contact height, averaged over the heights expected by the game.

    Args:
        models: of the game.
        rows: whole rallies, in playing order.
        own: use the striker's own model where there is one.
    """
    above = np.full(len(rows), (rows.codes["contact"][rows.stroke > 1] == 1).mean())
    # Serves are struck below the net. The previous row is the previous stroke, unless that was dropped.
    above[rows.stroke == 1] = 0.0
    known = np.flatnonzero(rows.codes["incoming_shot"] < N_SHOTS)
    known = known[rows.codes["area"][known - 1] >= 0]
    above[known] = models.above(rows.take(known - 1).codes)
    shot, area, given = (np.zeros((len(rows), n)) for n in (N_SHOTS, 9, 9))
    for contact, share in ((0, 1 - above), (1, above)):
        codes = {**rows.codes, "contact": np.full(len(rows), contact, dtype=np.int16)}
        types, areas, of_type = next_stroke_probabilities(models, dataclasses.replace(rows, codes=codes), own=own)
        shot += share[:, None] * types
        area += share[:, None] * areas
        given += (share * types[np.arange(len(rows)), rows.codes["shot"]])[:, None] * of_type
    return shot, area, given / given.sum(axis=1, keepdims=True)


def _of_split(strokes: pa.Table, split: Split) -> pa.Table:
    chosen = strokes.filter(pc.is_in(strokes["match"], pa.array(matches_of(split), pa.string())))
    if not chosen.num_rows:
        raise ShuttleError(f"no match of the split {split!r} in the data; is the download complete?")
    return chosen


def _of_joint(joint: F64, rows: Rows) -> Prediction:
    """A prediction in the frame of the rows, that of a right-handed striker."""
    joint = np.where((rows.hand == 1)[:, None, None], joint[:, :, mirrored(np.arange(N_AREAS))], joint)
    given = joint[np.arange(len(rows)), rows.codes["shot"]]
    return joint.sum(axis=2), joint.sum(axis=1), given / given.sum(axis=1, keepdims=True)


def _scores(prediction: Prediction, rows: Rows, which: Bools) -> dict[str, Any]:
    shot, area, given = (part[which] for part in prediction)
    return prediction_scores(shot, area, given, rows.take(which))


def _most_strokes(rows: Rows) -> list[str]:
    """Players in decreasing order of their number of strokes."""
    names, counts = np.unique(rows.striker, return_counts=True)
    ranked = np.lexsort((names, -counts))
    return [str(names[i]) for place, i in enumerate(ranked) if place < LEAST_PLAYERS or counts[i] >= LEAST_ROWS]


main = entry_point(next_stroke, "python -m experiments.next_stroke", __doc__ or "")


if __name__ == "__main__":
    sys.exit(main())
