"""Fits to few matches: the models of another fit, corrected by a few numbers that are shrunk towards no correction.

What moves: the log-odds of a fault, of a return and of a contact above the net, one number each; how often each shot type and
technique is chosen, and each area aimed at; and what moves for single players, as in any fit. Everything else, the catalogue of
strokes, what may answer what, effort, duels and how stroke and context act together, is that of the prior.
"""

import dataclasses
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from scipy.optimize import minimize_scalar

from shuttle_marl.arrays import F64, I64, Bools
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics import players as pooling
from shuttle_marl.dynamics.compiled import Support, support_of
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.dynamics.fit import CHOICE_PRECISIONS, Fit, Report, intended_targets, player_choices, player_shifts
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.models import known_outcome, latent_target, log_odds, sigmoid, softmax, was_good, was_met
from shuttle_marl.dynamics.network import Ensemble, encode, predict
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_TECHNIQUES
from shuttle_marl.game.tables import Game

PRECISION: Final = 4.0
"""Of the normal prior of a shift of log-odds: half a unit on either side of none."""
_WIDEST: Final = 4.0


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Prior:
    """Starting point of a fit.

    Attributes:
        folder: of the model.
        models: its models.
        game: its game, whose layout the fit shares.
        support: what its data carry.
    """

    folder: Path
    models: FittedModels
    game: Game
    support: Support


def fit_from(prior: Prior, train: Rows, validation: Rows | None, *, report: Report) -> Fit:
    """Correct a model by the strokes of a few matches.

    Args:
        prior: the model.
        train: strokes of matches that the prior was not fitted to.
        validation: strokes of others, on which the strength of each correction of choices is chosen; None: the weakest.
        report: called with a line before each stage.
    """
    known, good, met = (train.take(mask(train)) for mask in (known_outcome, was_good, was_met))
    shares = np.bincount(train.codes["discipline"], minlength=len(prior.models.share)) / len(train)
    report("choices of strokes, as a correction")
    networks, chosen = _with_choices(prior.models.networks, train, validation)
    models = dataclasses.replace(prior.models, networks=networks, share=shares, striker={}, receiver={})
    report("faults, returns and contacts, as corrections")
    fault, share = _faults(models, known)
    weights = models.situations.weights(known)

    def marginal(shift: float) -> F64:
        return np.asarray((share * models.situations.mixed(fault + shift, weights)).sum(axis=1))

    returned, above = log_odds(models.returned(good.codes)), log_odds(models.above(met.codes))
    happened = {
        "success": known.outcome == Outcome.FAULT,
        "return": good.outcome == Outcome.RETURNED,
        "contact": met.next_contact == 1,
    }
    shifts = {
        "success": _shift(marginal, happened["success"]),
        "return": _shift(lambda b: sigmoid(returned + b), happened["return"]),
        "contact": _shift(lambda b: sigmoid(above + b), happened["contact"]),
    }
    calibration = models.calibration.copy()
    calibration[:, 1] += list(shifts.values())
    models = dataclasses.replace(models, calibration=calibration)
    if validation is not None:
        report("players")
        blind = {
            "striker": (known, log_odds(marginal(shifts["success"])), happened["success"]),
            "receiver": (good, returned + shifts["return"], happened["return"]),
        }
        of_players, pooled = player_shifts(models, blind, validation)
        choices, of_choices = player_choices(networks, train, validation, None)
        models = dataclasses.replace(models, striker=of_players["striker"], receiver=of_players["receiver"], choices=choices)
        chosen |= {**pooled, "choices": of_choices}
    support = _moved(
        prior.support, shifts, support_of(known, intended_targets(networks["target"], networks["success"], known), prior.game)
    )
    chosen |= {
        "calibration": calibration.tolist(),
        "situations": {"effort": models.situations.effort.tolist(), "duel": models.situations.duel},
        "prior": {"game": prior.game.hash, "shifts": shifts},
    }
    return Fit(models=models, game=prior.game, support=support, profiles=(support, support), chosen=chosen)


