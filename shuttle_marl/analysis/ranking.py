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
        rng = np.random.default_rng([seed, number])
        drawn = rng.multinomial(len(matches), np.full(len(matches), 1 / len(matches)), RESAMPLES)
        mean, low, high = _interval(value[mine], cluster, drawn)
        chosen, chosen_low, chosen_high = _interval(decision[mine], cluster, drawn)
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


def _interval(values: Floats, cluster: npt.NDArray[np.intp], drawn: npt.NDArray[np.int64]) -> tuple[float, float, float]:
    """Mean of the values that are known, and its interval when clusters are drawn so often each."""
    known = np.isfinite(values)
    size = drawn.shape[1]
    total = np.bincount(cluster[known], values[known], size)
    count = np.bincount(cluster[known], minlength=size)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (drawn @ total) / (drawn @ count)
    mean = float(total.sum() / max(1, count.sum()))
    error = float(np.nanstd(means)) * math.sqrt(size / (size - 1)) * float(stats.t.ppf((1 + LEVEL) / 2, size - 1))
    return mean, mean - error, mean + error
