"""Predictions corrected by the match so far: annotators name strokes in their own way, and players have their day.

Within each match, what was played is regressed on what was predicted: a multinomial logistic regression whose offset is the
logarithm of the prediction. Its weights say how this match departs from it: in general, by contact height, incoming shot type,
player and place. They start at zero with a normal prior, and each stroke updates the mean and covariance of those of each class
(Spiegelhalter and Lauritzen, Networks 1990: sequential updating with a normal approximation, each class against the others).
"""

from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.arrays import F32, F64, I64
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.moments import CODES, moments_of
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.kernel.compiling import compiled

TYPE_VARIANCES: Final = {
    "match": 0.2, "height": 0.05, "reply": 0.07, "player": 0.03, "player_height": 0.03, "place": 0.03, "guess": 0.3,
}  # fmt: skip
"""Prior variances of the weights of shot types. They, and those of areas, were chosen on blind folds of the training matches."""
AREA_VARIANCES: Final = {"match": 0.025, "player": 0.02, "place": 0.02, "type": 0.03, "type_player": 0.02, "guess": 0.2}
"""Prior variances of the weights of areas."""
_PLACE: Final = ((0, 0.0, 1.3), (1, -4.0, 1.6), (10, 0.0, 1.0), (11, 4.0, 1.2), (30, 0.95, 0.3))
"""Numbers of a moment that say where and how fast: column, usual value, spread. The striker, the receiver, the time between."""
_FARTHEST: Final = 2.5
_LEAST_PROBABILITY: Final = 1e-12
_LEAST_CURVATURE: Final = 1e-5
"""A class that is as good as certain, or impossible, teaches nothing."""


def adapted(probability: F64, strokes: pa.Table, *, height_known: bool = True) -> F64:
    """Predictions of an imitator, each corrected by the strokes of its match that were struck before.

    Nothing after the hit is read: what a stroke was corrects the later ones.

    Args:
        probability: ``[N, 13, 9]`` of each shot type and area, as :meth:`shuttle_marl.dynamics.imitator.Imitator.predict` gives.
        strokes: the N strokes, whole matches in playing order.
        height_known: whether the height at which the shuttle is met may be read.

    Returns:
        ``[N, 13, 9]`` probabilities.
    """
    moments = moments_of(strokes)
    if not height_known:
        moments = moments.without_height()
    match = _coded(strokes, "match")
    side = _sides(match, _coded(strokes, "player"))
    alike = {"match": np.ones_like(side), "player": side, "place": _places(moments.numbers)}
    shot = strokes["shot"].to_numpy(zero_copy_only=False).astype(np.int64)
    of_type = np.maximum(probability.sum(axis=2), _LEAST_PROBABILITY)
    codes = dict(zip(CODES, moments.codes.T.astype(np.int64), strict=True))
    height = _one_hot(codes["height"], CODES["height"])
    reply = _one_hot(codes["height"] * CODES["shot_1"] + codes["shot_1"], CODES["height"] * CODES["shot_1"])
    seen = {**alike, "height": height, "player_height": side * height, "reply": reply, "guess": of_type}
    types = _corrected(of_type[:, None], *_inputs(seen, TYPE_VARIANCES, 1), match, np.zeros_like(shot), shot)
    area = strokes["area"].fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int64)
    # A fault does not say where it was aimed, and a winner came down where no one met it.
    area = np.where(strokes["outcome"].to_numpy(zero_copy_only=False) == Outcome.RETURNED, area, -1)
    given = probability / of_type[:, :, None]
    each = np.broadcast_to(np.eye(N_SHOTS), (len(shot), N_SHOTS, N_SHOTS))
    seen = {**alike, "type": each, "type_player": each * side[:, :, None], "guess": given}
    areas = _corrected(given, *_inputs(seen, AREA_VARIANCES, N_SHOTS), match, shot, area)
    return np.asarray(types[:, 0, :, None] * areas)


