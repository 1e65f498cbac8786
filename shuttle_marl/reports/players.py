"""Players ranked by the value that their strokes add."""

import dataclasses
import math
from typing import Final

import numpy as np
import pyarrow as pa
from scipy import stats

from shuttle_marl.base.arrays import F64, Intp
from shuttle_marl.reports.summary import AnalysisError

LEAST_MATCHES: Final = 3
LEAST_STROKES: Final = 200
RESAMPLES: Final = 2000
LEVEL: Final = 0.95
_DRAWS_AT_ONCE: Final = 1 << 22
"""Largest number of bootstrap samples in memory."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlayerValue:
    """Value added by the strokes of a player.

    Attributes:
        discipline: MS or WS.
        matches, strokes: number of matches and of strokes with a known value.
        value: mean value added by a stroke.
        low, high: 95 % interval of ``value``.
        decision: mean of the part due to the choice of the stroke, over the strokes for which it is known.
        decision_low, decision_high: 95 % interval of ``decision``.
    """

    player: str
    discipline: str
    matches: int
    strokes: int
    value: float
    low: float
    high: float
    decision: float
    decision_low: float
    decision_high: float


def rank_players(
    valued: pa.Table,
    *,
    least_matches: int = LEAST_MATCHES,
    least_strokes: int = LEAST_STROKES,
    centred: bool = False,
    seed: int = 0,
) -> list[PlayerValue]:
    """Rank the players of a table by mean value added per stroke, best first.

    Intervals come from a cluster bootstrap over a player's matches, because strokes of a match share opponent, hall and form
    (Cameron, Gelbach & Miller, Review of Economics and Statistics 2008). With few clusters M the bootstrap underestimates the
    error, so it is scaled by sqrt(M / (M - 1)), and the interval uses Student's t with M - 1 degrees of freedom.

    Args:
        valued: table from :func:`shuttle_marl.reports.value.add_values`.
        least_matches, least_strokes: players with fewer are left out; at least two matches are needed.
        centred: subtract the mean stroke of the discipline: the average profile of the game is a mean of both disciplines, whose
            frequencies of winners and faults differ.
        seed: random seed of the bootstrap.

    Raises:
        AnalysisError: no player has enough matches and strokes.
    """
    value, decision = (valued[name].to_numpy(zero_copy_only=False) for name in ("value_added", "decision"))
    player, match = (valued[name].combine_chunks().dictionary_encode() for name in ("player", "match"))
    names, player_index, match_index = player.dictionary.to_pylist(), player.indices.to_numpy(), match.indices.to_numpy()
    kinds = valued["discipline"].to_numpy(zero_copy_only=False)
    if centred:
        for kind in np.unique(kinds):
            same = kinds == kind
            value = np.where(same, value - np.nanmean(value[same]), value)
            decision = np.where(same, decision - np.nanmean(decision[same]), decision)
    known = np.isfinite(value)
    ranked = []
    for number in sorted(range(len(names)), key=lambda i: names[i]):
        mine = np.flatnonzero(known & (player_index == number))
        matches, cluster = np.unique(match_index[mine], return_inverse=True)
        if len(matches) < max(2, least_matches) or len(mine) < least_strokes:
            continue
        sums = np.stack([*_sums(value[mine], cluster), *_sums(decision[mine], cluster)], axis=1)
        drawn = _resampled(sums, np.random.default_rng([seed, number]))
        means = (*_interval(sums[:, :2], drawn[:, :2]), *_interval(sums[:, 2:], drawn[:, 2:]))
        ranked.append(
            PlayerValue(
                player=names[number],
                discipline=str(kinds[mine[0]]),
                matches=len(matches),
                strokes=len(mine),
                **dict(zip(("value", "low", "high", "decision", "decision_low", "decision_high"), means, strict=True)),
            )
        )
    if not ranked:
        raise AnalysisError(
            f"no player with {least_matches} matches and {least_strokes} strokes or more; ask for fewer, or add matches"
        )
    return sorted(ranked, key=lambda p: (-p.value, p.player))


def _sums(values: F64, cluster: Intp) -> tuple[F64, F64]:
    """Sum and number of known values in each cluster, ``[M]`` each."""
    known = np.isfinite(values)
    size = int(cluster.max()) + 1
    total, count = np.bincount(cluster[known], values[known], size), np.bincount(cluster[known], minlength=size)
    return np.asarray(total, dtype=np.float64), count.astype(np.float64)


def _resampled(sums: F64, rng: np.random.Generator) -> F64:
    """``[RESAMPLES, 4]`` sums of M clusters drawn with replacement, from the sums of clusters ``[M, 4]``."""
    size = len(sums)
    at_once = max(1, _DRAWS_AT_ONCE // size)
    counts = [min(at_once, RESAMPLES - first) for first in range(0, RESAMPLES, at_once)]
    return np.concatenate([rng.multinomial(size, np.full(size, 1 / size), count) @ sums for count in counts])


def _interval(sums: F64, drawn: F64) -> tuple[float, float, float]:
    """Mean and interval, from sums and counts of clusters ``[M, 2]`` and of bootstrap samples ``[RESAMPLES, 2]``."""
    size = len(sums)
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = float(np.nanstd(drawn[:, 0] / drawn[:, 1]))
    mean = float(sums[:, 0].sum() / max(1.0, sums[:, 1].sum()))
    error = spread * math.sqrt(size / (size - 1)) * float(stats.t.ppf((1 + LEVEL) / 2, size - 1))
    return mean, mean - error, mean + error
