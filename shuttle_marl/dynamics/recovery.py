"""Fit of the hidden recovery position (:mod:`shuttle_marl.game.recovery`): where people wait, and what that changes.

``docs/models.md`` describes it. Positions are counted in nested cells: incoming shot type; own area; incoming area; contact and
hurried. Features of a stroke are centred on those of people who had played to the same area against the same shot type, so that
the coefficients say what a position changes beyond what people do there. Regressions read the place in which a receiver stood; a
position of the game is the mean of the places in its cell.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, I64, U16, Bools, Ints
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.tensor_files import Tensors, checked, tensor_bytes
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.dynamics.models import sigmoid
from shuttle_marl.dynamics.skill import Predicted
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.recovery import EFFECTS, N_POSITIONS, PARTS, STEP, Recovery, position_of
from shuttle_marl.game.shipped import POSITIONS, readable
from shuttle_marl.game.stroke import N_SERVES, N_SHOTS, SHOTS

GROUPS: Final[dict[str, tuple[str, ...]]] = {  # shot types with the same coefficients; those of serves are 0
    "smash": ("smash", "half-smash"),
    "flat": ("drive", "push", "net-kill"),
    "short": ("drop", "net-shot", "cross-court-net-shot", "block"),
    "high": ("clear", "lift"),
}
FEATURES: Final = ("lateral", "deeper", "in front")  # distance from where a stroke is met [m]
MIN_ROWS: Final = 5000  # strokes with a known position of the receiver of a fit; fewer have some hundred winners
LEAST_SHARE: Final = 0.04  # least share of a feasible position after an incoming shot type and own area
_PEOPLE: Final = 25.0  # weight of the share in the cell around a cell, in strokes
_MEETING: Final = 20.0  # weight of the mean meeting point of an area in that of a shot type and area, in strokes
_USUAL: Final = 10.0  # weight of the mean features of a stroke in those of a cell, in strokes
_PENALTY: Final = 20.0
_ROUNDS: Final = 30
_LIMIT: Final = 4.0
_GROUP: Final = np.array([next((g for g, shots in enumerate(GROUPS.values()) if shot in shots), -1) for shot in SHOTS])
_SIZES: Final = tuple(PARTS.values())  # cells of people's positions hold the first 1, 2, 3 and 5 of the parts
_COMPONENTS: Final = ("return", "contact", "hurried")  # models whose outcomes the effects change; a winner is no return


class Court(NamedTuple):
    """Where receivers wait, and where they meet the shuttle [m]."""

    mean: F64  # ``[9, 2]`` mean place of each position
    meeting: F64  # ``[13, 9, 2]`` mean place in which returned strokes of a shot type and area are met

    @classmethod
    def of(cls, rows: Rows) -> "Court":
        """The court of strokes."""
        at = rows.waiting[placed(rows)].astype(np.float64)
        mean = _means(position_of(*at.T), at, at.mean(axis=0, keepdims=True).repeat(N_POSITIONS, axis=0), 1.0)
        met = np.isfinite(rows.meeting).all(axis=1) & (rows.codes["area"] >= 0)
        shot, area = (rows.game_codes[name][met].astype(np.int64) for name in ("shot", "area"))
        where = rows.meeting[met].astype(np.float64)
        of_area = _means(area, where, np.tile(where.mean(axis=0), (N_AREAS, 1)), _MEETING)
        meeting = _means(shot * N_AREAS + area, where, np.tile(of_area, (N_SHOTS, 1)), _MEETING)
        return cls(mean, meeting.reshape(N_SHOTS, N_AREAS, 2))

    def features(self, shot: Ints, area: Ints, place: F64) -> F64:
        """``[..., 3]`` :data:`FEATURES` of places ``[..., 2]`` against strokes."""
        sideways, behind = np.moveaxis(place - self.meeting[shot, area], -1, 0)
        return np.stack([np.abs(sideways), np.maximum(behind, 0), np.maximum(-behind, 0)], axis=-1)


class FittedRecovery(NamedTuple):
    """Result of a fit."""

    recovery: Recovery
    coefficients: F64  # ``[3, 4, 3]`` log-odds per metre by `EFFECTS`, group and feature
    court: Court

    def shift(self, shot: Ints, area: Ints, place: F64) -> F64:
        """``[3, ...]`` log-odds by which places ``[..., 2]`` change the effects, not centred."""
        found = (self.coefficients[:, _GROUP[shot]] * self.court.features(shot, area, place)).sum(axis=-1)
        return np.clip(np.where(_GROUP[shot] < 0, 0.0, found), -_LIMIT, _LIMIT)

    def to_bytes(self) -> bytes:
        """The content of a file, in a model folder :data:`~shuttle_marl.game.shipped.POSITIONS`."""
        court = {name: getattr(self.court, name) for name in Court._fields}
        return tensor_bytes({**self.recovery.arrays, "coefficients": self.coefficients, **court}, {}, pack=True)

    @classmethod
    def checked(cls, tensors: Tensors) -> "FittedRecovery":
        """From the content of a file. Raises KeyError, TypeError, ValueError, ShuttleError: a part is missing or invalid."""
        shapes = ((N_POSITIONS, 2), (N_SHOTS, N_AREAS, 2))
        court = (checked(tensors.arrays[name], np.float64, shape) for name, shape in zip(Court._fields, shapes, strict=True))
        size = (len(EFFECTS), len(GROUPS), len(FEATURES))
        return cls(Recovery.checked(tensors), checked(tensors.arrays["coefficients"], np.float64, size), Court(*court))

    def summary(self, rows: Rows) -> dict[str, Any]:
        """What a model card says of it: means over strokes after the serve of the fit, and the coefficients."""
        rows = rows.take((rows.stroke > 1) & placed(rows))
        known, share = people_at(self.recovery, rows)
        own = share[np.arange(len(share)), position_of(*rows.waiting[known].astype(np.float64).T)]
        coefficients = {
            effect: {group: dict(zip(FEATURES, line, strict=True)) for group, line in zip(GROUPS, lines, strict=True)}
            for effect, lines in zip(EFFECTS, self.coefficients.round(4).tolist(), strict=True)
        }
        return {
            "strokes": len(own),
            "feasible": float((share > 0).sum(axis=1).mean()),
            "inside": float((own > 0).mean()),
            "coefficients": coefficients,
        }


def load_recovery(folder: Path) -> FittedRecovery | None:
    """The fit in a model folder; None if it has none. Raises GameError: the file cannot be read."""
    if not (folder / POSITIONS).is_file():
        return None
    with readable(folder, POSITIONS, "positions") as tensors:
        return FittedRecovery.checked(tensors)


def fit_recovery(rows: Rows, predicted: Mapping[str, Predicted]) -> FittedRecovery | None:
    """Fit people's positions and their effects; None with fewer than :data:`MIN_ROWS` known positions; ``rows``: strokes of all
    matches of the fit; ``predicted``: those with a judged outcome, by model; see
    :attr:`shuttle_marl.dynamics.fit.Fit.predicted`."""
    if placed(rows).sum() < MIN_ROWS:
        return None
    court = Court.of(rows)
    coefficients = np.stack([_coefficients(court, predicted[name], winner=name == "return") for name in _COMPONENTS])
    shot, area, position = np.indices((N_SHOTS, N_AREAS, N_POSITIONS))
    nothing = Recovery(people=_people(rows), effect=np.zeros((len(EFFECTS), *shot.shape), dtype=np.int16))
    shift = FittedRecovery(nothing, coefficients, court).shift(shot, area, court.mean[position])
    recovery = dataclasses.replace(nothing, effect=np.rint(shift / STEP).astype(np.int16))
    return FittedRecovery(recovery, coefficients, court)


def placed(rows: Rows) -> Bools:
    """``[N]`` strokes whose receiver stood at a known place."""
    return np.asarray(np.isfinite(rows.waiting).all(axis=1))


def people_at(recovery: Recovery, rows: Rows) -> tuple[Bools, F64]:
    """``[N]`` strokes whose context is known, and for these the probabilities ``[M, 9]`` of people's positions."""
    codes = np.stack([rows.game_codes[name] for name in PARTS]).astype(np.int64)
    known = np.asarray((codes < np.array(_SIZES)[:, None]).all(axis=0))
    return known, recovery.people[tuple(codes[:, known])] / np.float64(CHOICE_ONE)


