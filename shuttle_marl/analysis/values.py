"""Value added: the probability of winning the rally before and after every stroke, and players ranked by it.

In the way of Decroos, Bransen, Van Haaren & Davis, "Actions Speak Louder than Goals: Valuing Player Actions in Soccer", KDD
2019; but the value of a state is not learned, it is computed exactly from the game.
"""

import dataclasses
import math
from typing import Final

import numpy as np
import pyarrow as pa
from scipy import stats

from shuttle_marl.analysis.summary import AnalysisError
from shuttle_marl.arrays import F64, I64, Intp
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import Rows, rows_from_strokes, states_of, strokes_before
from shuttle_marl.exact import evaluate, visits
from shuttle_marl.game import rules
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, Catalogue
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy

COLUMNS: Final = ("win_before", "win_after", "value_added", "decision", "execution")
"""Columns that :func:`add_values` adds."""
_UNKNOWN: Final = -1

LEAST_MATCHES: Final = 3
LEAST_STROKES: Final = 200
RESAMPLES: Final = 2000
LEVEL: Final = 0.95
_DRAWS_AT_ONCE: Final = 1 << 22
"""So many numbers of a bootstrap are held at once."""


def add_values(strokes: pa.Table, reference: TabulatedPolicy) -> pa.Table:
    """Add to every stroke what it was worth if both players played on like the reference.

    ``win_before`` is the striker's probability of winning the rally when the shuttle comes, ``win_after`` that after the stroke:
    1 for a winner, 0 for a fault, and for a returned stroke what is left against the reply that the opponent makes next, not the
    stroke they choose but the contact that they reach. ``value_added`` is the difference, from -1 to 1; over a rally the
    server's minus the receiver's add up to the outcome minus the probability at the serve. ``decision`` is the part that
    follows from the choice (the stroke's mean value before it is struck, above that of the reference's choice), ``execution``
    the rest: skill and luck. The target of a fault is not recorded; its decision is the mean over the targets of the
    same shot type and technique, weighted by how likely the reference aims and faults there.

    Strokes that are not in the game's catalogue count as the nearest one (same shot type and contact, then same technique,
    then the nearest area), and states that the game does not know as the mean over the striker's own last stroke. Values of
    strokes whose context was not recorded are null.

    Args:
        strokes: of schema :data:`shuttle_marl.data.schema.STROKES`, rallies in order.
        reference: whose play the values assume, on the game that is used.

    Returns:
        The table with float64 columns :data:`COLUMNS`.
    """
    game = reference.game
    rows = rows_from_strokes(strokes)
    nearest = _nearest(game.catalogue)
    own, incoming = (strokes_before(rows, name, nearest, game.n_strokes) for name in ("own", "incoming"))
    contact = rows.codes["contact"].astype(np.int64)
    state = states_of(game, rows, own, incoming)
    value = evaluate(reference, reference).striking[0]
    # Where the own last stroke is unknown or cannot have led here, the mean over those that can.
    mean = _means_over_own(game, reference, value)
    before = (1 + np.where(state >= 0, value[state], mean[incoming, contact])) / 2
    before[incoming == _UNKNOWN] = np.nan
    after = np.full(len(rows), np.nan)
    after[rows.outcome == Outcome.FAULT], after[rows.outcome == Outcome.WINNER] = 0.0, 1.0
    goes_on = np.flatnonzero((rows.outcome == Outcome.RETURNED) & (rows.next_contact >= 0))
    after[goes_on] = 1 - before[goes_on + 1]
    decision = _decisions(reference, rows, state, nearest, value)
    columns = {
        "win_before": before,
        "win_after": after,
        "value_added": after - before,
        "decision": decision,
        "execution": after - before - decision,
    }
    for name, column in columns.items():
        strokes = strokes.append_column(name, pa.array(column, pa.float64(), from_pandas=True))
    return strokes


