"""Correction of a model by a few matches, and of its refits."""

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import torch
from scipy.optimize import minimize_scalar

from shuttle_marl.base.arrays import F64, I16, Bools
from shuttle_marl.dynamics.choices import Choices, best_shifts, player_choices
from shuttle_marl.dynamics.compiled import Support, support_of
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.dynamics.fit import Fit, Report, intended_targets
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.hurried import Hurry
from shuttle_marl.dynamics.models import judged, labelled, labels_of, log_odds, mean_probabilities, sigmoid
from shuttle_marl.dynamics.network import Ensemble
from shuttle_marl.dynamics.skill import Predicted
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.pairs import COMPONENTS
from shuttle_marl.game.shipped import MOST_STEPS, STEP, moved, steps_between
from shuttle_marl.game.tables import Game

PRECISION: Final = 4.0
"""Precision of the normal prior of a shift of log-odds; its standard deviation is 0.5."""
_MAX_SHIFT: Final = 4.0
_SMALL: Final = 0.01


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Prior:
    """A model to be corrected.

    Attributes:
        game: the game, whose layout the fit shares.
        support: support in its data.
        opposite: its game of players with different hands, and the support in that.
        hurry: its index of hurried strikers, if it has one.
        skill: standard deviations of its offsets of players (:attr:`~shuttle_marl.dynamics.skill.FittedSkill.sd`), if it has any.
    """

    models: FittedModels
    game: Game
    support: Support
    opposite: tuple[Game, Support]
    hurry: Hurry | None
    skill: F64 | None
    refits: Sequence[Game]


def fit_from(prior: Prior, train: Rows, validation: Rows | None, *, report: Report) -> Fit:
    """Correct a model by a few matches.

    Args:
        train: strokes of matches to which the prior was not fitted.
        validation: strokes of other matches, on which the shrinkage of choices is chosen; None: the weakest.
    """
    parts = judged(train)
    known, good, met = (parts[name][0] for name in COMPONENTS)
    shares = np.bincount(train.codes["discipline"], minlength=len(prior.models.share)) / len(train)
    report("choices of strokes, as a correction")
    choosers, chosen = _with_choices(prior.models.choosers, train, validation)
    models = dataclasses.replace(prior.models, m_choice=choosers["choice"], m_target=choosers["target"], share=shares)
    report("faults, returns and contacts, as corrections")
    fault, share = _faults(models, known)
    weights = models.situations.weights(known)

    def marginal(shift: float) -> F64:
        return np.asarray((share * models.situations.mixed(fault + shift, weights)).sum(axis=1))

    returned, above = (log_odds(_over_bit(p, models, part)) for p, part in ((models.returned, good), (models.above, met)))
    chances: dict[str, Callable[[float], F64]] = {
        "success": marginal,
        "return": lambda b: sigmoid(returned + b),
        "contact": lambda b: sigmoid(above + b),
    }
    estimates = {name: shift_of(chance, parts[name][1]) for name, chance in chances.items()}
    shifts, deviations = ({name: estimate[i] for name, estimate in estimates.items()} for i in (0, 1))
    models = dataclasses.replace(
        models,
        m_succ=models.m_succ.shifted(shifts["success"]),
        m_ret=models.m_ret.shifted(shifts["return"]),
        m_contact=models.m_contact.shifted(shifts["contact"]),
    )
    logits = (log_odds(marginal(shifts["success"])), returned + shifts["return"], above + shifts["contact"])
    predicted = {name: Predicted(*parts[name], logit) for name, logit in zip(COMPONENTS, logits, strict=True)}
    if validation is not None:
        report("choices of players")
        choices, chosen["choices"] = player_choices(choosers, train, validation, None)
        models = dataclasses.replace(models, choices=choices)
    intended = intended_targets(models.m_target, models.m_succ.network, known)
    support = _moved(prior.support, shifts, support_of(known, intended, prior.game))
    between, theirs = prior.opposite
    opposite = between, _moved(theirs, shifts, support_of(known, intended, between, opposite=True))
    chosen |= {
        "calibration": models.calibration.tolist(),
        "situations": {"effort": models.situations.effort.tolist(), "duel": models.situations.duel},
        "prior": {"game": prior.game.hash, "shifts": shifts, "deviations": deviations},
    }
    return Fit(
        models=models,
        game=prior.game,
        support=support,
        profiles=(support, support),
        opposite=opposite,
        predicted=predicted,
        chosen=chosen,
    )


