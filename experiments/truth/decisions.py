"""Are the advantages of chosen strokes realised in the outcomes of rallies?

The predicted advantage of a stroke in state s is A = E[Q(s, a)] - V(s) of its shot type and technique, averaged over the areas
that the average player chooses, because the target of a fault is unknown; V and Q are the exact values if both continue as the
average player. The outcome after h strokes is V of the state reached, with its sign, or +1 or -1 if the rally has ended. The
**decision slope** is the least-squares slope of (outcome - V(s)) on A with a constant for every player in every match, so it does
not measure skill. In a correct game it is 1 at every h.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from experiments.truth.matches import Strokes, ratio_by_match, states_of
from shuttle_marl.arrays import F64, Bools, Ints
from shuttle_marl.exact import evaluate
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tabulated import TabulatedPolicy

HORIZONS: Final = (1, 4, 8)
"""Strokes after which the promise is compared with what happened, beside the end of the rally."""
LEAST_STROKES: Final = 50
"""Errors of shot types with fewer strokes are not reported."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Promises:
    """Promises of a game for N real strokes; NaN where it knows no such state or stroke.

    Attributes:
        value: ``[N]`` V(s), from -1 to 1.
        advantage: ``[N]`` advantage of the chosen shot type and technique over V(s).
    """

    value: F64
    advantage: F64

    @classmethod
    def joined(cls, parts: Sequence["Promises"]) -> "Promises":
        """Promises of several lists of strokes, as of one list."""
        return cls(value=np.concatenate([p.value for p in parts]), advantage=np.concatenate([p.advantage for p in parts]))


def promises(bc: TabulatedPolicy, strokes: Strokes) -> Promises:
    """Promises of the game of ``bc`` for each stroke, if both players continue as ``bc``."""
    value = evaluate(bc, bc).striking[0]
    state = states_of(bc.game, strokes.rows)
    known = np.where(state >= 0, value[np.maximum(state, 0)], np.nan)
    return Promises(value=known, advantage=worth(bc, strokes, value) - known)


def worth(bc: TabulatedPolicy, strokes: Strokes, following: F64) -> F64:
    """``[N]`` expected value of each stroke's shot type and technique to the striker, with the area that ``bc`` would choose.

    Args:
        bc: on the game that is played.
        strokes: N strokes.
        following: ``[S]`` value of the next states to the receiver.
    """
    game = bc.game
    state = states_of(game, strokes.rows)
    known = state >= 0
    shot, technique = (strokes.rows.codes[part][known] for part in ("shot", "technique"))
    row, pairs = game.pairs(state[known])
    aimed = game.base_pair_stroke[pairs % game.n_base_pairs]
    alike = (game.catalogue.shot[aimed] == shot[row]) & (game.catalogue.technique[aimed] == technique[row])
    row, pairs = row[alike], pairs[alike]
    weight = bc.probability_of(pairs)
    total = np.bincount(row, weight, len(shot))
    found = np.full(len(strokes), np.nan)
    with np.errstate(invalid="ignore"):
        found[known] = np.bincount(row, weight * game.stroke_values(following, pairs), len(shot)) / total
    return found


def realised(strokes: Strokes, value: F64, horizon: int | None) -> F64:
    """``[N]`` what happened to the striker within ``horizon`` strokes (None: by the end); NaN where that is not known."""
    ended = np.where(strokes.result != 0, strokes.result.astype(np.float64), np.nan)
    if horizon is None:
        return ended
    row = np.arange(len(strokes))
    later = np.minimum(row + horizon, len(strokes) - 1)
    same = (strokes.rally[later] == strokes.rally) & (strokes.number[later] - strokes.number == horizon)
    reached = np.where(same, value[later] * (1 if horizon % 2 == 0 else -1), np.nan)
    over = strokes.number[strokes.last] - strokes.number < horizon
    return np.where(over, ended, reached)


def decision_slope(strokes: Strokes, promised: Promises) -> dict[str, dict[str, float]]:
    """Slopes after 1, 4 and 8 strokes and at the end of the rally, each with its interval and number of strokes."""
    return {name: slope(strokes, promised, happened) for name, happened in outcomes(strokes, promised)}


