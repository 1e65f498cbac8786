"""Effort and duels: effects of earlier strokes of the rally on the probability of a fault.

Players fault more after many attacks, and at net shots after three or more consecutive net shots. Both effects are offsets of
the networks' log-odds, fitted together with their calibration to out-of-fold predictions:

- **effort**: number of previous attacks (smashes, half-smashes) of the striker in the rally, capped at :data:`LEVELS` - 1, with
  a linear effect. In out-of-fold likelihood on the training matches, given whether the striker is hurried, one level (any attack)
  gains 5.0 nats [-1.7, 11.8] over none, and a second one 1.4 [-1.6, 4.7] more, which is not worth half of the states; the
  opponent's attacks have no effect.
- **duel**: whether the stroke is a net shot after :data:`LONG_DUEL` or more consecutive net shots.

Rows whose number of attacks or net shots is unknown, because a row was dropped, are left out of the fit. Their probability is
the mean over the possible situations, weighted by frequencies in the training strokes with the same previous shot type of the
striker.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from shuttle_marl.base.arrays import F64, I16, I64, Ints
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import NET_SHOT, SLOTS, Rows

LEVELS: Final = 2
"""Levels of effort."""
LONG_DUEL: Final = 3
"""Minimum number of consecutive net shots before a stroke in a long duel."""
_PRIOR_STROKES: Final = 20.0
"""Weight of the mean over shot types in a frequency of hurried strikers, in strokes."""
_PRECISION: Final = 4.0
"""Precision of the normal prior of an offset of the log-odds; its standard deviation is 0.5."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Situations:
    """Offsets of the log-odds of a fault, and frequencies of the situations.

    A situation is a level of effort and whether the stroke is a net shot in a long duel. The calibrated probabilities of the
    networks are those at effort 0 outside of long duels.

    Attributes:
        effort: ``[L]`` offset of each level of effort; the first is 0.
        duel: offset of a net shot in a long duel.
        effort_share: ``[15, L]`` frequency of each level, by code of the striker's previous shot type (``own_shot``).
        duel_share: frequency of long duels among the net shots after two net shots.
        hurried_share: ``[15, 13]`` frequency of hurried strikers by codes of the incoming shot type and the stroke's; 0 where the
            data do not know it.
    """

    effort: F64
    duel: float
    effort_share: F64
    duel_share: float
    hurried_share: F64

    @property
    def offsets(self) -> F64:
        """``[2 L]`` offset of each situation: the levels outside of long duels, then inside."""
        return np.concatenate([self.effort, self.effort + self.duel])

    def _known(self, rows: Rows) -> tuple[I64, I64]:
        """``[N]`` level of effort, and 1 after a long run of net shots, 0 else; -1 each where unknown."""
        level = np.where(rows.attacks < 0, -1, np.minimum(rows.attacks, len(self.effort) - 1))
        return level, np.where(rows.net_run < 0, -1, rows.net_run >= LONG_DUEL)

    def weights(self, rows: Rows) -> F64:
        """``[N, 2 L]`` probability of each situation: 0 or 1 where it is known, frequencies where unknown."""
        level, long = self._known(rows)
        return self.spread(rows.codes["own_shot"], level, np.where(NET_SHOT[rows.codes["shot"]], long, 0))

    def spread(self, own_shot: Ints, level: Ints, long: Ints) -> F64:
        """``[N, 2 L]`` probability of each situation.

        Args:
            own_shot: ``[N]`` code of the striker's previous shot type.
            level: ``[N]`` level of effort, -1 where unknown.
            long: ``[N]`` 1 for a net shot in a long duel, 0 for other strokes, -1 for a net shot where unknown.
        """
        levels = np.where((level < 0)[:, None], self.effort_share[own_shot], np.eye(len(self.effort))[level])
        inside = np.where(long < 0, self.duel_share, long)
        return np.concatenate([(1 - inside)[:, None] * levels, inside[:, None] * levels], axis=1)

    def mixed(self, logit: F64, weights: F64) -> F64:
        """Probability of a fault, averaged over the situations.

        Args:
            logit: ``[N, ...]`` at effort 0 outside of long duels.
            weights: ``[N, 2 L]`` probability of each situation.
        """
        total = np.zeros_like(logit)
        for offset, weight in zip(self.offsets, weights.T, strict=True):
            total += weight.reshape(-1, *(1,) * (logit.ndim - 1)) * expit(logit + offset)
        return total

    def moved_to(self, mean: F64, logit: F64, weights: F64, share: F64) -> F64:
        """``[N, B]`` logits, those of a row moved by the same amount, so that the mean probability is a given one.

        Args:
            mean: ``[N]`` probabilities between 0 and 1.
            logit: ``[N, B]`` at effort 0 outside of long duels, in B cases.
            weights: ``[N, 2 L]`` probability of each situation.
            share: ``[N, B]`` probability of each case.
        """
        target = np.log(mean) - np.log1p(-mean)
        # The slope of the mean's log-odds is close to 1, so the fixed-point iteration converges fast.
        for _ in range(20):
            current = (share * self.mixed(logit, weights)).sum(axis=1)
            logit = logit + (target - (np.log(current) - np.log1p(-current)))[:, None]
        return logit

    def codes(self, rows: Rows) -> dict[str, I16]:
        """``[N]`` codes of the situation: ``effort`` (L where unknown) and ``duel`` (0, 1, 2 where unknown)."""
        effort, duel = self._known(rows)
        return {
            "effort": np.where(effort < 0, len(self.effort), effort).astype(np.int16),
            "duel": np.where(duel < 0, 2, duel).astype(np.int16),
        }


