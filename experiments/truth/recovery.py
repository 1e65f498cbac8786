"""Does what the position of a receiver changes hold in matches to which it was not fitted?

The predictions of the models are compared with those at the place in which the receiver of the real stroke stood: odds
multiplied by the effect of the place, calibrated as in the game with recovery, so that the mean over people's positions is the
prediction of the models.

Strokes that went out, which nobody met, tell where the striker aimed (:func:`aims`). If positions are hidden, the side to which a
stroke is aimed does not depend on where the receiver stands, given the state.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from experiments.truth.matches import RESAMPLES, Strokes, folds_of, ratio_by_match
from experiments.truth.worlds import World
from shuttle_marl.base.arrays import F64, I32, I64, Bools, Ints
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.dynamics.features import DISCIPLINES, MOVEMENT, Rows
from shuttle_marl.dynamics.fit import unseen_predictions
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.models import EnsembleConfig, log_odds, sigmoid, was_good, was_met, was_timed
from shuttle_marl.dynamics.recovery import GROUPS, FittedRecovery, fit_recovery, people_at, placed
from shuttle_marl.game.court import FOREHAND, N_AREAS, N_SIDES, mirrored
from shuttle_marl.game.recovery import EFFECTS, STEP
from shuttle_marl.game.stroke import N_SERVES, SHOTS

_ROUNDS: Final = 12
_AIM_ROUNDS: Final = 10


class Judged(NamedTuple):
    """N strokes of one of the :data:`~shuttle_marl.game.recovery.EFFECTS`."""

    match: I32
    logit: F64
    """``[N]`` prediction of the models."""
    shift: F64
    """``[N]`` by how much the receiver's position moves it."""
    label: Bools
    """``[N]`` whether it happened."""

    def of(self, which: Bools) -> "Judged":
        """Some of the strokes."""
        return Judged(self.match[which], self.logit[which], self.shift[which], self.label[which])

    @classmethod
    def joined(cls, parts: Sequence["Judged"]) -> "Judged":
        """Several lists of strokes as one."""
        match, logit, shift, label = zip(*parts, strict=True)
        return cls(np.concatenate(match), np.concatenate(logit), np.concatenate(shift), np.concatenate(label))


def recovery_effects(parts: Sequence[tuple[World, Strokes]], seed: int = 0) -> dict[str, dict[str, float]] | None:
    """What the effects of positions are worth on strokes after the serve.

    Args:
        parts: worlds, each with matches that it was not fitted to.
        seed: of the bootstrap over matches.

    Returns:
        For each of :data:`~shuttle_marl.game.recovery.EFFECTS` the change of the log-loss (``log_loss_change``, nats a stroke,
        negative: better) with its 95 % interval ``low`` to ``high``, the coefficient of a logistic regression on the effect
        (``slope``, 1 in a correct game; ``slope_low`` to ``slope_high``), and the number of ``strokes``; without those of which
        nothing is known. None if a world knows no positions.
    """
    found: list[list[Judged]] = [[] for _ in EFFECTS]
    before = 0
    for world, strokes in parts:
        if world.recovery is None or world.models is None:
            return None
        for judged, effect in zip(found, judged_by(world.models, world.recovery, strokes.rows), strict=True):
            judged.append(effect._replace(match=effect.match + np.int32(before)))
        before += len(strokes.rows.matches)
    joined = map(Judged.joined, found)
    return {name: summary(judged, seed) for name, judged in zip(EFFECTS, joined, strict=True) if len(judged.label)}


def cross_judged(models: FittedModels, strokes: Strokes, count: int, seed: int = 0) -> list[Judged]:
    """:func:`judged_at` for each part of the matches of a fit, with effects fitted to the others.

    Args:
        models: of the fit; its predictions are those of models that were not fitted to a match.
        count: number of parts.
        seed: of the parts.
    """
    rows, fold = strokes.rows, folds_of(strokes, count, seed)
    predicted = unseen_predictions(models, rows, EnsembleConfig().folds)
    masks = {"return": was_good(rows), "contact": was_met(rows), "hurried": was_timed(rows)}
    logits, parts = np.full((len(masks), len(rows)), np.nan), []
    for line, (name, mask) in zip(logits, masks.items(), strict=True):
        line[mask] = predicted[name].logit
    logits[0] *= -1  # a winner is no return
    for k in range(count):
        inside = fold == k
        fitted = fit_recovery(rows.take(~inside), {name: predicted[name].take(~inside[mask]) for name, mask in masks.items()})
        if fitted is None:
            raise ShuttleError(f"{count} parts of {len(rows)} strokes: too few with the position of the receiver")
        parts.append(judged_at(fitted, rows.take(inside), logits[:, inside]))
    return [Judged.joined(of) for of in zip(*parts, strict=True)]