def outcomes(strokes: Strokes, promised: Promises) -> list[tuple[str, F64]]:
    """Name of each horizon (1, 4, 8, end), and the outcomes ``[N]`` of the strokes there."""
    return [
        ("end" if horizon is None else str(horizon), realised(strokes, promised.value, horizon)) for horizon in (*HORIZONS, None)
    ]


def slope(strokes: Strokes, promised: Promises, happened: F64) -> dict[str, float]:
    """Slope of ``[N]`` what happened, above V(s), on the advantages, with its interval and number of strokes."""
    x, y, match = centred(strokes, promised, happened)
    return {**ratio_by_match(x * y, x * x, match), "n": len(x)}


def centred(strokes: Strokes, promised: Promises, happened: F64, among: Bools | None = None) -> tuple[F64, F64, Ints]:
    """Regressor, response and match of the strokes of a slope, without the effects of player and match.

    Args:
        strokes: N strokes.
        promised: their promises.
        happened: ``[N]`` outcomes.
        among: ``[N]`` strokes to use; None: all with known promises and outcome.

    Returns:
        ``[M]`` each: advantage, outcome above V(s), match.
    """
    used = np.isfinite(promised.advantage) & np.isfinite(happened) & np.isfinite(promised.value)
    if among is not None:
        used &= among
    match = strokes.rows.match[used]
    player = np.unique(strokes.rows.striker, return_inverse=True)[1][used]
    group = np.unique(match.astype(np.int64) * (player.max(initial=0) + 1) + player, return_inverse=True)[1]

    def without_mean(x: F64) -> F64:
        return np.asarray(x - (np.bincount(group, x) / np.bincount(group))[group])

    return without_mean(promised.advantage[used]), without_mean((happened - promised.value)[used]), match


def value_error(strokes: Strokes, promised: Promises) -> dict[str, dict[str, dict[str, float]]]:
    """Points (per cent of rallies) won more than V says, by the striker's own last shot type and by the incoming one."""
    used = np.isfinite(promised.value) & (strokes.result != 0)
    error = 50 * (strokes.result - promised.value)
    out: dict[str, dict[str, dict[str, float]]] = {}
    for i, shot in enumerate(SHOTS):
        for role in ("own", "incoming"):
            chosen = used & (strokes.rows.codes[f"{role}_shot"] == i)
            if chosen.sum() >= LEAST_STROKES:
                out.setdefault(shot, {})[role] = _points(error[chosen], strokes.rows.match[chosen])
    return out


def promised_realised(strokes: Strokes, promised: Promises) -> dict[str, dict[str, Any]]:
    """Points predicted above V of the state by choosing each shot type, and points realised by the end of the rally."""
    used = np.isfinite(promised.advantage) & (strokes.result != 0)
    out: dict[str, dict[str, Any]] = {}
    for i, shot in enumerate(SHOTS):
        chosen = used & (strokes.rows.codes["shot"] == i)
        if chosen.sum() >= LEAST_STROKES:
            brought = _points(50 * (strokes.result - promised.value)[chosen], strokes.rows.match[chosen])
            out[shot] = {"promised": float(50 * promised.advantage[chosen].mean()), "realised": brought}
    return out


def _points(error: F64, match: Ints) -> dict[str, float]:
    found = ratio_by_match(error, np.ones(len(error)), match)
    return {"points": found["value"], "low": found["low"], "high": found["high"], "n": len(error)}


def value_log_losses(strokes: Strokes, promised: Promises) -> F64:
    """``[N]`` log-loss in nats of V as a forecast of who wins the rally, NaN where one is unknown; that of a coin is 0.6931."""
    p = np.where(strokes.result != 0, (1 + promised.value * strokes.result) / 2, np.nan)
    return np.asarray(-np.log(np.clip(p, 1e-9, 1)))


def value_log_loss(strokes: Strokes, promised: Promises) -> float:
    """Mean of :func:`value_log_losses`."""
    return float(np.nanmean(value_log_losses(strokes, promised)))
