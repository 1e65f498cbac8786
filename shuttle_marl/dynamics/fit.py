"""Fit of all models from a table of strokes, and the correction of a model and its refits by a few matches."""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize

from shuttle_marl.base.arrays import F64, I16, I64, Bools
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.pytorch import own_settings
from shuttle_marl.dynamics.choices import player_choices
from shuttle_marl.dynamics.compiled import (
    THREADS,
    PairProbabilities,
    Support,
    compile_game,
    layouts_of,
    pair_probabilities,
    support_of,
)
from shuttle_marl.dynamics.features import DISCIPLINES, Rows
from shuttle_marl.dynamics.fitted import FittedModels, PlayerChoices
from shuttle_marl.dynamics.models import (
    QUICK,
    EnsembleConfig,
    all_targets,
    fit_binary,
    fit_choice,
    fit_ridge,
    fit_situations,
    fit_success,
    fit_target,
    fit_trees,
    fold_of_match,
    intended_targets,
    judged,
    known_targets,
    log_loss,
    log_odds,
    mean_probabilities,
    sigmoid,
    softmax,
    unseen,
)
from shuttle_marl.dynamics.modules import GOOD, HURRIED, Ensemble, MContact, MHurried, MRet, MSucc, Ridge
from shuttle_marl.dynamics.skill import Predicted
from shuttle_marl.game.tables import Game

Report = Callable[[str], None]  # called with a line before each stage
_FOLDS: Final = 5
_SUCCESS_EPOCHS: Final = 2 / 3  # fraction of the epochs of the success networks, which overfit with all of them
_CORRECTION_ROUNDS: Final = 75
_CORRECTION_RATE: Final = 0.03
_HURRIED_ROUNDS: Final = 300  # chosen in four cross fits over the training matches: 50 to 800 rounds
_LEAST_HURRIED: Final = 50  # minimum number of hurried receivers in a fit


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """Result of a fit."""

    models: FittedModels
    game: Game  # layout of the game, without thresholds
    support: Support  # support in the data of every edge of the game
    profiles: tuple[Support, ...]  # support in the strokes of each discipline
    opposite: tuple[Game, Support] | None  # layout and support between different hands; None in fits with a given layout
    predicted: dict[str, Predicted]  # by component, the average player's predictions for matches that models were not fitted to
    chosen: dict[str, Any]  # calibration, offsets, and the settings chosen on the validation matches with their scores

    def profile(self, discipline: int) -> "Fit":
        """The fit of one discipline (index into :data:`~shuttle_marl.dynamics.features.DISCIPLINES`)."""
        models = dataclasses.replace(self.models, share=np.eye(len(DISCIPLINES))[discipline])
        return dataclasses.replace(self, models=models, support=self.profiles[discipline])

    @property
    def between_hands(self) -> "Fit":
        """The fit of players with different hands."""
        assert self.opposite is not None
        game, support = self.opposite
        return dataclasses.replace(self, models=dataclasses.replace(self.models, opposite=True), game=game, support=support)

    def compiled(self) -> tuple[Game, PairProbabilities]:
        """The game of the models, and its probabilities before rounding."""
        probabilities = pair_probabilities(self.models, self.game, self.support)
        return compile_game(self.game, probabilities), probabilities