def _coefficients(court: Court, predicted: Predicted, *, winner: bool) -> F64:
    """``[4, 3]`` coefficients of the effects on one outcome; ``winner``: whether the outcome is that the predicted one, a return,
    does not happen."""
    used = placed(predicted.rows) & np.isfinite(predicted.logit) & (predicted.rows.codes["shot"] >= N_SERVES)
    rows, label, offset = predicted.rows.take(used), predicted.label[used] != winner, predicted.logit[used]
    if not len(rows):
        return np.zeros((len(GROUPS), len(FEATURES)))
    names = ("shot", "area", "own_area", "incoming_shot")
    shot, area, own, incoming = (rows.game_codes[name].astype(np.int64) for name in names)
    x = court.features(shot, area, rows.waiting.astype(np.float64))
    stroke = shot * N_AREAS + area
    of_stroke = _means(stroke, x, np.tile(x.mean(axis=0), (N_SHOTS * N_AREAS, 1)), _USUAL)
    cells, cell = np.unique(np.stack([stroke, own, incoming]), axis=1, return_inverse=True)
    x = x - _means(cell.ravel(), x, of_stroke[cells[0]], _USUAL)[cell.ravel()]
    groups = [_GROUP[shot] == group for group in range(len(GROUPS))]
    return np.stack([_logistic(x[g], label[g], (-1 if winner else 1) * offset[g]) for g in groups])