def _faults(models: FittedModels, rows: Rows) -> tuple[F64, F64]:
    """``[N, 9]`` each: log-odds of a fault by target at effort 0, and probability of each target."""
    faults = [log_odds(models.fault(rows.with_area(area))) for area in range(N_AREAS)]
    return np.stack(faults, axis=1), models.targets(rows.codes)


def _shift(probability: Any, label: Bools) -> float:
    """Most probable shift of log-odds under its prior; 0 without rows."""

    def loss(shift: float) -> float:
        p = np.clip(probability(shift), 1e-9, 1 - 1e-9)
        return float(-np.where(label, np.log(p), np.log1p(-p)).sum() + 0.5 * PRECISION * shift * shift)

    return float(minimize_scalar(loss, bounds=(-_WIDEST, _WIDEST), method="bounded", options={"xatol": 1e-6}).x)


def _with_choices(
    networks: dict[str, Ensemble], train: Rows, validation: Rows | None
) -> tuple[dict[str, Ensemble], dict[str, Any]]:
    """The networks of choices with other constants: how often each shot type and technique is chosen, and each area aimed at."""
    found, chosen = dict(networks), {}
    for name in ("choice", "target"):
        network = networks[name]
        ours, *others = ((rows if name == "choice" else rows.take(~latent_target(rows))) for rows in (train, validation) if rows)
        base, label = _predicted(network, ours), _labels(name, ours)
        judge = [(_predicted(network, rows), _labels(name, rows)) for rows in others if len(rows)]
        candidates: list[tuple[float, float, F64]] = []
        for precision in CHOICE_PRECISIONS:
            nothing = np.zeros(len(ours), np.int64)
            shift = pooling.fit_choice_shifts(base, nothing, 1, nothing, 1, label, precision)[0, 0]
            loss = _cross_entropy(*judge[0], shift) if judge else -precision
            candidates.append((loss, precision, shift))
        without = _cross_entropy(*judge[0], np.zeros(network.spec.outputs)) if judge else np.inf
        loss, precision, shift = min(candidates, key=lambda candidate: candidate[0])
        if without <= loss:
            precision, shift = np.inf, np.zeros_like(shift)
        chosen[f"average_{name}"] = {"precision": str(precision), "shift": shift.tolist()}
        found[name] = _shifted(network, shift)
    return found, chosen


def _predicted(network: Ensemble, rows: Rows) -> F64:
    return np.asarray(softmax(predict(network, encode(network.spec, rows.codes))).mean(axis=0))


def _labels(name: str, rows: Rows) -> I64:
    if name == "target":
        return rows.codes["area"].astype(np.int64)
    return rows.codes["shot"].astype(np.int64) * N_TECHNIQUES + rows.codes["technique"]


def _cross_entropy(base: F64, label: I64, shift: F64) -> float:
    moved = base * np.exp(shift)
    return float(-np.log(moved[np.arange(len(label)), label] / moved.sum(axis=1)).mean())


def _shifted(network: Ensemble, shift: F64) -> Ensemble:
    moved = Ensemble(network.spec)
    moved.load_state_dict(network.state_dict())
    moved.requires_grad_(False).eval()
    moved.last_bias.data += torch.from_numpy(shift).float()
    return moved


def _moved(support: Support, shifts: dict[str, float], own: Support) -> Support:
    """The ranges of the prior moved with the models, and its counts with those of the own strokes."""

    def moved(bounds: F64, shift: float) -> F64:
        inside = (bounds > 0) & (bounds < 1)
        return np.where(inside, sigmoid(log_odds(bounds) + shift), bounds)

    return Support(
        strokes=support.strokes + own.strokes,
        faults=support.faults + own.faults,
        winners=support.winners + own.winners,
        fault_range=moved(support.fault_range, shifts["success"]),
        # A shuttle that comes back less often wins more often.
        winner_range=moved(support.winner_range, -shifts["return"]),
    )
