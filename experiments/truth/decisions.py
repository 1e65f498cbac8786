"""Are the advantages of chosen strokes realised in the outcomes of rallies?

The predicted advantage of a stroke in state s is A = E[Q(s, a)] - V(s) of its shot type and technique, averaged over the areas
that the average player chooses, because the target of a fault is unknown; V and Q are the exact values if both continue as the
average player. The outcome after h strokes is V of the state reached, with its sign, or +1 or -1 if the rally has ended. The
**decision slope** is the least-squares slope of (outcome - V(s)) on A with a constant for every player in every match, so it does
not measure skill. In a correct game it is 1 at every h.

The **factor** of a horizon is the decision slope on training matches: how much of a predicted advantage is realised. A calibrated
advantage is the predicted advantage times the factor; its slope on other matches is 1 in expectation.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from experiments.truth.matches import RESAMPLES, Strokes, ratio_by_match, states_of
from shuttle_marl.base.arrays import F64, I64, Bools, Ints
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.evaluate import calibration_error
from shuttle_marl.exact import evaluate
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.shipped import Estimate
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.reports.value import strokes_before

HORIZONS: Final = (1, 4, 8)  # strokes after which the promise is compared with what happened, beside the end of the rally
LAGS: Final = (1, 2, 4, 6, 8)  # strokes ago of the advantages whose memory is measured
_DRAWS: Final = 200
LEAST_STROKES: Final = 50  # errors of shot types with fewer strokes are not reported


@dataclasses.dataclass(frozen=True, eq=False)
class Promises:
    """Promises of a game for N real strokes; NaN where it knows no such state or stroke."""

    value: F64  # [N] V(s), from -1 to 1
    advantage: F64  # [N] advantage of the chosen shot type and technique over V(s)
    fault: F64  # [N] probability that the stroke is a fault, averaged like the advantage over the areas that `bc` chooses
    returned: F64  # [N] probability that the stroke, to its recorded area, is returned if it is good
    above: F64  # [N] probability that the stroke, to its recorded area, is met above the net if it is returned
    hurried: F64  # [N] probability that the receiver is hurried, given the recorded height of the return

    @classmethod
    def joined(cls, parts: Sequence["Promises"]) -> "Promises":
        """Promises of several lists of strokes, as of one list."""
        names = [field.name for field in dataclasses.fields(cls)]
        return cls(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})


def promises(bc: TabulatedPolicy, strokes: Strokes) -> Promises:
    """Promises of the game of ``bc`` for each stroke, if both players continue as ``bc``."""
    value = evaluate(bc, bc).striking[0]
    state = states_of(bc.game, strokes.rows)
    known = np.where(state >= 0, value[np.maximum(state, 0)], np.nan)
    good, returned, above = bc.game.stroke_probabilities()
    hurried = [_mean(bc, strokes, lambda pairs, c=c: bc.game.hurry_of(pairs)[:, c], aimed=True) for c in (0, 1)]  # type: ignore[misc]
    return Promises(
        value=known,
        advantage=worth(bc, strokes, value) - known,
        fault=_mean(bc, strokes, lambda pairs: 1 - good[pairs]),
        returned=_mean(bc, strokes, lambda pairs: returned[pairs], aimed=True),
        above=_mean(bc, strokes, lambda pairs: above[pairs], aimed=True),
        hurried=np.where(strokes.rows.next_contact == 1, hurried[1], hurried[0]),
    )


def worth(bc: TabulatedPolicy, strokes: Strokes, following: F64) -> F64:
    """``[N]`` expected value of each stroke's shot type and technique to the striker, with the area that ``bc`` would choose.

    Args:
        bc: on the game that is played.
        strokes: N strokes.
        following: ``[S]`` value of the next states to the receiver.
    """
    return _mean(bc, strokes, lambda pairs: bc.game.stroke_values(following, pairs))


def _mean(bc: TabulatedPolicy, strokes: Strokes, of: Callable[[I64], F64], *, aimed: bool = False) -> F64:
    """``[N]`` mean of a figure of legal pairs over the strokes of each one's shot type and technique, as ``bc`` chooses.

    Args:
        bc: on the game that is played.
        strokes: N strokes.
        of: from legal pairs to their figures.
        aimed: over the strokes to the recorded area alone.
    """
    game = bc.game
    state = states_of(game, strokes.rows)
    known = state >= 0
    area = strokes.rows.game_codes["area"][known]
    shot, technique = (strokes.rows.codes[part][known] for part in ("shot", "technique"))
    row, pairs = game.pairs(state[known])
    stroke = game.base_pair_stroke[pairs % game.n_base_pairs]
    alike = (game.catalogue.shot[stroke] == shot[row]) & (game.catalogue.technique[stroke] == technique[row])
    alike &= (game.catalogue.area[stroke] == area[row]) | (not aimed)
    row, pairs = row[alike], pairs[alike]
    weight = bc.probability_of(pairs)
    total = np.bincount(row, weight, len(shot))
    found = np.full(len(strokes), np.nan)
    with np.errstate(invalid="ignore"):
        found[known] = np.bincount(row, weight * of(pairs), len(shot)) / total
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


def centred(strokes: Strokes, promised: Promises, happened: F64) -> tuple[F64, F64, Ints]:
    """Regressor, response and match of the strokes of a slope, without the effects of player and match.

    Args:
        strokes: N strokes.
        promised: their promises.
        happened: ``[N]`` outcomes.

    Returns:
        ``[M]`` each: advantage, outcome above V(s), match.
    """
    used = np.isfinite(promised.advantage) & np.isfinite(happened) & np.isfinite(promised.value)
    match = strokes.rows.match[used]
    player = np.unique(strokes.rows.striker, return_inverse=True)[1][used]
    group = np.unique(match.astype(np.int64) * (player.max(initial=0) + 1) + player, return_inverse=True)[1]

    def without_mean(x: F64) -> F64:
        return np.asarray(x - (np.bincount(group, x) / np.bincount(group))[group])

    return without_mean(promised.advantage[used]), without_mean((happened - promised.value)[used]), match


def value_error(strokes: Strokes, promised: Promises) -> dict[str, dict[str, float]]:
    """Points (per cent of rallies) won more than V says, by the striker's own last shot type."""
    used = np.isfinite(promised.value) & (strokes.result != 0)
    error = 50 * (strokes.result - promised.value)
    of_shot = {shot: used & (strokes.rows.codes["own_shot"] == i) for i, shot in enumerate(SHOTS)}
    return {
        shot: _points(error[chosen], strokes.rows.match[chosen])
        for shot, chosen in of_shot.items()
        if chosen.sum() >= LEAST_STROKES
    }


