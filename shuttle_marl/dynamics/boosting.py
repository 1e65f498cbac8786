"""Boosted trees (LightGBM, Ke et al., NIPS 2017) as arrays, and the fit of the index of hurried strikers.

The index is the expected loss of value that positions and times before a stroke predict: trees fitted to the one-step value of
the stroke minus the value of its shot type and technique in the state without the bit. A striker is *hurried* in the worst
quarter of strokes against the same incoming shot type from the same contact height. Serves are never hurried.

- **One-step value**: -1 for a fault, +1 for a winner, otherwise minus the mean one-step value of strokes against this shot type
  from the receiver's contact height (a fixed point).
- **Value of a shot type and technique**: the mean by incoming shot type and contact height, shrunk to that of all strokes.

Matches of the fit are marked by trees that were not fitted to them, in twenty folds (five are too few: ``docs/truth_record.md``);
all others by trees fitted to all of them. So the bit says the same about both.
"""

import dataclasses
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.base.extras import hinted
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import SLOTS, Hurry, Rows

PARAMETERS: Final[dict[str, Any]] = {
    "objective": "binary",
    "learning_rate": 0.05,
    "min_data_in_leaf": 100,
    "lambda_l2": 10,
    "cat_smooth": 20,
    "max_cat_to_onehot": 4,
    "deterministic": True,
    "force_row_wise": True,
    "num_threads": 1,
    "seed": 0,
    "verbose": -10,
}


def lightgbm() -> Any:
    """LightGBM, which only fits need. Raises ModuleNotFoundError: it is not installed."""
    with hinted():
        import lightgbm as module  # noqa: PLC0415
    return module


def stored_trees(booster: Any, leaves: int) -> tuple[dict[str, npt.NDArray[Any]], list[tuple[int, int, Any]]]:
    """The trees of LightGBM as arrays.

    Returns:
        ``attribute``, ``child`` and ``value`` as in :class:`Trees`; and (tree, node, threshold) of each node.
    """
    fitted = booster.dump_model()["tree_info"]
    shape = (len(fitted), leaves - 1)
    attribute = np.zeros(shape, dtype=np.int32)
    child, value = np.full((*shape, 2), -1, dtype=np.int32), np.zeros((len(fitted), leaves))
    nodes: list[tuple[int, int, Any]] = []
    for t, tree in enumerate(fitted):
        # LightGBM numbers nodes in the order of their splits, so children come after their parents.
        stack = [tree["tree_structure"]]
        while stack:
            node = stack.pop()
            if "split_index" not in node:
                value[t, node.get("leaf_index", 0)] = node["leaf_value"]
                continue
            m = node["split_index"]
            attribute[t, m] = node["split_feature"]
            nodes.append((t, m, node["threshold"]))
            for side, name in enumerate(("left_child", "right_child")):
                below = node[name]
                child[t, m, side] = below["split_index"] if "split_index" in below else -1 - below["leaf_index"]
                stack.append(below)
    return {"attribute": attribute, "child": child, "value": value}, nodes


SHARE: Final = 0.25
MIN_ROWS: Final = 5000  # strokes with positions and times of a fit; fewer hold some hundred faults, too few
MIN_CELL: Final = 200  # strokes against a shot type from a height; with fewer both heights count, or nobody is hurried
FOLDS: Final = 20
_LEAVES: Final = 12
_INDEX: Final = {"objective": "l2", "learning_rate": 0.04, "num_leaves": _LEAVES, "min_data_in_leaf": 150, "lambda_l2": 0}
_ROUNDS: Final = 150
_ITERATIONS: Final = 200
_PRIOR_STROKES: Final = 20.0


def fit_hurry(rows: Rows, *, seed: int = 0) -> Hurry | None:
    """Fit the index to strokes in playing order; None if too few have positions and times and need it."""
    step = _step_values(rows)
    asked = rows.tracked & (rows.hurried < 0)
    if asked.sum() < MIN_ROWS:
        return None
    lgb = lightgbm()
    used, inputs, loss = asked & np.isfinite(step), Hurry.inputs(rows), _above_usual(step, rows)
    numbers = np.unique(rows.match)
    fold_of = np.zeros(len(rows.matches), dtype=np.int32)
    fold_of[numbers] = np.arange(len(numbers)) % FOLDS
    parts = []
    for fold in range(FOLDS + 1):  # the last one has no match, so these trees are fitted to all
        these = used & (fold_of[rows.match] != fold)
        booster = lgb.train({**PARAMETERS, **_INDEX, "seed": seed}, lgb.Dataset(inputs[these], loss[these]), _ROUNDS)
        arrays, nodes = stored_trees(booster, _LEAVES)
        arrays["cut"] = np.zeros(arrays["attribute"].shape)
        for tree, node, cut in nodes:
            arrays["cut"][tree, node] = cut
        parts.append(arrays)
    stacked = {name: np.stack([part[name] for part in parts]) for name in parts[0]}
    found = Hurry(
        matches=tuple(rows.matches[k] for k in numbers.tolist()),
        fold=fold_of[numbers],
        threshold=np.full((SLOTS["incoming_shot"], SLOTS["contact"]), -np.inf),
        **stacked,
    )
    return dataclasses.replace(found, threshold=_thresholds(found.index(rows), rows, asked))


def _thresholds(index: F64, rows: Rows, asked: Bools) -> F64:
    found = np.full((SLOTS["incoming_shot"], SLOTS["contact"]), np.finfo(np.float64).min)
    for shot, contact in np.ndindex(*found.shape):
        both = asked & (rows.codes["incoming_shot"] == shot)
        for cell in (both & (rows.codes["contact"] == contact), both):
            if cell.sum() >= MIN_CELL:
                found[shot, contact] = np.quantile(index[cell], SHARE)
                break
    return found


def _step_values(rows: Rows) -> F64:
    """``[N]`` one-step value of each stroke; NaN where its outcome or what follows is unknown."""
    facing, following = (
        rows.codes[name].astype(np.int64) * 2 + contact
        for name, contact in (("incoming_shot", rows.codes["contact"]), ("shot", rows.next_contact))
    )
    met = rows.next_contact >= 0
    ending = np.select([rows.outcome == Outcome.FAULT, rows.outcome == Outcome.WINNER], [-1.0, 1.0], np.nan)
    value, known = np.zeros(2 * SLOTS["incoming_shot"]), met | np.isfinite(ending)
    count = np.maximum(np.bincount(facing[known], minlength=len(value)), 1)
    step = np.where(met, 0.0, ending)
    for _ in range(_ITERATIONS):
        step[met] = -value[following[met]]
        value = np.bincount(facing[known], step[known], len(value)) / count
    return np.asarray(step)


def _above_usual(step: F64, rows: Rows) -> F64:
    """``[N]`` one-step value minus the mean of the shot type and technique against this incoming shot type from this height."""
    names = ("incoming_shot", "contact", "shot", "technique")
    cell = np.ravel_multi_index([rows.codes[name] for name in names], [SLOTS[name] for name in names])
    valued = np.isfinite(step) & (rows.stroke > 1)
    count = np.bincount(cell[valued], minlength=int(cell.max()) + 1)
    total = np.bincount(cell[valued], step[valued], len(count))
    mean = (total + _PRIOR_STROKES * step[valued].mean()) / (count + _PRIOR_STROKES)
    return np.asarray(step - mean[cell])