def _nearest(catalogue: Catalogue) -> I64:
    """``[13, 9, 2, 3]`` catalogue index of every combination or of the one nearest to it, -1 where the shot type has none."""
    exact = catalogue.by_parts.astype(np.int64)
    area, technique = np.arange(N_AREAS), np.arange(N_TECHNIQUES)
    between_areas = np.abs(area[:, None] // 3 - area // 3) + np.abs(area[:, None] % 3 - area % 3)
    distance = 10 * (technique[:, None] != technique)[None, :, None, :] + between_areas[:, None, :, None]
    distance = distance.reshape(N_AREAS * N_TECHNIQUES, N_AREAS * N_TECHNIQUES)
    found = exact.copy()
    for shot in range(N_SHOTS):
        for height in range(2):
            there = exact[shot, :, height].reshape(-1)
            if (there >= 0).any():
                best = np.where(there >= 0, distance, distance.max() + 1).argmin(axis=1)
                found[shot, :, height] = there[best].reshape(N_AREAS, N_TECHNIQUES)
    return found


def _means_over_own(game: Game, reference: TabulatedPolicy, value: F64) -> F64:
    """``[n + 1, 2]`` mean value against each incoming stroke by contact, states weighted by how often they are visited."""
    seen = visits(reference, reference).states[0] + 1e-12
    state = np.arange(game.n_states)
    at = 2 * game.incoming(state).astype(np.int64) + game.contact(state)
    size = 2 * (game.n_strokes + 1)
    total = np.bincount(at, seen, size)
    with np.errstate(invalid="ignore"):
        return np.asarray((np.bincount(at, seen * value, size) / total).reshape(-1, 2))


def _decisions(reference: TabulatedPolicy, rows: Rows, state: I64, nearest: I64, value: F64) -> F64:
    """``[N]`` probability of winning that a choice adds to that of the reference's choice, NaN where it is unknown."""
    game = reference.game
    shot, area, technique = (rows.codes[part].astype(np.int64) for part in ("shot", "area", "technique"))
    stroke = np.where(area >= 0, nearest[shot, area, game.contact(state), technique], _UNKNOWN)
    pair = np.where((state >= 0) & (stroke >= 0), game.pair(state, stroke), -1)
    legal = (pair >= 0) & (rows.outcome != Outcome.FAULT)
    found = np.full(len(rows), np.nan)
    found[legal] = game.stroke_values(value, pair[legal])
    # A fault came down where it was not aimed: the mean over the targets.
    fault = np.flatnonzero((state >= 0) & (rows.outcome == Outcome.FAULT))
    row, pairs = game.pairs(state[fault])
    aimed = game.base_pair_stroke[pairs % game.n_base_pairs]
    alike = (game.catalogue.shot[aimed] == shot[fault][row]) & (game.catalogue.technique[aimed] == technique[fault][row])
    row, pairs = row[alike], pairs[alike]
    weight = reference.probability_of(pairs) * game.outcome_probabilities(pairs)[:, rules.FAULT]
    total = np.bincount(row, weight, len(fault))
    with np.errstate(invalid="ignore"):
        found[fault] = np.bincount(row, weight * game.stroke_values(value, pairs), len(fault)) / total
    return np.asarray((found - value[state]) / 2)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlayerValue:
    """Value added by the strokes of a player.

    Attributes:
        player: identifier.
        discipline: MS or WS.
        matches, strokes: how many went in; strokes whose value is not known are left out.
        value: probability of winning the rally that a stroke added, mean.
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
        AnalysisError: no one has played as much.
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


def _sums(values: F64, cluster: Intp) -> tuple[F64, F64]:
    """``[M]`` each: sum and number of the values that are known, by cluster."""
    known = np.isfinite(values)
    size = int(cluster.max()) + 1
    total, count = np.bincount(cluster[known], values[known], size), np.bincount(cluster[known], minlength=size)
    return np.asarray(total, dtype=np.float64), count.astype(np.float64)


def _resampled(sums: F64, rng: np.random.Generator) -> F64:
    """``[RESAMPLES, 4]`` sums when M clusters ``[M, 4]`` are drawn with replacement."""
    size = len(sums)
    at_once = max(1, _DRAWS_AT_ONCE // size)
    counts = [min(at_once, RESAMPLES - first) for first in range(0, RESAMPLES, at_once)]
    return np.concatenate([rng.multinomial(size, np.full(size, 1 / size), count) @ sums for count in counts])


def _interval(sums: F64, drawn: F64) -> tuple[float, float, float]:
    """A mean and its interval, from sums and numbers by cluster ``[M, 2]`` and as they were drawn ``[RESAMPLES, 2]``."""
    size = len(sums)
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = float(np.nanstd(drawn[:, 0] / drawn[:, 1]))
    mean = float(sums[:, 0].sum() / max(1.0, sums[:, 1].sum()))
    error = spread * math.sqrt(size / (size - 1)) * float(stats.t.ppf((1 + LEVEL) / 2, size - 1))
    return mean, mean - error, mean + error
