"""Can a classifier distinguish simulated rallies from real ones, and by which features?

Simulated rallies are the average player against itself. Incomplete rallies are excluded on both sides, except those without only
the first stroke, which the cameras missed.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import lightgbm
import numpy as np
from scipy.spatial.distance import jensenshannon
from scipy.stats import ks_2samp

from experiments.truth.matches import Strokes, folds_of, ratio_by_match
from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.evaluate import area_under_curve
from shuttle_marl.dynamics.models import fold_of_match
from shuttle_marl.game.court import AREAS, N_AREAS
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, SHOTS, TECHNIQUES

HALVINGS: Final = 20  # random halvings of the real matches behind every figure of real against real
_LISTED: Final = 10  # features that are reported
_FOLDS: Final = 5
_LAGS: Final = (1, 2, 3, 4)


def rally_length(simulated: Strokes, real: Strokes, seed: int = 0) -> dict[str, float]:
    """Kolmogorov-Smirnov distance of the lengths, and the mean distance of halves of the real matches (``ks_real``)."""
    pairs = [(simulated, real), *((real.take(half), real.take(~half)) for half in _halvings(real, seed, HALVINGS))]
    first, *halves = [float(ks_2samp(_lengths(one), _lengths(other)).statistic) for one, other in pairs]
    return {"ks": first, "ks_real": float(np.mean(halves))}


def divergence(simulated: Strokes, real: Strokes, seed: int = 0) -> dict[str, dict[str, float]]:
    """Jensen-Shannon divergences in bits, also between random halves of the real matches."""
    halvings = _halvings(real, seed, HALVINGS)
    out = {}
    for name, count in (("shot", _shots), ("transition", _transitions), ("area", _areas), ("endings", _endings)):
        between = [_bits(count(real.take(half)), count(real.take(~half))) for half in halvings]
        out[name] = {"value": _bits(count(simulated), count(real)), "real_against_real": float(np.mean(between))}
    return out


def two_sample_auc(simulated: Strokes, real: Strokes, seed: int = 0, training: Sequence[Strokes] | None = None) -> dict[str, Any]:
    """Area under the ROC curve of boosted trees that tell whole rallies apart by what follows the serve, on matches that they
    did not see.

    Args:
        simulated, real: rallies of either kind.
        seed: of the trees, of how the real matches are halved, and of the resamples.
        training: simulated and real rallies of other matches, on which the trees are fitted; None: those of the same ones,
            cross-validated by match, which takes many matches.

    Returns:
        ``value``, ``real_against_real`` (the same for random halves of the real matches) or, of trees that were fitted to other
        matches, ``low`` and ``high`` (95 % interval by a bootstrap over the real ones), and ``gives_away``: for the features
        with most gain, their share of the gain, their means ``simulated`` and ``real``, and the ``difference`` of these in
        standard deviations over real rallies.
    """
    sides = [_features(simulated), _features(real)]
    found: dict[str, float] = {}
    if training is None:
        found["value"], gain = _auc(sides, seed)
        halves = [[_features(real.take(half)), _features(real.take(~half))] for half in _halvings(real, seed, 6)]
        found["real_against_real"] = float(np.mean([_auc(half, seed)[0] for half in halves]))
    else:
        x, label, _ = _balanced([_features(side) for side in training], seed)
        trees = _fitted(x, label, seed)
        gain = trees.feature_importance("gain") / trees.feature_importance("gain").sum()
        ours, theirs = (np.asarray(trees.predict(side.values)) for side in sides)
        # The area is the mean, over real rallies, of the fraction of simulated ones that look more simulated.
        below, not_above = (np.searchsorted(np.sort(ours), theirs, side) for side in ("left", "right"))
        found |= ratio_by_match(1 - (below + not_above) / (2 * len(ours)), np.ones(len(theirs)), sides[1].match, seed)
    means, spread = [side.values.mean(axis=0) for side in sides], sides[1].values.std(axis=0)
    gives_away = {
        _NAMES[i]: {
            "gain": float(gain[i]),
            "simulated": float(means[0][i]),
            "real": float(means[1][i]),
            "difference": float((means[0][i] - means[1][i]) / spread[i]),
        }
        for i in np.argsort(-gain)[:_LISTED]
    }
    return {**found, "gives_away": gives_away}


def _auc(sides: list["_Features"], seed: int) -> tuple[float, F64]:
    """Cross-validated by match."""
    x, label, match = _balanced(sides, seed)
    p, gain = np.empty(len(x)), np.zeros(x.shape[1])
    fold = fold_of_match(match, _FOLDS)
    for k in range(_FOLDS):
        seen, unseen = fold != k, fold == k
        trees = _fitted(x[seen], label[seen], seed)
        p[unseen] = trees.predict(x[unseen])
        gain += trees.feature_importance("gain")
    return float(area_under_curve(label == 1, p)), gain / gain.sum()


def _balanced(sides: list["_Features"], seed: int) -> tuple[F64, I64, I64]:
    """Features, labels and matches of as many rallies of either side."""
    rng = np.random.default_rng(seed)
    size = min(len(side.values) for side in sides)
    chosen = [np.sort(rng.choice(len(side.values), size, replace=False)) for side in sides]
    x = np.concatenate([side.values[rows] for side, rows in zip(sides, chosen, strict=True)])
    match = np.concatenate([side.match[rows] + i * 10_000 for i, (side, rows) in enumerate(zip(sides, chosen, strict=True))])
    return x, np.repeat([1, 0], size), match


def _fitted(x: F64, label: I64, seed: int) -> lightgbm.Booster:
    options = {
        "objective": "binary", "num_leaves": 15, "learning_rate": 0.05, "min_data_in_leaf": 40, "feature_fraction": 0.7,
        "deterministic": True, "force_row_wise": True, "num_threads": 1, "seed": seed, "verbosity": -1,
    }  # fmt: skip
    return lightgbm.train(options, lightgbm.Dataset(x, label), num_boost_round=150)


@dataclasses.dataclass(frozen=True, eq=False)
class _Features:
    """Input of the trees: ``[R, F]`` features of each rally, and its match ``[R]``."""

    values: F64
    match: I64


_NAMES: Final = (
    "strokes",
    *(f"share of {shot}" for shot in SHOTS),
    *(f"share of {technique}" for technique in TECHNIQUES),
    *(f"share of {area}" for area in AREAS),
    "share struck from above",
    "share across the court",
    *(f"same shot as {lag} strokes before" for lag in _LAGS),
    *(f"last stroke {shot}" for shot in SHOTS),
    "ended by a fault",
)


def _features(strokes: Strokes) -> _Features:
    # Real tables lack the serve of every fifth rally, so the serve or its absence would reveal simulated rallies.
    rallied = strokes.number > 1
    whole, strokes = _whole(strokes)[rallied], strokes.take(rallied)
    rows, rally = strokes.rows, strokes.rally
    count = int(rally[-1]) + 1
    size = np.bincount(rally, minlength=count).astype(np.float64)
    codes = {name: code.astype(np.int64) for name, code in rows.codes.items()}
    # The area of a fault is where it came down, which the simulated tables can only imitate.
    aimed = (rows.outcome != Outcome.FAULT) & (codes["area"] >= 0)
    before = (codes["incoming_area"] < N_AREAS) & aimed
    # Both areas are seen by the player of their half, so a cross-court stroke goes from right to right or left to left.
    across = before & (codes["area"] % 3 == codes["incoming_area"] % 3) & (codes["area"] % 3 != 1)

    def share(marked: Bools, of: Bools | None = None) -> F64:
        total = size if of is None else np.bincount(rally, of, count)
        return np.asarray(np.bincount(rally, marked, count) / np.maximum(total, 1))

    columns = [size]
    columns += [share(codes["shot"] == i) for i in range(N_SHOTS)]
    columns += [share(codes["technique"] == i) for i in range(N_TECHNIQUES)]
    columns += [share(aimed & (codes["area"] == i), aimed) for i in range(N_AREAS)]
    columns += [share(codes["contact"] == 1), share(across, before)]
    for lag in _LAGS:
        row = np.arange(lag, len(rally))
        inside = np.r_[np.zeros(lag, bool), rally[row] == rally[row - lag]]
        same = np.r_[np.zeros(lag, bool), codes["shot"][row] == codes["shot"][row - lag]]
        columns.append(share(inside & same, inside))
    last = np.unique(strokes.last)
    columns += [(codes["shot"][last] == i).astype(np.float64) for i in range(N_SHOTS)]
    columns.append((rows.outcome[last] == Outcome.FAULT).astype(np.float64))
    return _Features(np.stack(columns, axis=1)[whole[last]], rows.match[last][whole[last]].astype(np.int64))


def _whole(strokes: Strokes) -> Bools:
    """``[N]`` whether the rally is complete from its first or second stroke to a last stroke of known outcome."""
    first = np.r_[True, np.diff(strokes.rally) != 0]
    start = strokes.number[first][strokes.rally]
    length = strokes.number[strokes.last]
    kept = np.bincount(strokes.rally)[strokes.rally]
    return np.asarray((strokes.result != 0) & (start <= 2) & (kept == length - start + 1))


def _lengths(strokes: Strokes) -> I64:
    last = np.unique(strokes.last)
    return strokes.number[last][strokes.result[last] != 0]


def _halvings(strokes: Strokes, seed: int, count: int) -> list[Bools]:
    """Random halves of the matches, each with half of either discipline, as masks of the strokes."""
    return [folds_of(strokes, 2, seed + i) == 0 for i in range(count)]


def _bits(first: Ints, second: Ints) -> float:
    return float(jensenshannon(first, second, base=2) ** 2)


def _shots(strokes: Strokes) -> I64:
    return np.bincount(strokes.rows.codes["shot"], minlength=N_SHOTS)


def _transitions(strokes: Strokes) -> I64:
    codes = strokes.rows.codes
    known = codes["incoming_shot"] < N_SHOTS
    pairs = codes["incoming_shot"][known].astype(np.int64) * N_SHOTS + codes["shot"][known]
    return np.bincount(pairs, minlength=N_SHOTS * N_SHOTS)


def _areas(strokes: Strokes) -> I64:
    rows = strokes.rows
    aimed = (rows.outcome != Outcome.FAULT) & (rows.codes["area"] >= 0)
    return np.bincount(rows.codes["area"][aimed], minlength=N_AREAS)


def _endings(strokes: Strokes) -> I64:
    rows = strokes.rows
    ended = (rows.outcome == Outcome.FAULT) | (rows.outcome == Outcome.WINNER)
    kind = 2 * rows.codes["shot"][ended].astype(np.int64) + (rows.outcome[ended] == Outcome.WINNER)
    return np.bincount(kind, minlength=2 * N_SHOTS)
