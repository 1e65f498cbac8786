"""Do strikers know where the receiver waits?

Strokes that went out, which nobody met, tell where the striker aimed. If positions are hidden, the side to which a stroke is
aimed does not depend on where the receiver stands, given the state.
"""

from typing import Final

import numpy as np

from experiments.truth.matches import RESAMPLES
from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.dynamics.features import MOVEMENT, Rows
from shuttle_marl.dynamics.models import log_odds, sigmoid
from shuttle_marl.dynamics.recovery import GROUPS, placed
from shuttle_marl.game.court import FOREHAND, N_AREAS, N_SIDES, mirrored
from shuttle_marl.game.stroke import SHOTS

_ROUNDS: Final = 10


def aims(rows: Rows, landing: F64, targets: F64) -> dict[str, dict[str, dict[str, float]]]:
    """Whether strokes that went out were aimed away from the receiver, by group of shot types.

    Args:
        rows: N strokes.
        landing: ``[N]`` how far to the striker's right they landed [m].
        targets: ``[N, 9]`` probability of each target without the position.

    Returns:
        For each group :func:`slope` of "landed on the receiver's forehand side" on how far the receiver stood to that side [m],
        beside the log-odds of that side by the targets (``state``), and beside the lateral contact point too (``contact``).
    """
    out = (rows.outcome == Outcome.FAULT) & (rows.reason == REASONS.index("out")) & placed(rows) & np.isfinite(landing)
    forehand, opposite = (landing < 0) != (rows.receiver_hand == 1), rows.codes["hands"] == 1
    there = np.where(opposite[:, None], targets[:, mirrored(np.arange(N_AREAS))], targets)
    sides = there.reshape(-1, N_AREAS // N_SIDES, N_SIDES).sum(axis=1)
    expected = log_odds(sides[:, FOREHAND] + sides[:, N_SIDES // 2] / 2)
    contact = np.where(opposite, -1, 1) * rows.movement[:, MOVEMENT.index("contact_x")]
    x = np.stack([rows.waiting[:, 0], expected, contact], axis=1).astype(np.float64)
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name, shots in GROUPS.items():
        those = out & np.isin(np.array(SHOTS)[rows.codes["shot"]], shots)
        known = those & np.isfinite(contact)
        found[name] = {
            "state": slope(x[those, :2], forehand[those], rows.match[those]),
            "contact": slope(x[known], forehand[known], rows.match[known]),
        }
    return found


def slope(x: F64, label: Bools, match: Ints, seed: int = 0) -> dict[str, float]:
    """The first coefficient of a logistic regression, with a 95 % interval by a bootstrap over matches.

    Args:
        x: ``[N, K]`` columns; an intercept is added.
        label: ``[N]`` what happened.
        match: ``[N]`` match of each row.
        seed: of the resamples.
    """
    names, index = np.unique(match, return_inverse=True)
    columns, w = np.column_stack([x, np.ones(len(x))]), np.zeros(x.shape[1] + 1)
    for _ in range(_ROUNDS):
        p = sigmoid(columns @ w)
        score = columns * (label - p)[:, None]
        information = columns[:, :, None] * columns[:, None] * (p * (1 - p))[:, None, None]
        w = w + np.linalg.solve(information.sum(axis=0), score.sum(axis=0))
    # One step from the estimate instead of a regression for each resample.
    drawn = np.random.default_rng(seed).multinomial(len(names), np.full(len(names), 1 / len(names)), RESAMPLES)
    sums, curvature = (np.tensordot(drawn, _by_match(of, index), axes=1) for of in (score, information))
    low, high = np.quantile(w[0] + np.linalg.solve(curvature, sums[:, :, None])[:, 0, 0], [0.025, 0.975])
    return {"value": float(w[0]), "low": float(low), "high": float(high), "strokes": len(label)}


def _by_match(values: F64, index: I64) -> F64:
    """``[matches, ...]`` sums of ``[N, ...]`` values."""
    total = np.zeros((index.max() + 1, *values.shape[1:]))
    np.add.at(total, index, values)
    return total
