"""Fits everything: networks, calibration, players, catalogue, support; nothing is read but the stroke table and a seed."""

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import torch
from scipy.optimize import minimize

from shuttle_marl.arrays import F64, I64, Bools
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics import players as pooling
from shuttle_marl.dynamics.compiled import (
    LEAST_STROKES,
    PairProbabilities,
    Support,
    catalogue_of,
    compile_game,
    empty_game,
    pair_probabilities,
    replies_of,
    support_of,
)
from shuttle_marl.dynamics.features import DISCIPLINES, SLOTS, Rows
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.models import (
    GOOD,
    all_targets,
    blended_logits,
    fault_class,
    fit_binary,
    fit_choice,
    fit_ridge,
    fit_success,
    fit_target,
    known_outcome,
    latent_target,
    log_odds,
    ridge_logits,
    sigmoid,
    softmax,
    was_good,
    was_met,
)
from shuttle_marl.dynamics.network import QUICK, Ensemble, TrainingConfig, encode, fold_of_match, predict, unseen
from shuttle_marl.dynamics.situations import Situations, fit_situations
from shuttle_marl.dynamics.trees import Trees, fit_trees
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_TECHNIQUES
from shuttle_marl.game.tables import Game, GameError

Report = Callable[[str], None]

THREADS: Final = 1
"""Threads of the fit; fixed, because sums in another order give other weights. Its products are too small to gain from more."""
_BLIND_FOLDS: Final = 5
_SUCCESS_EPOCHS: Final = 2 / 3
"""Share of the epochs that the success networks are fitted for: with all of them they overfit."""
_CORRECTIONS: Final = 75
_CORRECTION_RATE: Final = 0.03
_PLAYER_PRECISIONS: Final = (3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
CHOICE_PRECISIONS: Final = (3.0, 10.0, 30.0, 100.0)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """Results of a fit.

    Attributes:
        models: the models.
        game: the layout of the game; thresholds not filled in.
        support: what the data carries, for every edge of the game.
        profiles: the same of each discipline's strokes alone.
        chosen: calibration and offsets, and what was chosen on the validation matches and how it scored.
    """

    models: FittedModels
    game: Game
    support: Support
    profiles: tuple[Support, ...]
    chosen: dict[str, Any]

    def profile(self, discipline: int) -> "Fit":
        """The same models as those of one discipline (index into :data:`~shuttle_marl.dynamics.features.DISCIPLINES`)."""
        models = self.models.of_discipline(discipline)
        return dataclasses.replace(self, models=models, support=self.profiles[discipline])

    def compiled(self) -> tuple[Game, PairProbabilities]:
        """The game of the models, and the probabilities that it was rounded from."""
        probabilities = pair_probabilities(self.models, self.game, self.support)
        return compile_game(self.game, probabilities), probabilities


def fit(
    train: Rows,
    validation: Rows | None,
    *,
    seed: int = 0,
    config: TrainingConfig | None = None,
    layout: Game | None = None,
    report: Report,
) -> Fit:
    """Fit on train; the strength of pooling is chosen on validation.

    Args:
        train: strokes in context.
        validation: strokes in context of other matches; None: the average player alone is fitted, which needs none.
        seed: of all random numbers.
        config: of the networks.
        layout: a game whose layout the fit shares; its probabilities are not read. None: that of the strokes of train.
        report: called with a line before each stage.

    Raises:
        ShuttleError: a split without strokes.
    """
    if not len(train) or (validation is not None and not len(validation)):
        raise ShuttleError("the fit needs strokes of train and of validation matches; is the data complete?")
    config = config or TrainingConfig()
    # The first round of the expectation maximisation only has to point the way.
    first_round = dataclasses.replace(QUICK, epochs=max(1, config.epochs // 2), batch=config.batch)
    torch.use_deterministic_algorithms(True)
    torch.set_num_threads(THREADS)
    known, good, met = (train.take(mask(train)) for mask in (known_outcome, was_good, was_met))

    report("intended targets")
    soft = _known_targets(train)
    target = fit_target(train, soft, first_round, seed)
    report("success, summing over targets that are not known")
    success = fit_success(known, _targets(target, known), first_round, seed + 1)
    report("intended targets of faults (expectation), then both again (maximisation)")
    soft = intended_targets(target, success, train)
    target = fit_target(train, soft, config, seed + 2)
    fewer = dataclasses.replace(config, epochs=max(1, round(_SUCCESS_EPOCHS * config.epochs)))
    success = fit_success(known, _targets(target, known), fewer, seed + 3)
    report("returns")
    returned = good.outcome == Outcome.RETURNED
    return_network = fit_binary("return", good, returned, config, seed + 4)
    ridge = fit_ridge(good.codes, returned)
    report("contact heights")
    met_above = met.next_contact == 1
    contact = fit_binary("contact", met, met_above, config, seed + 5)
    report("choices of strokes")
    choice = fit_choice(train, config, seed + 6)

    report("calibration on matches that a network did not see")
    blind_fault, share = _blind_faults(success, target, known, config)
    blind_return = _blind_blend(return_network, good, returned, config, ridge)
    blind_above = _blind_blend(contact, met, met_above, config)
    fault_line, situations = fit_situations(blind_fault, share, known)
    calibration = np.stack([
        fault_line,
        _calibrate(blind_return[:, None], np.ones((len(good), 1)), returned),
        _calibrate(blind_above[:, None], np.ones((len(met), 1)), met_above),
    ])  # fmt: skip
    networks = {"choice": choice, "target": target, "success": success, "return": return_network, "contact": contact}
    counts = np.bincount(train.codes["discipline"], minlength=len(DISCIPLINES))
    average = FittedModels(
        networks=networks,
        ridge=ridge,
        trees={
            "success": _fault_correction(fault_line[0] * blind_fault + fault_line[1], share, situations, known),
            "return": fit_trees(good.codes, returned),
            "contact": fit_trees(met.codes, met_above),
        },
        calibration=calibration,
        situations=situations,
        share=counts / counts.sum(),
        striker={},
        receiver={},
        choices=pooling.PlayerChoices(players=(), style=np.zeros((0, 15, 2, 39)), area=np.zeros((0, 13, 3, 9))),
    )
    chosen: dict[str, Any] = {
        "calibration": calibration.tolist(),
        "situations": {"effort": situations.effort.tolist(), "duel": situations.duel},
    }
    models = average
    if validation is not None:
        report("players")
        marginal = situations.mixed(calibration[0, 0] * blind_fault + calibration[0, 1], situations.weights(known))
        blind = {
            "striker": (known, log_odds((share * marginal).sum(axis=1)), known.outcome == Outcome.FAULT),
            "receiver": (good, calibration[1, 0] * blind_return + calibration[1, 1], returned),
        }
        profiles, pooled = player_shifts(average, blind, validation)
        choices, pooled["choices"] = player_choices(networks, train, validation, config.folds)
        models = dataclasses.replace(average, striker=profiles["striker"], receiver=profiles["receiver"], choices=choices)
        chosen = {**pooled, **chosen}

    report("catalogue, legality, support")
    game = layout or layout_of(train)
    intended = intended_targets(target, success, known)
    support = support_of(known, intended, game)
    alone = [known.codes["discipline"] == discipline for discipline in range(len(DISCIPLINES))]
    of_disciplines = tuple(support_of(known.take(which), intended[which], game) if which.any() else support for which in alone)
    return Fit(models=models, game=game, support=support, profiles=of_disciplines, chosen=chosen)


def layout_of(rows: Rows) -> Game:
    """The layout of the game that strokes give: their catalogue and which may answer which; probabilities are not filled in.

    Raises:
        ShuttleError: too few kinds of stroke were played often enough.
    """
    catalogue = catalogue_of(rows)
    try:
        return empty_game(catalogue, replies_of(rows, catalogue))
    except GameError as error:
        raise ShuttleError(
            f"these strokes make no game ({error}): of each stroke of a game at least {LEAST_STROKES} were played; add matches, "
            "or give --prior default, which takes the strokes of the shipped model"
        ) from error


def intended_targets(target: Ensemble, success: Ensemble, rows: Rows) -> F64:
    """``[N, 9]`` probability of each intended target given what happened; rows without a use (unknown outcome) are zero."""
    soft = _known_targets(rows)
    latent = np.flatnonzero(latent_target(rows) & known_outcome(rows))
    hidden = rows.take(latent)
    probability = all_targets(success, hidden).mean(axis=0)
    label = fault_class(hidden)
    joint = _targets(target, hidden) * probability[np.arange(len(hidden)), :, label]
    soft[latent] = joint / joint.sum(axis=1, keepdims=True)
    return soft


def _known_targets(rows: Rows) -> F64:
    soft = np.zeros((len(rows), N_AREAS))
    seen = np.flatnonzero(~latent_target(rows))
    soft[seen, rows.codes["area"][seen]] = 1.0
    return soft


def _targets(target: Ensemble, rows: Rows) -> F64:
    return np.asarray(softmax(predict(target, encode(target.spec, rows.codes))).mean(axis=0))


def _probabilities(network: Ensemble, rows: Rows) -> F64:
    return sigmoid(predict(network, encode(network.spec, rows.codes))[..., 0])


def _blind_faults(success: Ensemble, target: Ensemble, rows: Rows, config: TrainingConfig) -> tuple[F64, F64]:
    """``[N, 9]`` each: logit of a fault by target and probability of each target, from members that did not see the match."""
    probability = all_targets(success, rows)
    fault = unseen(1 - probability[..., GOOD], rows.match, config.folds)
    share = unseen(softmax(predict(target, encode(target.spec, rows.codes))), rows.match, config.folds)
    return log_odds(fault), share


def _fault_correction(logit: F64, share: F64, situations: Situations, rows: Rows) -> Trees:
    """Trees that correct the logit of a fault where that of members that did not see the match errs; they read no target.

    Args:
        logit: ``[N, 9]`` calibrated logit of a fault by target, at effort 0 outside of long duels.
        share: ``[N, 9]`` probability of each target.
        situations: offsets of effort and long duels.
        rows: strokes of known outcome.
    """
    marginal = (share * situations.mixed(logit, situations.weights(rows))).sum(axis=1)
    fault = rows.outcome == Outcome.FAULT
    return fit_trees(rows.with_area(0), fault, rounds=_CORRECTIONS, rate=_CORRECTION_RATE, offset=log_odds(marginal))


def _blind_blend(network: Ensemble, rows: Rows, label: Bools, config: TrainingConfig, ridge: F64 | None = None) -> F64:
    """``[N]`` logit of a blend whose parts did not see the match: the network, trees, and a ridge regression if one is given."""
    logits = log_odds(unseen(_probabilities(network, rows), rows.match, config.folds))
    fold = fold_of_match(rows.match, _BLIND_FOLDS)
    for k in range(_BLIND_FOLDS):
        inside = fold == k
        if not inside.any():
            continue
        seen, blind, happened = rows.take(~inside).codes, rows.take(inside).codes, label[~inside]
        others = [fit_trees(seen, happened).logits(blind)]
        if ridge is not None:
            others.append(ridge_logits(fit_ridge(seen, happened, start=ridge), blind))
        logits[inside] = blended_logits(logits[inside], others)
    return logits


def _calibrate(logit: F64, share: F64, label: Bools) -> F64:
    """Slope and shift ``[2]`` that make the probability (a mixture of ``[N, M]`` logits with shares ``[N, M]``) most likely."""

    def loss(line: F64) -> float:
        p = np.clip((share * sigmoid(line[0] * logit + line[1])).sum(axis=1), 1e-9, 1 - 1e-9)
        return float(-np.where(label, np.log(p), np.log1p(-p)).mean())

    return np.asarray(minimize(loss, np.array([1.0, 0.0]), method="Nelder-Mead", options={"xatol": 1e-4}).x)


def player_shifts(
    models: FittedModels, blind: dict[str, tuple[Rows, F64, Bools]], validation: Rows
) -> tuple[dict[str, dict[str, float]], dict[str, Any]]:
    """Logit shifts of strikers and receivers; the precision of the prior is the best one on validation."""
    judges = {"striker": validation.take(known_outcome(validation)), "receiver": validation.take(was_good(validation))}
    base = {
        "striker": log_odds(models.fault_without_target(judges["striker"])),
        "receiver": log_odds(models.returned(judges["receiver"].codes)),
    }
    label = {"striker": judges["striker"].outcome == Outcome.FAULT, "receiver": judges["receiver"].outcome == Outcome.RETURNED}
    shifts: dict[str, dict[str, float]] = {}
    chosen: dict[str, Any] = {}
    for role, (rows, logit, happened) in blind.items():
        names, index = np.unique(getattr(rows, role), return_inverse=True)
        judged = getattr(judges[role], role)
        candidates: list[tuple[float, float, dict[str, float]]] = []
        for precision in (*_PLAYER_PRECISIONS, np.inf):
            values = np.zeros(len(names))
            if np.isfinite(precision):
                values = pooling.fit_logit_shifts(logit, happened, index, precision)
            shift = dict(zip(names.tolist(), values.tolist(), strict=True))
            moved = sigmoid(base[role] + models.shift_of(judged, shift))
            candidates.append((_log_loss(label[role], moved), precision, shift))
        best = min(candidates, key=lambda candidate: candidate[0])
        shifts[role] = best[2] if np.isfinite(best[1]) else {}
        chosen[role] = {
            "log_loss_by_precision": {str(precision): loss for loss, precision, _ in candidates},
            "precision": str(best[1]),
        }
    return shifts, chosen


def player_choices(
    networks: dict[str, Ensemble], train: Rows, validation: Rows, folds: int | None
) -> tuple[pooling.PlayerChoices, dict[str, Any]]:
    """Shifts of single players' choices; the precision of the prior is the best one on validation.

    Args:
        networks: the ensembles by name.
        train, validation: strokes in context.
        folds: of the matches of train that members of the networks left out; None: no member saw any of them.

    Returns:
        The shifts of players with enough strokes, and what was chosen. Without a stroke of theirs in validation the strongest
        prior is taken.
    """
    names = tuple(pooling.with_enough_strokes(train.striker))
    empty = pooling.PlayerChoices(
        players=names,
        style=np.zeros((len(names), SLOTS["incoming_shot"], SLOTS["contact"], networks["choice"].spec.outputs)),
        area=np.zeros((len(names), SLOTS["shot"], SLOTS["technique"], N_AREAS)),
    )
    if not names:
        return empty, {}
    chosen: dict[str, Any] = {}
    shifts: dict[str, F64] = {}
    for kind, network, cell_slots in (
        ("style", networks["choice"], ("incoming_shot", "contact")),
        ("area", networks["target"], ("shot", "technique")),
    ):
        usable = [rows.take(_judged(rows, kind) & (empty.index(rows.striker) >= 0)) for rows in (train, validation)]
        ours, theirs = usable
        label = [_label(rows, kind) for rows in usable]
        first, second = cell_slots
        cell = [rows.codes[first].astype(np.int64) * SLOTS[second] + rows.codes[second] for rows in usable]
        cells = SLOTS[cell_slots[0]] * SLOTS[cell_slots[1]]
        members = softmax(predict(network, encode(network.spec, ours.codes)))
        base = members.mean(axis=0) if folds is None else unseen(members, ours.match, folds)
        judge = softmax(predict(network, encode(network.spec, theirs.codes))).mean(axis=0)
        losses: list[tuple[float, float, F64]] = []
        for precision in CHOICE_PRECISIONS:
            shift = pooling.fit_choice_shifts(base, cell[0], cells, empty.index(ours.striker), len(names), label[0], precision)
            moved = judge * np.exp(shift[empty.index(theirs.striker), cell[1]])
            moved /= moved.sum(axis=1, keepdims=True)
            losses.append((_cross_entropy(moved, label[1]) if len(moved) else -precision, precision, shift))
        average = _cross_entropy(judge, label[1]) if len(judge) else None
        loss, precision, shift = min(losses, key=lambda candidate: candidate[0])
        shifts[kind] = shift
        chosen[kind] = {
            "precision": precision,
            "cross_entropy": None if average is None else loss,
            "cross_entropy_of_average": average,
        }
    return (
        dataclasses.replace(
            empty, style=shifts["style"].reshape(empty.style.shape), area=shifts["area"].reshape(empty.area.shape)
        ),
        chosen,
    )


def _judged(rows: Rows, kind: str) -> Bools:
    return np.ones(len(rows), dtype=bool) if kind == "style" else ~latent_target(rows)


def _label(rows: Rows, kind: str) -> I64:
    if kind == "area":
        return rows.codes["area"].astype(np.int64)
    return rows.codes["shot"].astype(np.int64) * N_TECHNIQUES + rows.codes["technique"]


def _cross_entropy(p: F64, label: I64) -> float:
    return float(-np.log(p[np.arange(len(p)), label]).mean())


def _log_loss(label: Bools, p: F64) -> float:
    p = np.clip(p, 1e-9, 1 - 1e-9)
    return float(-np.where(label, np.log(p), np.log1p(-p)).mean())