def _logistic(x: F64, label: Bools, offset: F64) -> F64:
    """``[K]`` coefficients of a ridge-penalised logistic regression without intercept on ``[N, K]``, by Newton's method."""
    w, ridge = np.zeros(x.shape[1]), _PENALTY * np.eye(x.shape[1])
    for _ in range(_ROUNDS):
        p = sigmoid(offset + x @ w)
        w = w + np.linalg.solve((x.T * (p * (1 - p))) @ x + ridge, x.T @ (label - p) - _PENALTY * w)
    return w


def _people(rows: Rows) -> U16:
    codes = np.stack([rows.game_codes[name] for name in PARTS]).astype(np.int64)
    known = placed(rows) & (codes < np.array(_SIZES)[:, None]).all(axis=0)
    codes, waits = codes[:, known], np.eye(N_POSITIONS)[position_of(*rows.waiting[known].astype(np.float64).T)]
    share = waits.mean(axis=0)[None]
    feasible = share > 0
    for inner, outer in ((1, 0), (2, 1), (3, 2), (5, 3)):
        shape = _SIZES[:inner]
        around = share.repeat(int(np.prod(_SIZES[outer:inner])), axis=0)
        share = _means(np.ravel_multi_index(tuple(codes[:inner]), shape), waits, around, _PEOPLE)
        if inner == 2:
            feasible = share >= LEAST_SHARE
    share = np.where(feasible.repeat(len(share) // len(feasible), axis=0), share, 0.0)
    return _units(share / share.sum(axis=1, keepdims=True)).reshape(*_SIZES, N_POSITIONS)


def _units(share: F64) -> U16:
    units = np.where(share > 0, np.maximum(np.rint(share * CHOICE_ONE), 1), 0).astype(np.int64)
    units[np.arange(len(units)), units.argmax(axis=1)] += CHOICE_ONE - units.sum(axis=1)
    return units.astype(np.uint16)


def _means(cell: I64, values: F64, around: F64, weight: float) -> F64:
    """``[M, K]`` means of values ``[N, K]`` by cell, shrunk to others ``[M, K]`` with the weight of so many rows."""
    size = len(around)
    total = np.stack([np.bincount(cell, column, size) for column in values.T], axis=1)
    return np.asarray((total + weight * around) / (np.bincount(cell, minlength=size)[:, None] + weight))


def save_recovery(folder: Path, train: Rows, predicted: Mapping[str, Predicted]) -> dict[str, Any] | None:
    """Write the positions of receivers where strokes have enough of them; what the card says of these."""
    fitted = fit_recovery(train, predicted)
    if fitted is None:
        (folder / POSITIONS).unlink(missing_ok=True)  # of a replaced model
        return None
    replace_file(folder / POSITIONS, fitted.to_bytes())
    return fitted.summary(train)