def fit_situations(logit: F64, share: F64, rows: Rows, *, levels: int = LEVELS) -> tuple[F64, Situations]:
    """Fit the calibration of the log-odds of faults together with the offsets of the situations.

    Args:
        logit: ``[N, M]`` out-of-fold logit of a fault for each of M targets.
        share: ``[N, M]`` probability of each target.
        rows: N strokes of known outcome.
        levels: L, levels of effort.

    Returns:
        ``[2]`` slope and intercept of the logit, and the situations.
    """
    known = (rows.attacks >= 0) & (rows.net_run >= 0)
    effort = np.minimum(rows.attacks, levels - 1)
    net = NET_SHOT[rows.codes["shot"]]
    columns = np.stack([effort, net & (rows.net_run >= LONG_DUEL)], axis=1)[known].astype(np.float64)
    z, part, fault = logit[known], share[known], (rows.outcome == Outcome.FAULT)[known]

    def loss(x: F64) -> tuple[float, F64]:
        q = expit(x[0] * z + (x[1] + columns @ x[2:])[:, None])
        p = np.clip((part * q).sum(axis=1), 1e-9, 1 - 1e-9)
        value = -np.where(fault, np.log(p), np.log1p(-p)).sum() + 0.5 * _PRECISION * (x[2:] @ x[2:])
        slope = part * q * (1 - q)
        outer = np.where(fault, -1 / p, 1 / (1 - p))
        moved = outer * slope.sum(axis=1)
        gradient = np.r_[(outer * (slope * z).sum(axis=1)).sum(), moved.sum(), columns.T @ moved + _PRECISION * x[2:]]
        return value / len(z), gradient / len(z)

    found = minimize(loss, np.array([1.0, 0.0, 0.0, 0.0]), jac=True, method="BFGS", options={"gtol": 1e-8}).x
    count = np.zeros((SLOTS["own_shot"], levels))
    np.add.at(count, (rows.codes["own_shot"][known], effort[known]), 1)
    count[count.sum(axis=1) == 0] = count.sum(axis=0)  # that of all strokes for shot types without strokes
    third = known & net & (rows.net_run >= LONG_DUEL - 1)
    situations = Situations(
        effort=found[2] * np.arange(levels),
        duel=float(found[3]),
        effort_share=count / count.sum(axis=1, keepdims=True),
        duel_share=float((rows.net_run[third] >= LONG_DUEL).sum() / max(1, third.sum())),
        hurried_share=_hurried_shares(rows),
    )
    return found[:2], situations


def _hurried_shares(rows: Rows) -> F64:
    """``[15, 13]`` frequency of hurried strikers by incoming and own shot type, shrunk to that of the incoming one."""
    count = rows.take(rows.hurried >= 0).count("hurried", "incoming_shot", "shot")
    total = count.sum(axis=(0, 2))
    usual = (count[1].sum(axis=1) / np.maximum(total, 1))[:, None]
    return np.asarray((count[1] + _PRIOR_STROKES * usual) / (count.sum(axis=0) + _PRIOR_STROKES))
