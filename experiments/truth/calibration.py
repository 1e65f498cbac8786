"""How much of a predicted advantage is realised: factors by horizon, and their check on matches that did not fit them.

The factor of a horizon is the decision slope (:mod:`experiments.truth.decisions`) on training matches. A calibrated advantage is
the predicted advantage times the factor; its slope on other matches is 1 in expectation.
"""

from collections.abc import Mapping

import numpy as np

from experiments.truth.decisions import Promises, centred, outcomes
from experiments.truth.matches import RESAMPLES, Strokes
from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game.shipped import Estimate


def calibration(
    strokes: Strokes, promised: Promises, part: Ints, factors: Mapping[str, Estimate] | None = None, seed: int = 0
) -> dict[str, dict[str, float]]:
    """Slopes of outcomes on calibrated advantages, at each horizon.

    Args:
        strokes: N strokes.
        promised: their promises, by games that were fitted without them.
        part: ``[N]`` part of each stroke's match; with one part, ``factors`` are needed.
        factors: factor of each horizon, fitted to other matches; None: the factor of each part is fitted to the other parts.
        seed: random seed of the bootstrap over matches. The matches that fit the factors and those that check them are resampled
            independently, because the same resample for both would cancel most of their errors.

    Returns:
        For each horizon ``slope`` with its 95 % interval ``low`` to ``high``, and ``factor``, the mean over strokes.

    Raises:
        ShuttleError: neither factors nor a second part.
    """
    parts = np.unique(part)
    if factors is None and len(parts) < 2:
        raise ShuttleError("calibration: one part of the matches and no factors; expected factors fitted to other matches")
    part_of_match = np.zeros(int(strokes.rows.match.max()) + 1, dtype=np.int64)
    part_of_match[strokes.rows.match] = part
    out = {}
    for name, happened in outcomes(strokes, promised):
        x, y, match = centred(strokes, promised, happened)
        matches, index = np.unique(match, return_inverse=True)
        sums: F64 = np.stack([np.bincount(index, x * y), np.bincount(index, x * x)]).astype(np.float64)
        member = part_of_match[matches] == parts[:, None]
        known = None if factors is None else factors[name].value
        rng, everyone = np.random.default_rng(seed), np.arange(len(matches))[None]
        fitting, checking = rng.integers(0, len(matches), (2, RESAMPLES, len(matches)))
        slope, factor = _slope(sums, member, everyone, everyone, known)
        low, high = np.nanquantile(_slope(sums, member, fitting, checking, known)[0], [0.025, 0.975])
        out[name] = {"slope": float(slope[0]), "low": float(low), "high": float(high), "factor": float(factor[0])}
    return out


def _slope(sums: F64, member: Bools, fitting: I64, checking: I64, factor: float | None) -> tuple[F64, F64]:
    """Slope on calibrated advantages, and mean factor, of resamples of the matches.

    Args:
        sums: ``[2, M]`` sums of products xy and xx of each match.
        member: ``[K, M]`` whether a match belongs to a part.
        fitting, checking: ``[B, M]`` matches of each resample that fit the factors, and that check them.
        factor: the factor; None: that of the other parts.
    """

    def by_part(draws: I64) -> F64:
        return np.stack([(sums[:, None] * own)[..., draws].sum(axis=-1)[:, 0] for own in member.astype(np.float64)], axis=1)

    xy, xx = by_part(checking)  # [K, B] each
    fitted_xy, fitted_xx = by_part(fitting)
    with np.errstate(invalid="ignore", divide="ignore"):
        others = (fitted_xy.sum(axis=0) - fitted_xy) / (fitted_xx.sum(axis=0) - fitted_xx)
        factors = others if factor is None else np.full_like(xy, factor)
        weight = xx / xx.sum(axis=0)
        return (factors * xy).sum(axis=0) / (factors**2 * xx).sum(axis=0), (weight * factors).sum(axis=0)