def judged_strokes(game: Game, strokes: Strokes) -> tuple[Bools, Bools]:
    """``[N]`` whether the incoming stroke is in the catalogue, and whether the reply is then illegal.

    A reply is illegal if no legal stroke has its shot type, height and technique: the target of a fault is unknown, so the area
    does not count.
    """
    catalogue, rows = game.catalogue, strokes.rows
    incoming = strokes_before(rows, "incoming", catalogue.by_parts, game.n_strokes)
    legal = np.zeros((game.n_strokes + 1, N_SHOTS, 2, N_TECHNIQUES), dtype=bool)
    reply, stroke = np.nonzero(game.reply_mask.any(axis=1))
    legal[reply, catalogue.shot[stroke], catalogue.height[stroke], catalogue.technique[stroke]] = True
    known = incoming >= 0
    style = tuple(rows.codes[name].astype(np.int64) for name in ("shot", "contact", "technique"))
    return known, known & ~legal[(np.maximum(incoming, 0), *style)]


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


def forecast_errors(strokes: Strokes, promised: Promises, seed: int = 0) -> dict[str, dict[str, float]]:
    """Expected calibration errors of the forecasts of a stroke's end.

    Args:
        strokes: N strokes.
        promised: their promises, by games that were fitted without them.
        seed: random seed of the drawn outcomes.

    Returns:
        For each forecast ``ece``, ``strokes``, and what a game without any error would have on as many strokes, by outcomes drawn
        with the promised probabilities: ``chance`` (mean) and ``chance_high`` (95 % quantile).
    """
    rows, rng = strokes.rows, np.random.default_rng(seed)
    good = (rows.outcome == Outcome.RETURNED) | (rows.outcome == Outcome.WINNER)
    met, timed = rows.next_contact >= 0, (rows.next_contact >= 0) & (rows.next_hurried >= 0)
    forecasts = {
        "fault": (promised.fault, rows.outcome == Outcome.FAULT, rows.outcome != Outcome.UNKNOWN),
        "returned": (promised.returned, rows.outcome == Outcome.RETURNED, good),
        "above": (promised.above, rows.next_contact == 1, met),
        "hurried": (promised.hurried, rows.next_hurried == 1, timed),
    }
    out = {}
    for name, (promise, label, known) in forecasts.items():
        used = known & np.isfinite(promise)
        p = promise[used]
        drawn = [calibration_error(rng.random(len(p)) < p, p) for _ in range(_DRAWS)]
        ece = calibration_error(label[used], p)
        high = float(np.quantile(drawn, 0.95))
        out[name] = {"ece": ece, "chance": float(np.mean(drawn)), "chance_high": high, "strokes": len(p)}
    return out


def value_log_loss(strokes: Strokes, promised: Promises) -> float:
    """Mean log-loss in nats of V as a forecast of who wins the rally, where both are known; that of a coin is 0.6931."""
    p = np.where(strokes.result != 0, (1 + promised.value * strokes.result) / 2, np.nan)
    return float(np.nanmean(-np.log(np.clip(p, 1e-9, 1))))


def memory(strokes: Strokes, promised: Promises) -> dict[str, dict[str, float]]:
    """Slopes of (result of the rally - V of the state now) on the advantage of an earlier stroke, for all of :data:`LAGS`.

    Advantages of the opponent count with the opposite sign. Effects of player and match are removed.
    """
    ended = realised(strokes, promised.value, None)
    return {
        str(lag): slope(strokes, dataclasses.replace(promised, advantage=_ago(strokes, promised.advantage, lag)), ended)
        for lag in LAGS
    }


def _ago(strokes: Strokes, advantage: F64, lag: int) -> F64:
    """``[N]`` advantage of the stroke ``lag`` strokes ago to the one who strikes now; NaN where there is none."""
    earlier = np.maximum(np.arange(len(strokes)) - lag, 0)
    same = (strokes.rally[earlier] == strokes.rally) & (strokes.number - strokes.number[earlier] == lag)
    return np.where(same, advantage[earlier] * (1 if lag % 2 == 0 else -1), np.nan)


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
        slope, factor = _calibrated_slope(sums, member, everyone, everyone, known)
        low, high = np.nanquantile(_calibrated_slope(sums, member, fitting, checking, known)[0], [0.025, 0.975])
        out[name] = {"slope": float(slope[0]), "low": float(low), "high": float(high), "factor": float(factor[0])}
    return out


def _calibrated_slope(sums: F64, member: Bools, fitting: I64, checking: I64, factor: float | None) -> tuple[F64, F64]:
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