@own_settings(THREADS)
def fit(
    train: Rows,
    validation: Rows | None,
    *,
    seed: int = 0,
    config: EnsembleConfig | None = None,
    layout: Game | None = None,
    report: Report,
) -> Fit:
    """Fit all models; ``validation``: strokes in context of other matches, on which the strength of pooling is chosen (None: fit
    the average player only); ``layout``: game whose layout is used (None: that of the strokes of train). Raises ShuttleError: a
    split without strokes."""
    if not len(train) or (validation is not None and not len(validation)):
        raise ShuttleError("the fit needs strokes of train and of validation matches; is the data complete?")
    config = config or EnsembleConfig()
    # The first round of expectation maximisation need not converge.
    first_round = dataclasses.replace(QUICK, epochs=max(1, config.epochs // 2), batch=config.batch)
    parts = judged(train)
    (known, fault), (good, returned), (met, met_above), _ = parts.values()

    report("targets")
    soft = known_targets(train)
    target = fit_target(train, soft, first_round, seed)
    report("success, marginalising unknown targets")
    success = fit_success(known, mean_probabilities(target, known.codes), first_round, seed + 1)
    report("targets of faults (expectation), then targets and success (maximisation)")
    soft = intended_targets(target, success, train)
    target = fit_target(train, soft, config, seed + 2)
    shorter = dataclasses.replace(config, epochs=max(1, round(_SUCCESS_EPOCHS * config.epochs)))
    success = fit_success(known, mean_probabilities(target, known.codes), shorter, seed + 3)
    report("returns")
    return_network = fit_binary("return", good, returned, config, seed + 4)
    ridge = fit_ridge(good.codes, returned)
    report("contact heights")
    contact = fit_binary("contact", met, met_above, config, seed + 5)
    report("hurried receivers")
    heights = list(_heights(*parts["hurried"]))
    hurried = {HURRIED[height]: fit_trees(those.codes, late, rounds=_HURRIED_ROUNDS) for height, _, those, late in heights}
    report("choices of strokes")
    choice = fit_choice(train, config, seed + 6)

    report("calibration on out-of-fold predictions")
    # By target: logit of a fault, and probability of the target.
    fold_fault = log_odds(unseen(1 - all_targets(success, known)[..., GOOD], known.match, config.folds))
    share = unseen(softmax(target.logits(known.codes)), known.match, config.folds)
    logits = _unseen_logits(return_network, contact, ridge, parts, config.folds)
    fault_line, situations = fit_situations(fold_fault, share, known)
    mixed = situations.mixed(fault_line[0] * fold_fault + fault_line[1], situations.weights(known))
    marginal = (share * mixed).sum(axis=1)
    # It corrects the out-of-fold logit of a fault, and does not read the target.
    correction = fit_trees(
        known.with_area(0), fault, rounds=_CORRECTION_ROUNDS, rate=_CORRECTION_RATE, offset=log_odds(marginal)
    )  # fmt: skip
    return_line, contact_line = _calibrate(logits["return"], returned), _calibrate(logits["contact"], met_above)
    hurried_lines = np.tile([1.0, 0.0], (len(HURRIED), 1))
    for height, here, _, late in heights:
        hurried_lines[height] = _calibrate(logits["hurried"][here], late)
    counts = np.bincount(train.codes["discipline"], minlength=len(DISCIPLINES))
    average = FittedModels(
        m_choice=choice,
        m_target=target,
        m_succ=MSucc(success, correction, fault_line),
        m_ret=MRet(return_network, fit_trees(good.codes, returned), ridge, return_line),
        m_contact=MContact(contact, fit_trees(met.codes, met_above), contact_line),
        m_hurried=MHurried(hurried, hurried_lines),
        situations=situations,
        share=counts / counts.sum(),
        choices=PlayerChoices(players=(), style=np.zeros((0, 15, 2, 39)), area=np.zeros((0, 13, 3, 9))),
    )
    chosen: dict[str, Any] = {
        "calibration": average.calibration.tolist(),
        "situations": {"effort": situations.effort.tolist(), "duel": situations.duel},
    }
    predicted = {"success": Predicted(known, fault, log_odds(marginal)), **_predicted(parts, logits, average.calibration)}
    models = average
    if validation is not None:
        report("choices of players")
        choices, chosen["choices"] = player_choices(average.choosers, train, validation, config.folds)
        models = dataclasses.replace(average, choices=choices)

    report("catalogue, legality, support")
    game, between = (layout, None) if layout is not None else layouts_of(train, models)
    support, profiles = supports(models, known, game)
    opposite = None if between is None else (between, supports(models, known, between, opposite=True)[0])
    return Fit(
        models=models, game=game, support=support, profiles=profiles, opposite=opposite, predicted=predicted, chosen=chosen
    )  # fmt: skip


def supports(models: FittedModels, known: Rows, game: Game, *, opposite: bool = False) -> tuple[Support, tuple[Support, ...]]:
    """Support of a game in strokes of known outcome, and in those of each discipline."""
    intended = intended_targets(models.m_target, models.m_succ.network, known)
    count = functools.partial(support_of, game=game, opposite=opposite)
    masks = [known.codes["discipline"] == discipline for discipline in range(len(DISCIPLINES))]
    support = count(known, intended)
    return support, tuple(count(known.take(mask), intended[mask]) if mask.any() else support for mask in masks)


def _unseen_logits(
    returns: Ensemble, contacts: Ensemble, ridge: Ridge, parts: dict[str, tuple[Rows, Bools]], folds: int
) -> dict[str, F64]:
    """``[N]`` out-of-fold logits of returns, contacts and hurried receivers (NaN without trees), not calibrated."""
    timed, late = parts["hurried"]
    hurried = np.full(len(timed), np.nan)
    for _, here, those, label in _heights(timed, late):
        for inside, outside, held_out in _folds(those):
            hurried[here[inside]] = fit_trees(outside, label[~inside], rounds=_HURRIED_ROUNDS).logits(held_out)
    return {
        "return": _out_of_fold_blend(returns, *parts["return"], folds, ridge),
        "contact": _out_of_fold_blend(contacts, *parts["contact"], folds),
        "hurried": hurried,
    }


def _predicted(parts: dict[str, tuple[Rows, Bools]], logits: dict[str, F64], calibration: F64) -> dict[str, Predicted]:
    below = len(calibration) - len(HURRIED)
    lines = {
        "return": calibration[1],
        "contact": calibration[2],
        "hurried": calibration[below + parts["hurried"][0].next_contact].T,
    }
    return {name: Predicted(*parts[name], lines[name][0] * logit + lines[name][1]) for name, logit in logits.items()}


def _heights(rows: Rows, late: Bools) -> Iterator[tuple[int, I64, Rows, Bools]]:
    """Height of the receiver's contact, numbers of its rows, rows and labels; not a height with too few hurried receivers."""
    for contact in range(len(HURRIED)):
        here = np.flatnonzero(rows.next_contact == contact)
        if late[here].sum() >= _LEAST_HURRIED:
            yield contact, here, rows.take(here), late[here]


def _folds(rows: Rows) -> Iterator[tuple[Bools, dict[str, I16], dict[str, I16]]]:
    fold = fold_of_match(rows.match, _FOLDS)
    for k in np.unique(fold):
        yield fold == k, rows.take(fold != k).codes, rows.take(fold == k).codes


def _out_of_fold_blend(network: Ensemble, rows: Rows, label: Bools, folds: int, ridge: Ridge | None = None) -> F64:
    """``[N]`` out-of-fold logit of a blend: the network, trees, and the ridge regression if one is given."""
    logits = log_odds(unseen(sigmoid(network.logits(rows.codes)[..., 0]), rows.match, folds))
    for inside, outside, held_out in _folds(rows):
        observed = label[~inside]
        blend = [logits[inside], fit_trees(outside, observed).logits(held_out)]
        if ridge is not None:
            blend.append(fit_ridge(outside, observed, start=ridge).logits(held_out))
        logits[inside] = np.mean(blend, axis=0)
    return logits


def _calibrate(logit: F64, label: Bools) -> F64:

    def loss(line: F64) -> float:
        return log_loss(label, sigmoid(line[0] * logit + line[1]))

    return np.asarray(minimize(loss, np.array([1.0, 0.0]), method="Nelder-Mead", options={"xatol": 1e-4}).x)
