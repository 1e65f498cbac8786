"""Index of hurried strikers: from positions and times before a stroke to whether its striker is late or stretched.

The index is the expected loss of value that positions and times before the stroke predict: boosted trees (LightGBM, Ke et al.,
NIPS 2017) fitted to the one-step value of a stroke minus the value of its shot type and technique in the state without the bit.
A striker is *hurried* in the worst quarter of strokes against the same incoming shot type from the same contact height.

- **One-step value**: -1 for a fault, +1 for a winner, otherwise minus the mean one-step value of strokes against this shot type
  from the receiver's contact height (a fixed point).
- **Value of a shot type and technique**: the mean by incoming shot type and contact height, shrunk to that of all strokes.

In four cross fits over the training matches, trees that read the bit too predict unseen matches better than trees without it:
log-loss of a fault -151e-5 [-201, -101], of the contact -85e-5 [-127, -47] (95 % by match). With trees instead of means as value,
-132e-5 and -69e-5; with trees that were not fitted to the match, -115e-5 and -58e-5.

Matches of the fit are marked by trees that were not fitted to them, in twenty folds; all others by trees fitted to all of them.
So the bit says the same about both. With five folds, as in the comparison above, it does not: fewer strikers of unseen matches
are hurried than of those of the fit (23.3 against 24.9 %; 24.6 % with twenty; four fits to half of the training matches), and the
calibration error of the models that predict the bit there is .024 instead of .013. The log-loss of a fault is the same.

Serves are never hurried. Where a position or time is unknown, so is the bit.
"""

import dataclasses
import json
from pathlib import Path
from typing import Final, Self

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import F64, I8, I32, Bools
from shuttle_marl.base.compiling import compiled
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import parsed, replace_file
from shuttle_marl.base.tensor_files import Tensors, checked, tensor_bytes
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.boosting import PARAMETERS, check_nodes, lightgbm, stored_trees
from shuttle_marl.dynamics.features import MOVEMENT, SLOTS, Rows, rows_from_strokes
from shuttle_marl.game.shipped import HURRY, folder_of, read_model
from shuttle_marl.game.tables import Game