def _faults(models: FittedModels, rows: Rows) -> tuple[F64, F64]:
    """``[N, 9]`` each: log-odds of a fault by target at effort 0, and probability of each target."""
    faults = [
        log_odds(_over_bit(models.fault, models, dataclasses.replace(rows, codes=rows.with_area(area))))
        for area in range(N_AREAS)
    ]
    return np.stack(faults, axis=1), models.targets(rows.codes)


def _over_bit(probability: Callable[[dict[str, I16]], F64], models: FittedModels, rows: Rows) -> F64:
    """``[N]`` probabilities; the mean over hurried strikers and others where it is not known who was hurried."""
    found = probability(rows.codes)
    if not (rows.hurried < 0).any() or not models.knows_hurried:
        return found
    share = models.situations.hurried_share[rows.codes["incoming_shot"], rows.codes["shot"]]
    late = probability({**rows.codes, "hurried": np.ones(len(rows), np.int16)})
    return np.where(rows.hurried < 0, (1 - share) * found + share * late, found)


def shift_of(probability: Callable[[float], F64], label: Bools) -> tuple[float, float]:
    """Maximum a posteriori shift of log-odds, 0 without rows, and its standard deviation (Laplace's approximation)."""

    def loss(shift: float) -> float:
        p = np.clip(probability(shift), 1e-9, 1 - 1e-9)
        return float(-np.where(label, np.log(p), np.log1p(-p)).sum() + 0.5 * PRECISION * shift * shift)

    shift = float(minimize_scalar(loss, bounds=(-_MAX_SHIFT, _MAX_SHIFT), method="bounded", options={"xatol": 1e-6}).x)
    curvature = (loss(shift + _SMALL) + loss(shift - _SMALL) - 2 * loss(shift)) / _SMALL**2
    return shift, 1 / math.sqrt(max(curvature, PRECISION))


def _with_choices(
    networks: dict[str, Ensemble], train: Rows, validation: Rows | None
) -> tuple[dict[str, Ensemble], dict[str, Any]]:
    """The choice and target networks with corrected frequencies of shot types and techniques, and of areas."""
    corrected, chosen = dict(networks), {}
    for name in ("choice", "target"):
        network = networks[name]
        ours, others = (
            Choices(mean_probabilities(network, rows.codes), *2 * (np.zeros(len(rows), np.int64),), labels_of(name, rows))
            for rows in (part.take(labelled(name, part)) for part in (train, train.none() if validation is None else validation))
        )
        loss, precision, shifts = best_shifts(ours, others, 1, 1)
        shift = shifts[0, 0]
        uncorrected = others.cross_entropy(np.zeros_like(shifts)) if len(others.label) else np.inf
        if uncorrected <= loss:
            precision, shift = np.inf, np.zeros_like(shift)
        chosen[f"average_{name}"] = {"precision": str(precision), "shift": shift.tolist()}
        corrected[name] = _shifted(network, shift)
    return corrected, chosen


def _shifted(network: Ensemble, shift: F64) -> Ensemble:
    moved = copy.deepcopy(network)
    moved.last_bias.add_(torch.from_numpy(shift))
    return moved


def _moved(support: Support, shifts: dict[str, float], own: Support) -> Support:
    """Support of the prior: ranges shifted like the models, counts plus those of the new strokes."""

    def moved(bounds: F64, shift: float) -> F64:
        inside = (bounds > 0) & (bounds < 1)
        return np.where(inside, sigmoid(log_odds(bounds) + shift), bounds)

    return Support(
        strokes=support.strokes + own.strokes,
        faults=support.faults + own.faults,
        winners=support.winners + own.winners,
        fault_range=moved(support.fault_range, shifts["success"]),
        # Fewer returns mean more winners.
        winner_range=moved(support.winner_range, -shifts["return"]),
    )


def refits_from(prior: Prior, game: Game, deviations: Mapping[str, float], seed: int, number: int) -> dict[str, Game]:
    """Refits of a corrected model: those of the prior, moved like the model, each by other draws of the shifts.

    Args:
        deviations: standard deviation of the shift of each component.
        number: of refits, at most as many as the prior has.
    """
    found = {}
    for k, refit in enumerate(prior.refits[:number], 1):
        # A shift of the returns moves the winners by as much, and one of the contacts above those below.
        drawn = np.random.default_rng([seed, k]).normal(0, [deviations[name] for name in COMPONENTS]) / STEP
        steps = steps_between(prior.game, refit).astype(np.int64)
        steps[: len(COMPONENTS)] += np.rint(drawn).astype(np.int64)[:, None]  # the chance of a hurried receiver stays
        found[str(k)] = moved(game, np.clip(steps, -MOST_STEPS, MOST_STEPS).astype(np.int8), refit.fault_odds)
    return found
