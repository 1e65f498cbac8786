"""Players ranked by the value that their strokes added, with intervals."""

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from scipy import stats

from shuttle_marl.analysis.errors import AnalysisError

Floats = npt.NDArray[np.float64]

LEAST_MATCHES: Final = 3
LEAST_STROKES: Final = 200
RESAMPLES: Final = 2000
LEVEL: Final = 0.95
_DRAWS_AT_ONCE: Final = 1 << 22
"""So many numbers of a bootstrap are held at once."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlayerValue:
    """What the strokes of a player added.

    Attributes:
        player: identifier.
        discipline: MS or WS.
        matches, strokes: how many went in; strokes whose value is not known are left out.
        value: chance to win the rally that a stroke added, mean.
        low, high: bounds of its 95 % interval.
        decision: the part of it that follows from the choice of the stroke, mean over the strokes where it is known.
        decision_low, decision_high: bounds of its interval.
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
    """Rank the players of a table by value added a stroke, best first.

    The intervals come from a bootstrap over a player's matches: strokes of a match share an opponent, a hall and a form, and
    are not independent (Cameron, Gelbach & Miller, Review of Economics and Statistics 2008). A bootstrap of M clusters gives
    too small an error where M is small; so the error is scaled by the root of M / (M - 1), and Student's t with M - 1
    degrees of freedom makes the interval of it: wide for players with few matches.

    Args:
        valued: what :func:`shuttle_marl.analysis.values.add_values` made.
        least_matches, least_strokes: players with less are left out; two matches at the least.
        centred: measure players by the mean stroke of their discipline in the table, instead of by the reference: the average
            profile of the game is of both disciplines, in which winners and faults are not equally frequent.
        seed: of the bootstrap.

    Raises:
        AnalysisError: nobody has played as much.
    """
    value, decision = (valued[name].to_numpy(zero_copy_only=False) for name in ("value_added", "decision"))
    player, match = (valued[name].combine_chunks().dictionary_encode() for name in ("player", "match"))
    names, who, which = player.dictionary.to_pylist(), player.indices.to_numpy(), match.indices.to_numpy()
    kinds = valued["discipline"].to_numpy(zero_copy_only=False)
    if centred:
        for kind in np.unique(kinds):
            there = kinds == kind
            value = np.where(there, value - np.nanmean(value[there]), value)
            decision = np.where(there, decision - np.nanmean(decision[there]), decision)
    known = np.isfinite(value)
    found = []
    for number in sorted(range(len(names)), key=lambda i: names[i]):
        mine = np.flatnonzero(known & (who == number))
        matches, cluster = np.unique(which[mine], return_inverse=True)
        if len(matches) < max(2, least_matches) or len(mine) < least_strokes:
            continue
        sums = np.stack([*_sums(value[mine], cluster), *_sums(decision[mine], cluster)], axis=1)
        drawn = _resampled(sums, np.random.default_rng([seed, number]))
        mean, low, high = _interval(sums[:, :2], drawn[:, :2])
        chosen, chosen_low, chosen_high = _interval(sums[:, 2:], drawn[:, 2:])
        found.append(
            PlayerValue(
                player=names[number],
                discipline=str(kinds[mine[0]]),
                matches=len(matches),
                strokes=len(mine),
                value=mean,
                low=low,
                high=high,
                decision=chosen,
                decision_low=chosen_low,
                decision_high=chosen_high,
            )
        )
    if not found:
        raise AnalysisError(
            f"no player with {least_matches} matches and {least_strokes} strokes or more; ask for fewer, or add matches"
        )
    return sorted(found, key=lambda p: (-p.value, p.player))


def _sums(values: Floats, cluster: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
    """``[M]`` each: sum and number of the values that are known, by cluster."""
    known = np.isfinite(values)
    size = int(cluster.max()) + 1
    total, count = np.bincount(cluster[known], values[known], size), np.bincount(cluster[known], minlength=size)
    return np.asarray(total, dtype=np.float64), count.astype(np.float64)


def _resampled(sums: Floats, rng: np.random.Generator) -> Floats:
    """``[RESAMPLES, 4]`` sums when M clusters ``[M, 4]`` are drawn with replacement."""
    size = len(sums)
    at_once = max(1, _DRAWS_AT_ONCE // size)
    counts = [min(at_once, RESAMPLES - first) for first in range(0, RESAMPLES, at_once)]
    return np.concatenate([rng.multinomial(size, np.full(size, 1 / size), count) @ sums for count in counts])


def _interval(sums: Floats, drawn: Floats) -> tuple[float, float, float]:
    """A mean and its interval, from sums and numbers by cluster ``[M, 2]`` and as they were drawn ``[RESAMPLES, 2]``."""
    size = len(sums)
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = float(np.nanstd(drawn[:, 0] / drawn[:, 1]))
    mean = float(sums[:, 0].sum() / max(1.0, sums[:, 1].sum()))
    error = spread * math.sqrt(size / (size - 1)) * float(stats.t.ppf((1 + LEVEL) / 2, size - 1))
    return mean, mean - error, mean + error