SHARE: Final = 0.25
"""Share of hurried strikers among the strokes of an incoming shot type and contact height."""
MIN_ROWS: Final = 5000
"""Strokes with positions and times of a fit; fewer hold some hundred faults, which no index can be fitted to."""
MIN_CELL: Final = 200
"""With fewer strokes against a shot type from a contact height, both heights count; with still fewer nobody is hurried."""
FOLDS: Final = 20
_CODES: Final = ("incoming_shot", "incoming_technique", "contact")
_INPUTS: Final = (*_CODES, *MOVEMENT)
_LEAVES: Final = 12
_INDEX: Final = {"objective": "l2", "learning_rate": 0.04, "num_leaves": _LEAVES, "min_data_in_leaf": 150, "lambda_l2": 0}
_ROUNDS: Final = 150
_ITERATIONS: Final = 200
_PRIOR_STROKES: Final = 20.0
"""Weight of the mean of all strokes in that of a shot type and technique, in strokes."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Hurry:
    """The index: K forests of T trees with M nodes each, and the thresholds.

    Node m of a tree tests one input of a row (incoming shot type, technique, contact, then
    :data:`~shuttle_marl.dynamics.features.MOVEMENT`), and sends the row to its first child where that is at most the cut: to a
    later node, or to leaf -1 - child.

    Attributes:
        matches: names of the matches of the fit; the k-th belongs to fold ``fold[k]``.
        fold: ``[matches]`` forest that was not fitted to each match; the last forest was fitted to all.
        attribute: ``[K, T, M]`` input that a node tests; ``cut``: ``[K, T, M]`` its threshold.
        child: ``[K, T, M, 2]`` children; ``value``: ``[K, T, M + 1]`` leaves.
        threshold: ``[15, 2]`` index below which a striker is hurried, by code of the incoming shot type and contact height.
    """

    matches: tuple[str, ...]
    fold: I32
    attribute: I32
    cut: F64
    child: I32
    value: F64
    threshold: F64

    def index(self, rows: Rows) -> F64:
        """``[N]`` index of each stroke, the lower the more hurried; NaN where a position or time is unknown."""
        known = _known(rows)
        index, inputs = np.full(len(rows), np.nan), _inputs(rows)
        of_name = dict(zip(self.matches, self.fold.tolist(), strict=True))
        forest = np.array([of_name.get(name, len(self.value) - 1) for name in rows.matches], dtype=np.int64)[rows.match]
        for k in np.unique(forest[known]).tolist():
            those = known & (forest == k)
            index[those] = _sums(inputs[those], self.attribute[k], self.cut[k], self.child[k], self.value[k])
        return index

    def bits(self, rows: Rows) -> I8:
        """``[N]`` 1 where the striker is hurried, 0 where not, -1 where a position or time is unknown."""
        index = self.index(rows)
        late = index < self.threshold[rows.codes["incoming_shot"], rows.codes["contact"]]
        return np.where(np.isnan(index), -1, late).astype(np.int8)

    def marked(self, rows: Rows) -> Rows:
        """Rows in playing order, with whether the striker was hurried where the table does not know it."""
        return rows.marked(self.bits(rows))

    def save(self, path: Path) -> None:
        """Write the index to a file, in a model folder :data:`~shuttle_marl.game.shipped.HURRY`."""
        arrays = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "matches"}
        replace_file(path, tensor_bytes(arrays, {"matches": json.dumps(self.matches)}, pack=True))

    @classmethod
    def checked(cls, tensors: Tensors) -> Self:
        """An index from the content of a file.

        Raises:
            KeyError, TypeError, ValueError: a part is missing or invalid.
        """
        header, arrays = tensors
        forests, trees, nodes = arrays["attribute"].shape
        matches = tuple(map(str, parsed(header["matches"])))
        found = cls(
            matches=matches,
            fold=checked(arrays["fold"], np.int32, (len(matches),)),
            attribute=checked(arrays["attribute"], np.int32, (forests, trees, nodes)),
            cut=checked(arrays["cut"], np.float64, (forests, trees, nodes)),
            child=checked(arrays["child"], np.int32, (forests, trees, nodes, 2)),
            value=checked(arrays["value"], np.float64, (forests, trees, nodes + 1)),
            threshold=checked(arrays["threshold"], np.float64, (SLOTS["incoming_shot"], SLOTS["contact"])),
        )
        check_nodes(found.attribute, found.child, len(_INPUTS))
        if not ((found.fold >= 0) & (found.fold < forests)).all():
            raise ValueError("an unknown fold")
        return found


def load_hurry(folder: Path) -> Hurry | None:
    """Read the index of a model folder; None if the model has none.

    Raises:
        ShuttleError: the file differs from the model card, or is invalid.
        GameError: the model card cannot be read.
    """
    path = folder / HURRY
    if not path.is_file():
        return None
    try:
        return Hurry.checked(read_model(folder, HURRY))
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ShuttleError(f"{path}: no readable index of hurried strikers ({error}); fit or install the model again") from error


def hurry_of(game: Game) -> Hurry | None:
    """The index of the model that a game belongs to (:func:`shuttle_marl.game.shipped.folder_of`); None if there is none.

    Raises:
        ShuttleError: as :func:`load_hurry`.
    """
    folder = folder_of(game)
    return None if folder is None else load_hurry(folder)


def marked_rows(strokes: pa.Table, hurry: Hurry | None) -> Rows:
    """Rows of a cleaned table, in its order (:func:`~shuttle_marl.dynamics.features.rows_from_strokes`).

    Args:
        strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`.
        hurry: index that decides whether strikers were hurried where the table does not know it; None: that stays unknown.
    """
    rows = rows_from_strokes(strokes)
    return rows if hurry is None else hurry.marked(rows)


def fit_hurry(rows: Rows, *, seed: int = 0) -> Hurry | None:
    """Fit the index to strokes in playing order; None if too few have positions and times and need it."""
    step = _step_values(rows)
    asked = _known(rows) & (rows.hurried < 0)
    if asked.sum() < MIN_ROWS:
        return None
    lgb = lightgbm()
    used, inputs, loss = asked & np.isfinite(step), _inputs(rows), _above_usual(step, rows)
    names = np.unique(rows.match)
    fold_of = np.zeros(len(rows.matches), dtype=np.int32)
    fold_of[names] = np.arange(len(names)) % FOLDS
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
        matches=tuple(rows.matches[k] for k in names.tolist()),
        fold=fold_of[names],
        threshold=np.full((SLOTS["incoming_shot"], SLOTS["contact"]), -np.inf),
        **stacked,
    )
    return dataclasses.replace(found, threshold=_thresholds(found.index(rows), rows, asked))


def _thresholds(index: F64, rows: Rows, asked: Bools) -> F64:
    """``[15, 2]`` index of the worst quarter, by incoming shot type and contact height."""
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
    code = (rows.codes[name].astype(np.int64) for name in ("incoming_shot", "contact", "shot", "technique"))
    cell = np.ravel_multi_index(tuple(code), tuple(SLOTS[name] for name in ("incoming_shot", "contact", "shot", "technique")))
    valued = np.isfinite(step) & (rows.stroke > 1)
    count = np.bincount(cell[valued], minlength=int(cell.max()) + 1)
    total = np.bincount(cell[valued], step[valued], len(count))
    mean = (total + _PRIOR_STROKES * step[valued].mean()) / (count + _PRIOR_STROKES)
    return np.asarray(step - mean[cell])


def _known(rows: Rows) -> Bools:
    """``[N]`` strokes whose positions and times are known."""
    return np.asarray(np.isfinite(rows.movement).all(axis=1))


def _inputs(rows: Rows) -> F64:
    """``[N, inputs]`` inputs of the trees."""
    codes = [rows.codes[name][:, None] for name in _CODES]
    return np.concatenate([*codes, rows.movement], axis=1).astype(np.float64)


@compiled
def _sums(inputs: F64, attribute: I32, cut: F64, child: I32, value: F64) -> F64:
    """``[N]`` sums of the leaves that each row reaches."""
    out = np.zeros(len(inputs))
    for row in range(len(inputs)):
        for tree in range(len(attribute)):
            node = 0
            while node >= 0:
                first = inputs[row, attribute[tree, node]] <= cut[tree, node]
                node = child[tree, node, 0 if first else 1]
            out[row] += value[tree, -1 - node]
    return out
