"""The chance to win the rally before and after every stroke, and so the value that the stroke added.

In the way of Decroos, Bransen, Van Haaren & Davis, "Actions Speak Louder than Goals: Valuing Player Actions in Soccer", KDD
2019; but the value of a state is not learned, it is computed exactly from the game.
"""

from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.exact import evaluate, visits
from shuttle_marl.exact.sweeps import stroke_values
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.rally import ONE, ROOT, Game
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, Catalogue
from shuttle_marl.game.table import TabulatedPolicy

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

COLUMNS: Final = ("win_before", "win_after", "value_added", "decision", "execution")
"""What :func:`add_values` adds."""
_UNKNOWN: Final = -1


def add_values(strokes: pa.Table, reference: TabulatedPolicy) -> pa.Table:
    """Add to every stroke what it was worth if both players played on like the reference.

    ``win_before`` is the striker's chance to win the rally when the shuttle comes, ``win_after`` that after the stroke: 1 for a
    winner, 0 for a fault, and for a returned stroke what is left against the reply that the opponent makes next, not the
    stroke they choose but the contact that they reach. ``value_added`` is the difference, in chances from -1 to 1; over a
    rally the server's minus the receiver's add up to the outcome minus the chance at the serve. ``decision`` is the part that
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
    own, incoming = (_stroke_before(rows, name, nearest, game) for name in ("own", "incoming"))
    contact = rows.codes["contact"].astype(np.int64)
    state = _states(game, own, incoming, contact)
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


def _nearest(catalogue: Catalogue) -> Ints:
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


def _stroke_before(rows: Rows, name: str, nearest: Ints, game: Game) -> Ints:
    """``[N]`` catalogue index of a stroke before: n for none yet, -1 where it is not known."""
    shot, area, height, technique = (
        rows.codes[f"{name}_{part}"].astype(np.int64) for part in ("shot", "area", "height", "technique")
    )
    none = shot == N_SHOTS
    known = (shot < N_SHOTS) & (area < N_AREAS) & (height < 2) & (technique < N_TECHNIQUES)
    found = np.where(none, game.n_strokes, _UNKNOWN)
    found[known] = nearest[shot[known], area[known], height[known], technique[known]]
    return found


def _states(game: Game, own: Ints, incoming: Ints, contact: Ints) -> Ints:
    """``[N]`` state of each striker, -1 where the game has none such."""
    n, height = game.n_strokes, np.append(game.catalogue.height, 0).astype(np.int64)
    struck = np.clip(incoming, 0, n - 1)
    rank = game.reply_rank[own, height[struck], struck].astype(np.int64)
    edge = game.reply_start[own, height[struck]] + rank
    known = (own >= 0) & (incoming >= 0) & (incoming < n) & (rank >= 0)
    return np.where(incoming == n, ROOT, np.where(known, 2 * edge + contact, _UNKNOWN))


def _means_over_own(game: Game, reference: TabulatedPolicy, value: Floats) -> Floats:
    """``[n + 1, 2]`` mean value against each incoming stroke by contact, states weighted by how often they are visited."""
    seen = visits(reference, reference).states[0] + 1e-12
    state = np.arange(game.n_states)
    at = 2 * game.edge_incoming[state >> 1].astype(np.int64) + (state & 1)
    size = 2 * (game.n_strokes + 1)
    total = np.bincount(at, seen, size)
    with np.errstate(invalid="ignore"):
        return np.asarray((np.bincount(at, seen * value, size) / total).reshape(-1, 2))


def _decisions(reference: TabulatedPolicy, rows: Rows, state: Ints, nearest: Ints, value: Floats) -> Floats:
    """``[N]`` chance to win that the choice of the stroke adds to that of the reference's choice, NaN where it is unknown."""
    game = reference.game
    quality = stroke_values(game, value)
    shot, area, technique = (rows.codes[part].astype(np.int64) for part in ("shot", "area", "technique"))
    contact = state & 1
    stroke = np.where(area >= 0, nearest[shot, area, contact, technique], _UNKNOWN)
    incoming = game.edge_incoming[state >> 1].astype(np.int64)
    k = np.where(stroke >= 0, game.reply_rank[incoming, contact, stroke].astype(np.int64), _UNKNOWN)
    legal = (state >= 0) & (k >= 0) & (rows.outcome != Outcome.FAULT)
    found = np.full(len(rows), np.nan)
    found[legal] = quality[game.pair_start[state[legal]] + k[legal]]
    # A fault came down where it was not aimed: the mean over the targets.
    kinds = N_SHOTS * N_TECHNIQUES
    strokes = game.pair_stroke
    kind = N_TECHNIQUES * game.catalogue.shot[strokes].astype(np.int64) + game.catalogue.technique[strokes]
    key = kinds * game.pair_state.astype(np.int64) + kind
    weight = reference.pair_probabilities() * game.threshold[:, 0] / ONE
    total = np.bincount(key, weight, kinds * game.n_states)
    with np.errstate(invalid="ignore"):
        expected = np.bincount(key, weight * quality, kinds * game.n_states) / total
    fault = (state >= 0) & (rows.outcome == Outcome.FAULT)
    found[fault] = expected[kinds * state[fault] + (N_TECHNIQUES * shot + technique)[fault]]
    return np.asarray((found - value[state]) / 2)
