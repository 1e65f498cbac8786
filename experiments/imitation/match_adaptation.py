"""Adaptation of predictions to a match, from its strokes so far: annotators and players differ between matches.

Within each match, a multinomial logistic regression predicts the strokes with the logarithm of the imitator's prediction as
offset. Its weights describe how the match departs from the prediction: overall, by contact height, incoming shot type, player and
position. They have a normal prior with mean zero; every stroke updates mean and covariance of the weights of each class
(Spiegelhalter and Lauritzen, Networks 1990: sequential updating with a normal approximation, one class against the others).
"""

from typing import Final

import numpy as np
import pyarrow as pa

from experiments.imitation.context import CODES, hit_contexts
from shuttle_marl.base.arrays import F32, F64, I64
from shuttle_marl.base.compiling import compiled
from shuttle_marl.data.schema import Outcome
from shuttle_marl.game.stroke import N_SHOTS

TYPE_VARIANCES: Final = {
    "match": 0.2, "height": 0.05, "reply": 0.07, "player": 0.03, "player_height": 0.03, "position": 0.03, "predicted": 0.3,
}  # fmt: skip
"""Prior variances of the weights of shot types; chosen, as those of areas, by cross-validation over the training matches."""
AREA_VARIANCES: Final = {
    "match": 0.025, "player": 0.02, "position": 0.02, "type": 0.03, "type_player": 0.02, "predicted": 0.2,
}  # fmt: skip
"""Prior variances of the weights of areas."""
_POSITION: Final = ((0, 0.0, 1.3), (1, -4.0, 1.6), (10, 0.0, 1.0), (11, 4.0, 1.2), (30, 0.95, 0.3))
"""Column, mean and spread of the position of the striker (x, y) and receiver (x, y), and of the time since the last stroke."""
_MAX_SPREADS: Final = 2.5
_MIN_PROBABILITY: Final = 1e-12
_MIN_CURVATURE: Final = 1e-5
"""Classes that are almost certain or almost impossible are not updated."""


def adapt_to_match(probability: F64, strokes: pa.Table, *, height_known: bool = True) -> F64:
    """Adapt predictions of an imitator to each match, by the strokes before the predicted one.

    Args:
        probability: ``[N, 13, 9]`` of each shot type and area, as returned by
            :meth:`experiments.imitation.imitator.Imitator.predict`.
        strokes: the N strokes, whole matches in playing order.
        height_known: whether the prediction may depend on the contact height.

    Returns:
        ``[N, 13, 9]`` probabilities.
    """
    contexts = hit_contexts(strokes)
    if not height_known:
        contexts = contexts.without_height()
    match = _coded(strokes, "match")
    side = _sides(match, _coded(strokes, "player"))
    shared = {"match": np.ones_like(side), "player": side, "position": _positions(contexts.numbers)}
    shot = strokes["shot"].to_numpy(zero_copy_only=False).astype(np.int64)
    of_type = np.maximum(probability.sum(axis=2), _MIN_PROBABILITY)
    codes = dict(zip(CODES, contexts.codes.T.astype(np.int64), strict=True))
    height = _one_hot(codes["height"], CODES["height"])
    reply = _one_hot(codes["height"] * CODES["shot_1"] + codes["shot_1"], CODES["height"] * CODES["shot_1"])
    inputs = {**shared, "height": height, "player_height": side * height, "reply": reply, "predicted": of_type}
    types = _adapted(of_type[:, None], *_stacked(inputs, TYPE_VARIANCES, 1), match, np.zeros_like(shot), shot)
    area = strokes["area"].fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int64)
    # The target of a fault is unknown, and a winner has no contact point.
    area = np.where(strokes["outcome"].to_numpy(zero_copy_only=False) == Outcome.RETURNED, area, -1)
    given = probability / of_type[:, :, None]
    each = np.broadcast_to(np.eye(N_SHOTS), (len(shot), N_SHOTS, N_SHOTS))
    inputs = {**shared, "type": each, "type_player": each * side[:, :, None], "predicted": given}
    areas = _adapted(given, *_stacked(inputs, AREA_VARIANCES, N_SHOTS), match, shot, area)
    return np.asarray(types[:, 0, :, None] * areas)


def _positions(numbers: F32) -> F64:
    """``[N, 5]`` positions and time of contexts, standardised; 0 where unknown."""
    columns, mean, spread = (np.array(values) for values in zip(*_POSITION, strict=True))
    return np.clip(np.nan_to_num((numbers[:, columns] - mean) / spread), -_MAX_SPREADS, _MAX_SPREADS)


def _coded(strokes: pa.Table, name: str) -> I64:
    codes = strokes[name].combine_chunks().dictionary_encode().indices
    return np.asarray(codes.to_numpy(zero_copy_only=False), dtype=np.int64)


def _sides(match: I64, player: I64) -> F64:
    """``[N, 1]`` 1 for the first server of a match, -1 for the opponent."""
    _, first, position = np.unique(match, return_index=True, return_inverse=True)
    return np.where(player == player[first][position], 1.0, -1.0)[:, None]


def _one_hot(codes: I64, n: int) -> F64:
    return np.asarray(codes[:, None] == np.arange(n), dtype=np.float64)


def _stacked(inputs: dict[str, F64], variances: dict[str, float], distributions: int) -> tuple[F64, F64]:
    """``[N, R, D]`` inputs of R distributions, from ``[N, d]`` (shared by all) or ``[N, R, d]``, and ``[D]`` prior variances."""
    parts = {
        name: part if part.ndim == 3 else np.broadcast_to(part[:, None], (len(part), distributions, part.shape[1]))
        for name, part in inputs.items()
    }
    return (
        np.concatenate(list(parts.values()), axis=2),
        np.concatenate([np.full(part.shape[2], variances[name]) for name, part in parts.items()]),
    )


@compiled
def _adapted(probability: F64, inputs: F64, variances: F64, match: I64, which: I64, label: I64) -> F64:
    """Adapt R distributions at each of N strokes to the previous strokes of the match.

    Args:
        probability: ``[N, R, C]`` predictions.
        inputs: ``[N, R, D]`` inputs of the regression.
        variances: ``[D]`` prior variance of each weight.
        match: ``[N]`` match; its strokes are consecutive.
        which: ``[N]`` distribution of the observed label.
        label: ``[N]`` observed class, -1 where unknown.
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
                out[i, r, c] = max(probability[i, r, c], _MIN_PROBABILITY) * np.exp(logit)
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
            if curvature < _MIN_CURVATURE:
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