def _places(numbers: F32) -> F64:
    """``[N, 5]`` places and time of moments, in spreads from what is usual; 0 where not known."""
    columns, usual, spread = (np.array(values) for values in zip(*_PLACE, strict=True))
    return np.clip(np.nan_to_num((numbers[:, columns] - usual) / spread), -_FARTHEST, _FARTHEST)


def _coded(strokes: pa.Table, name: str) -> I64:
    codes = strokes[name].combine_chunks().dictionary_encode().indices
    return np.asarray(codes.to_numpy(zero_copy_only=False), dtype=np.int64)


def _sides(match: I64, player: I64) -> F64:
    """``[N, 1]`` 1 for the player who strikes first in a match, -1 for the other one."""
    _, first, position = np.unique(match, return_index=True, return_inverse=True)
    return np.where(player == player[first][position], 1.0, -1.0)[:, None]


def _one_hot(codes: I64, n: int) -> F64:
    return np.asarray(codes[:, None] == np.arange(n), dtype=np.float64)


def _inputs(seen: dict[str, F64], variances: dict[str, float], distributions: int) -> tuple[F64, F64]:
    """``[N, R, D]`` inputs of R distributions, from ``[N, d]`` alike for all or ``[N, R, d]``, and ``[D]`` prior variances."""
    parts = {
        name: part if part.ndim == 3 else np.broadcast_to(part[:, None], (len(part), distributions, part.shape[1]))
        for name, part in seen.items()
    }
    return (
        np.concatenate(list(parts.values()), axis=2),
        np.concatenate([np.full(part.shape[2], variances[name]) for name, part in parts.items()]),
    )


@compiled
def _corrected(probability: F64, inputs: F64, variances: F64, match: I64, which: I64, label: I64) -> F64:
    """Correct R distributions at each of N strokes by what was seen in the strokes of the match before.

    Args:
        probability: ``[N, R, C]`` predictions.
        inputs: ``[N, R, D]`` what the departure from each may depend on.
        variances: ``[D]`` of the prior of each weight.
        match: ``[N]`` the match; its strokes follow each other.
        which: ``[N]`` distribution that was drawn from.
        label: ``[N]`` what was drawn, -1 where that is not known.
    """
    n, distributions, classes = probability.shape
    size = len(variances)
    out = np.empty((n, distributions, classes))
    mean, covariance = np.zeros((classes, size)), np.zeros((classes, size, size))
    read, moved = np.zeros(size, dtype=np.int64), np.zeros(size)
    for i in range(n):
        if i == 0 or match[i] != match[i - 1]:
            mean[:] = 0.0
            covariance[:] = 0.0
            for c in range(classes):
                for d in range(size):
                    covariance[c, d, d] = variances[d]
        for r in range(distributions):
            total = 0.0
            for c in range(classes):
                logit = 0.0
                for d in range(size):
                    logit += mean[c, d] * inputs[i, r, d]
                out[i, r, c] = max(probability[i, r, c], _LEAST_PROBABILITY) * np.exp(logit)
                total += out[i, r, c]
            for c in range(classes):
                out[i, r, c] /= total
        if label[i] < 0:
            continue
        x, n_read = inputs[i, which[i]], 0
        for d in range(size):
            if x[d] != 0:
                read[n_read] = d
                n_read += 1
        for c in range(classes):
            p = out[i, which[i], c]
            curvature = p * (1 - p)
            if curvature < _LEAST_CURVATURE:
                continue
            variance = 0.0
            for d in range(size):
                moved[d] = 0.0
                for k in range(n_read):
                    moved[d] += covariance[c, d, read[k]] * x[read[k]]
                variance += moved[d] * x[d]
            step = 1 / (1 + curvature * variance)
            for d in range(size):
                mean[c, d] += moved[d] * ((1.0 if label[i] == c else 0.0) - p) * step
                for e in range(size):
                    covariance[c, d, e] -= moved[d] * moved[e] * curvature * step
    return out
