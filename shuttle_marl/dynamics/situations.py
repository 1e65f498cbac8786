"""Effort and duels: the part of a rally beside the last two strokes that moves the probability of a fault.

A player who has attacked often faults more, and so does the striker of a net shot after three or more net shots in a row.
Both are offsets of the log-odds that the networks give, fitted together with their calibration on matches that a network did
not see:

- **effort**: attacking strokes (smashes, half-smashes) of the striker so far in the rally, from 0 to :data:`LEVELS` - 1 (so
  many or more); each adds the same offset. On blind likelihood a cap of three attacks gains 1.5 nats [-0.7, 3.6] over a cap of
  two and free offsets lose 1.4 [0.6, 2.2] against a line, so it is a line with a cap of two; the opponent's attacks add nothing.
- **duel**: whether the stroke is a net shot that follows :data:`LONG_DUEL` or more net shots in a row.

Where a dropped row leaves open how many attacks or net shots there were, the row has no part in the fit, and its probability is
the mean over what it could be, weighted as in the training strokes with the same own last shot type.
"""

import dataclasses
from typing import Final

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from shuttle_marl.arrays import F64, I16, Ints
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.features import NET_SHOT, SLOTS, Rows

LEVELS: Final = 3
"""Levels of effort."""
LONG_DUEL: Final = 3
"""Net shots in a row that make a duel long."""
_PRECISION: Final = 4.0
"""Of the normal prior of an offset: half a unit of log-odds on either side of none."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Situations:
    """Offsets of the log-odds of a fault, and how often each situation occurs.

    A situation is a level of effort and whether the stroke is a net shot of a long duel. The probabilities of the networks,
    calibrated, are those at effort 0 outside of long duels.

    Attributes:
        effort: ``[L]`` offset of each level of effort; the first is 0.
        duel: offset of a net shot in a long duel.
        effort_share: ``[15, L]`` share of each level among the strokes after each own last shot type (as coded in
            ``own_shot``).
        duel_share: share of long duels among the net shots that follow two net shots.
    """

    effort: F64
    duel: float
    effort_share: F64
    duel_share: float

    @property
    def offsets(self) -> F64:
        """``[2 L]`` offset of each situation: the levels outside of long duels, then inside."""
        return np.concatenate([self.effort, self.effort + self.duel])

    def weights(self, rows: Rows) -> F64:
        """``[N, 2 L]`` probability of each situation: 1 for the one a stroke was played in, shares where it is not known."""
        level = np.where(rows.attacks < 0, -1, np.minimum(rows.attacks, len(self.effort) - 1))
        long = np.where(rows.net_run < 0, -1, rows.net_run >= LONG_DUEL)
        return self.spread(rows.codes["own_shot"], level, np.where(NET_SHOT[rows.codes["shot"]], long, 0))

    def spread(self, own_shot: Ints, level: Ints, long: Ints) -> F64:
        """``[N, 2 L]`` probability of each situation.

        Args:
            own_shot: ``[N]`` code of the own last shot type.
            level: ``[N]`` level of effort, -1 where it is not known.
            long: ``[N]`` 1 for a net shot of a long duel, 0 for any other stroke, -1 for a net shot where it is not known.
        """
        levels = np.where((level < 0)[:, None], self.effort_share[own_shot], np.eye(len(self.effort))[level])
        inside = np.where(long < 0, self.duel_share, long)
        return np.concatenate([(1 - inside)[:, None] * levels, inside[:, None] * levels], axis=1)

    def mixed(self, logit: F64, weights: F64) -> F64:
        """Probability of a fault over the situations.

        Args:
            logit: ``[N, ...]`` at effort 0 outside of long duels.
            weights: ``[N, 2 L]`` probability of each situation.

        Returns:
            ``[N, ...]`` probabilities.
        """
        total = np.zeros_like(logit)
        for offset, weight in zip(self.offsets, weights.T, strict=True):
            total += weight.reshape(-1, *(1,) * (logit.ndim - 1)) * expit(logit + offset)
        return total

    def logit_of_mean(self, mean: F64, weights: F64) -> F64:
        """``[N]`` logit at effort 0 outside of long duels, by the ``[N]`` mean probability over the situations.

        Args:
            mean: between 0 and 1.
            weights: ``[N, 2 L]`` probability of each situation.
        """
        aim = np.log(mean) - np.log1p(-mean)
        logit = aim.copy()
        # The mean's log-odds rise with the logit at a slope close to 1, so this converges fast.
        for _ in range(20):
            found = self.mixed(logit, weights)
            logit += aim - (np.log(found) - np.log1p(-found))
        return logit

    def codes(self, rows: Rows) -> dict[str, I16]:
        """``[N]`` each: the situation as codes, ``effort`` (L where it is not known) and ``duel`` (0, 1, 2: not known)."""
        levels = len(self.effort)
        effort = np.where(rows.attacks < 0, levels, np.minimum(rows.attacks, levels - 1))
        duel = np.where(rows.net_run < 0, 2, rows.net_run >= LONG_DUEL)
        return {"effort": effort.astype(np.int16), "duel": duel.astype(np.int16)}


def fit_situations(logit: F64, share: F64, rows: Rows, *, levels: int = LEVELS) -> tuple[F64, Situations]:
    """Calibrate the log-odds of faults, and fit the offsets of the situations with them.

    Args:
        logit: ``[N, M]`` of a fault for each of M targets, from networks that did not see the match.
        share: ``[N, M]`` probability of each target.
        rows: N strokes of known outcome.
        levels: L, levels of effort.

    Returns:
        ``[2]`` slope and shift of the logit, and the situations.
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
    third = known & net & (rows.net_run >= LONG_DUEL - 1)
    situations = Situations(
        effort=found[2] * np.arange(levels),
        duel=float(found[3]),
        effort_share=_effort_shares(rows.codes["own_shot"][known], effort[known], levels),
        duel_share=float((rows.net_run[third] >= LONG_DUEL).sum() / max(1, third.sum())),
    )
    return found[:2], situations


def _effort_shares(own_shot: Ints, effort: Ints, levels: int) -> F64:
    """``[15, L]`` share of each level after each own last shot type; of all strokes where there was none."""
    count = np.zeros((SLOTS["own_shot"], levels))
    np.add.at(count, (own_shot, effort), 1)
    count[count.sum(axis=1) == 0] = count.sum(axis=0)
    return np.asarray(count / count.sum(axis=1, keepdims=True))