def by_discipline(judged: Sequence[Judged], rows: Rows) -> dict[str, dict[str, dict[str, float]]]:
    """:func:`summary` of each of :data:`~shuttle_marl.game.recovery.EFFECTS`, in each discipline.

    Args:
        judged: strokes by effect.
        rows: of all matches.
    """
    kind = np.zeros(len(rows.matches), np.int64)
    kind[rows.match] = rows.codes["discipline"]
    return {
        name: {effect: summary(of.of(kind[of.match] == i)) for effect, of in zip(EFFECTS, judged, strict=True)}
        for i, name in enumerate(DISCIPLINES)
    }


def judged_by(models: FittedModels, fitted: FittedRecovery, rows: Rows) -> tuple[Judged, ...]:
    """:func:`judged_at` for the predictions of models."""
    rows = rows.take(was_good(rows))
    codes = rows.codes
    late = models.hurried(codes)[np.arange(len(rows)), np.maximum(rows.next_contact, 0)]
    logits = [log_odds(1 - models.returned(codes)), log_odds(models.above(codes)), np.where(late > 0, log_odds(late), np.nan)]
    return judged_at(fitted, rows, np.stack(logits))


def judged_at(fitted: FittedRecovery, rows: Rows, logits: F64) -> tuple[Judged, ...]:
    """Strokes whose receiver waited at a known position, by effect.

    Args:
        logits: ``[3, N]`` predicted log-odds of the effects without the position; NaN where they are not known.
    """
    known, people = people_at(fitted.recovery, rows)
    used = known & placed(rows) & was_good(rows) & (rows.codes["shot"] >= N_SERVES)
    rows, people, logits = rows.take(used), people[used[known]], logits[:, used]
    shot, area = (rows.game_codes[name].astype(np.int64) for name in ("shot", "area"))
    effect = fitted.recovery.effect[:, shot, area] * STEP
    there = fitted.shift(shot, area, rows.waiting.astype(np.float64))
    winner = _spread(logits[0], effect[0], people)
    met = people * (1 - sigmoid(winner))
    above = _spread(logits[1], effect[1], met)
    from_there = np.where((rows.next_contact == 1)[:, None], sigmoid(above), 1 - sigmoid(above))
    spread = (winner, above, _spread(logits[2], effect[2], met * from_there))
    masks = (np.ones(len(rows), dtype=np.bool_), was_met(rows), was_timed(rows) & np.isfinite(logits[2]))
    labels = (rows.outcome == Outcome.WINNER, rows.next_contact == 1, rows.next_hurried == 1)
    return tuple(
        Judged(rows.match, logit, at[:, 0] - by_position[:, 0] + by_place - logit, label).of(mask)
        for logit, at, by_position, by_place, label, mask in zip(logits, spread, effect, there, labels, masks, strict=True)
    )


def _spread(logit: F64, effect: F64, weight: F64) -> F64:
    """``[N, 9]`` log-odds that differ by effects, and whose weighted mean probability is that of a logit ``[N]``."""
    share = weight / weight.sum(axis=1, keepdims=True)
    base = logit.copy()
    for _ in range(_ROUNDS):
        base += logit - log_odds((share * sigmoid(base[:, None] + effect)).sum(axis=1))
    return base[:, None] + effect


def summary(judged: Judged, seed: int = 0) -> dict[str, float]:
    """What an effect is worth, for each of :data:`~shuttle_marl.game.recovery.EFFECTS` in :func:`recovery_effects`."""
    match, logit, shift, label = judged
    loss = ratio_by_match(_losses(logit + shift, label) - _losses(logit, label), np.ones(len(label)), match, seed)
    slope = 0.0
    for _ in range(_ROUNDS):
        p = sigmoid(logit + slope * shift)
        score, information = (label - p) * shift, p * (1 - p) * shift * shift
        slope += float(score.sum() / information.sum())
    # One step from the estimate instead of a regression for each resample.
    line = ratio_by_match(score + slope * information, information, match, seed)
    return {
        "log_loss_change": loss["value"],
        "low": loss["low"],
        "high": loss["high"],
        "slope": slope,
        "slope_low": line["low"],
        "slope_high": line["high"],
        "strokes": len(label),
    }


def _losses(logit: F64, label: Bools) -> F64:
    return np.asarray(np.logaddexp(0, np.where(label, -logit, logit)))


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
    for _ in range(_AIM_ROUNDS):
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
