"""Does what the position of a receiver changes hold in matches to which it was not fitted?

The predictions of the models are compared with those at the place in which the receiver of the real stroke stood: odds
multiplied by the effect of the place, calibrated as in the game with recovery, so that the mean over people's positions is the
prediction of the models.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from experiments.truth.matches import Strokes, ratio_by_match
from experiments.truth.worlds import World
from shuttle_marl.base.arrays import F64, I32, Bools
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.models import log_odds, sigmoid, was_good, was_met, was_timed
from shuttle_marl.dynamics.recovery import FittedRecovery, people_at, placed
from shuttle_marl.game.recovery import EFFECTS, STEP
from shuttle_marl.game.stroke import N_SERVES

_ROUNDS: Final = 12


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


def judged_by(models: FittedModels, fitted: FittedRecovery, rows: Rows) -> tuple[Judged, ...]:
    """Strokes whose receiver waited at a known position, by effect."""
    known, people = people_at(fitted.recovery, rows)
    used = known & placed(rows) & was_good(rows) & (rows.codes["shot"] >= N_SERVES)
    rows, people = rows.take(used), people[used[known]]
    late = models.hurried(rows.codes)[np.arange(len(rows)), np.maximum(rows.next_contact, 0)]
    late = np.where(late > 0, log_odds(late), np.nan)
    logits = log_odds(1 - models.returned(rows.codes)), log_odds(models.above(rows.codes)), late
    shot, area = (rows.game_codes[name].astype(np.int64) for name in ("shot", "area"))
    effect = fitted.recovery.effect[:, shot, area] * STEP
    there = fitted.shift(shot, area, rows.waiting.astype(np.float64))
    winner = _spread(logits[0], effect[0], people)
    met = people * (1 - sigmoid(winner))
    above = _spread(logits[1], effect[1], met)
    from_there = np.where((rows.next_contact == 1)[:, None], sigmoid(above), 1 - sigmoid(above))
    spread = (winner, above, _spread(late, effect[2], met * from_there))
    masks = (np.ones(len(rows), dtype=np.bool_), was_met(rows), was_timed(rows) & np.isfinite(late))
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
