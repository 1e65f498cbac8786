"""Evaluation and model cards: scores on unseen matches, health checks of the solved game, and what people play.

The baseline of the scores is gradient-boosted trees with the same rows and features (LightGBM, Ke et al., NIPS 2017). A single
wrong entry of the tables can make perfect play a stall or a single winning stroke, so every fit is solved exactly, and its card
warns of values outside of their limits. No fit is selected by these values: that would let opinions on optimal play determine the
game.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy  # its statistics are imported when first used
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from shuttle_marl.base.arrays import F64, Bools, Ints
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_sealed, with_hashes
from shuttle_marl.data.schema import Outcome
from shuttle_marl.dynamics.boosting import PARAMETERS, lightgbm
from shuttle_marl.dynamics.compiled import CREDIBLE, MIN_END, PRIOR_STROKES
from shuttle_marl.dynamics.features import STATE, Rows
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.models import fold_of_match, judged
from shuttle_marl.exact.fixed_point import largest_continuation
from shuttle_marl.exact.occupancy import visits
from shuttle_marl.exact.optimal import best_response, solve
from shuttle_marl.exact.play import OFTEN, impossible, in_cross_court_runs, mix, play, unusual
from shuttle_marl.exact.profile import StatePolicy
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.shipped import CARD, FILES, NETWORKS, OPTIONAL_FILES, read_model_card
from shuttle_marl.game.stroke import N_SHOTS, N_TECHNIQUES, SHOTS
from shuttle_marl.game.tables import Game

BINS: Final = 15
RESAMPLES: Final = 2000
_CONTEXT: Final = (*STATE, "shot", "technique")
_STROKE: Final = (*_CONTEXT, "area")
_FOLDS: Final = 5
_LEAVES: Final = (8, 15)


def log_losses(label: Bools, p: F64) -> F64:
    """``[N]`` log-loss of each row, in nats."""
    p = np.clip(p, 1e-7, 1 - 1e-7)
    return np.asarray(-np.where(label, np.log(p), np.log1p(-p)))


def _bins(label: Bools, p: F64, bins: int = BINS) -> list[tuple[float, float, int]]:
    parts = np.array_split(np.argsort(p, kind="stable"), bins)
    return [(float(p[i].mean()), float(label[i].mean()), len(i)) for i in parts if len(i)]


def calibration_error(label: Bools, p: F64, bins: int = BINS) -> float:
    """Expected calibration error over bins of equal mass."""
    return sum(abs(observed - predicted) * n for predicted, observed, n in _bins(label, p, bins)) / len(label)


def reliability(label: Bools, p: F64) -> list[dict[str, float]]:
    """Reliability diagram, by bins of equal mass."""
    return [{"predicted": round(mean, 5), "observed": round(share, 5), "rows": n} for mean, share, n in _bins(label, p)]


def area_under_curve(label: Bools, p: F64) -> float:
    """Area under the ROC curve; NaN if all labels are equal."""
    positive = int(label.sum())
    negative = len(label) - positive
    if not positive or not negative:
        return float("nan")
    return float((scipy.stats.rankdata(p)[label].sum() - positive * (positive + 1) / 2) / (positive * negative))


def scores(label: Bools, p: F64) -> dict[str, Any]:
    """``rows``, ``log_loss``, ``brier``, ``auc`` and ``ece`` of a binary prediction."""
    return {
        "rows": len(label),
        "log_loss": float(log_losses(label, p).mean()),
        "brier": float(np.mean((p - label) ** 2)),
        "auc": area_under_curve(label, p),
        "ece": calibration_error(label, p),
    }


def difference_by_match(ours: F64, theirs: F64, match: Ints, seed: int = 0) -> dict[str, float]:
    """Mean difference of log-losses (ours minus theirs), with a 95 % bootstrap interval over matches."""
    _, index = np.unique(match, return_inverse=True)
    total, count = np.bincount(index, ours - theirs), np.bincount(index)
    draws = np.random.default_rng(seed).integers(0, len(count), (RESAMPLES, len(count)))
    means = total[draws].sum(axis=1) / count[draws].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return {"mean": float((ours - theirs).mean()), "low": float(low), "high": float(high)}


def evaluate(models: FittedModels, train: Rows, test: Rows, *, report: Callable[[str], None]) -> dict[str, Any]:
    """Scores of all models.

    Args:
        train: rows to which the trees are fitted.
        test: rows to score.

    Returns:
        ``success``, ``return``, ``contact``, ``hurried`` (where the models know it): scores, ``trees`` (scores of the trees),
        ``difference`` (models minus trees, by match), ``reliability``; ``next_stroke``: see :func:`prediction_scores`.
    """

    tasks: dict[str, tuple[Callable[[Rows], F64], tuple[str, ...]]] = {
        # The target of a fault is unknown, so neither models nor trees may read it (no leak).
        "success": (lambda rows: 1 - models.fault_without_target(rows), (*_CONTEXT, "effort", "duel")),
        "return": (lambda rows: models.returned(rows.codes), _STROKE),
        "contact": (lambda rows: models.above(rows.codes), _STROKE),
        "hurried": (lambda rows: models.hurried(rows.codes)[np.arange(len(rows)), rows.next_contact], (*_STROKE, "next_contact")),
    }
    fitted_to, tested_on = judged(train), judged(test)
    if not (models.knows_hurried and tested_on["hurried"][0]):
        del tasks["hurried"]
    out: dict[str, Any] = {}
    for name, (predict, features) in tasks.items():
        report(f"{name}, and trees on the same rows")
        (fitted, known), (rows, label) = (
            (part, ~fault if name == "success" else fault) for part, fault in (fitted_to[name], tested_on[name])
        )
        p = predict(rows)
        trees = tree_predictions(features, _read(fitted, models), known, fitted.match, _read(rows, models))
        out[name] = {
            **scores(label, p),
            "trees": scores(label, trees),
            "difference": difference_by_match(log_losses(label, p), log_losses(label, trees), rows.match),
            "reliability": reliability(label, p),
        }
    report("next stroke")
    out["next_stroke"] = prediction_scores(*next_stroke_probabilities(models, test), test)
    return out


def _read(rows: Rows, models: FittedModels) -> dict[str, Ints]:
    return {**rows.codes, **models.situations.codes(rows), "next_contact": rows.next_contact}


def next_stroke_probabilities(models: FittedModels, rows: Rows, *, own: bool = True) -> tuple[F64, F64, F64]:
    """Predictions of the behaviour-cloned players for each row.

    Returns:
        ``[N, 13]`` shot type; ``[N, 9]`` area; ``[N, 9]`` area given the actual shot type.
    """
    player = models.choices.index(rows.striker) if own else np.full(len(rows), -1)
    choice = models.choices.shifted_choice(models.choice(rows.codes), rows.codes, player)
    styles = choice.reshape(len(rows), N_SHOTS, N_TECHNIQUES)
    area = np.zeros((len(rows), N_AREAS))
    given = np.zeros((len(rows), N_AREAS))
    for shot in range(N_SHOTS):
        for technique in range(N_TECHNIQUES):
            weight = styles[:, shot, technique]
            asked = np.flatnonzero((weight > 1e-4) | (rows.codes["shot"] == shot))
            codes = {name: code[asked] for name, code in rows.codes.items()}
            codes |= {"shot": np.full(len(asked), shot, np.int16), "technique": np.full(len(asked), technique, np.int16)}
            target = models.choices.shifted_targets(models.targets(codes), codes, player[asked])
            area[asked] += weight[asked, None] * target
            played = rows.codes["shot"][asked] == shot
            share = weight[asked] / np.maximum(styles[asked, shot].sum(axis=1), 1e-12)
            given[asked[played]] += (share[:, None] * target)[played]
    return styles.sum(axis=2), area / area.sum(axis=1, keepdims=True), given / given.sum(axis=1, keepdims=True)


def top_k(probabilities: F64, label: Ints) -> list[float]:
    """Fraction of rows whose label is among the k likeliest classes, for k = 1 to 4."""
    ranked = np.argsort(-probabilities, axis=1, kind="stable")[:, :4]
    hit = ranked == np.asarray(label)[:, None]
    return [float(hit[:, : k + 1].any(axis=1).mean()) for k in range(4)]


def prediction_scores(shot: F64, area: F64, given: F64, rows: Rows) -> dict[str, Any]:
    """Top-1 to top-4 of shot type, area, and area given the shot type; cross-entropies in nats.

    Faults are left out for the area, because their target is unknown, and for ``cross_entropy``, that of shot type and area
    together. ``shot_type_cross_entropy`` is that of the shot type on all strokes.

    Args:
        shot: ``[N, 13]`` probability of each shot type.
        area: ``[N, 9]`` probability of each area.
        given: ``[N, 9]`` probability of each area given the actual shot type.
    """
    good = (rows.outcome != Outcome.FAULT) & (rows.codes["area"] >= 0)
    of_shot = shot[np.arange(len(rows)), rows.codes["shot"]]
    of_area = given[np.flatnonzero(good), rows.codes["area"][good]]
    return {
        "rows": len(rows),
        "shot_type": top_k(shot, rows.codes["shot"]),
        "area": top_k(area[good], rows.codes["area"][good]),
        "area_given_type": top_k(given[good], rows.codes["area"][good]),
        "cross_entropy": float(-(np.log(of_shot[good]) + np.log(of_area)).mean()),
        "shot_type_cross_entropy": float(-np.log(of_shot).mean()),
    }


def tree_predictions(
    names: tuple[str, ...], train: Mapping[str, Ints], label: Bools, match: Ints, test: Mapping[str, Ints]
) -> F64:
    """Predictions of trees; numbers of leaves and rounds are chosen by cross-validation over matches.

    Args:
        names: attributes read by the trees, all categorical.

    Returns:
        ``[M]`` probabilities on the rows of test.
    """
    lgb = lightgbm()
    x, read = (np.stack([codes[name] for name in names], axis=1).astype(np.int32) for codes in (train, test))

    def data() -> Any:
        return lgb.Dataset(x, label.astype(int), categorical_feature=list(range(len(names))), free_raw_data=False)

    # The rows of a single match are distributed over the folds.
    fold = fold_of_match(match if len(np.unique(match)) > 1 else np.arange(len(match)), _FOLDS)
    folds = [(np.flatnonzero(fold != k), np.flatnonzero(fold == k)) for k in np.unique(fold)]
    candidates = []
    for leaves in _LEAVES:
        parameters = {**PARAMETERS, "num_leaves": leaves}
        stopping = lgb.early_stopping(40, verbose=False)
        history: Any = lgb.cv(parameters, data(), num_boost_round=1500, folds=folds, callbacks=[stopping])
        losses = history["valid binary_logloss-mean"]
        candidates.append((losses[-1], leaves, len(losses)))
    _, leaves, rounds = min(candidates)
    booster = lgb.train({**PARAMETERS, "num_leaves": leaves}, data(), num_boost_round=rounds)
    return np.asarray(booster.predict(read), dtype=np.float64)


def play_statistics(policy: StatePolicy) -> dict[str, Any]:
    """Exact mean length and shot mix of rallies in self-play."""
    seen = visits(policy, policy, server=0)
    played = sum(seen.shot_mix(player) * seen.states[player].sum() for player in (0, 1)) / seen.rally_length
    return {
        "mean_rally": seen.rally_length,
        "shot_mix": {name: float(share) for name, share in zip(SHOTS, np.asarray(played), strict=True)},
    }


REQUIRED: Final[dict[str, tuple[float, float]]] = {
    "impossible": (0, 0),
    "minimax_rare": (0.0, 0.1),
    "best_response_rare": (0.0, 0.1),
    "minimax_unsupported": (0.0, 0.1),
    "best_response_unsupported": (0.0, 0.1),
}
"""Limits of the values of :func:`health` that every fit keeps: a game outside of them rewards strokes that nobody plays."""
LIMITS: Final[dict[str, tuple[float, float]]] = {  # limits of the values of :func:`health` without warning
    **REQUIRED,
    # Closer than what a fit must keep: a near tie between strokes of .9 and 30 % moves some points with every few matches.
    "minimax_rare": (0.0, 0.02),
    "best_response_rare": (0.0, 0.02),
    "largest_shot_share": (0.0, 0.5),
    "shot_types_above_2_percent": (7, N_SHOTS),
    "minimax_mean_rally": (5.0, 20.0),
    "largest_continuation": (0.0, 0.997),
    "minimax_thin": (0.0, 0.25),
    "best_response_thin": (0.0, 0.25),
}
THIN: Final = 5.0  # a stroke with fewer real strokes in its innermost cell is thinly supported
_ANY: Final = 0.5  # with fewer real strokes in its innermost cell a stroke has no support; faults count in parts


def health(bc: StatePolicy, strokes: F64) -> dict[str, Any]:
    """Health checks of the solved game: does it resemble badminton?

    Args:
        bc: the behaviour-cloned average player of the game.
        strokes: ``[E]`` real strokes in the innermost cell of each edge.

    Returns: The statistics; ``impossible``: number of base pairs that nobody can play; ``rare``, ``unsupported`` and ``thin``:
        fractions of the strokes of BC, of the best response to BC and of minimax that people hardly play there
        (:func:`shuttle_marl.exact.play.unusual`), without any and with few real strokes behind them; ``warnings``: a line for
        each value outside of :data:`LIMITS`.
    """
    solution, response = solve(bc.game), best_response(bc)
    perfect = play_statistics(solution.policy[0])
    profiles = {"bc": (bc, bc), "best_response": (response.policy, bc), "minimax": solution.policy}
    behind, hardly = strokes[bc.game.base_pair_edge], unusual(bc)
    rare, unsupported, thin = {}, {}, {}
    for name, (policy, opponent) in profiles.items():
        played = visits(policy, opponent).base_pairs(0).sum(axis=0)
        unsupported[name], thin[name] = (float(played[behind < least].sum() / played.sum()) for least in (_ANY, THIN))
        rare[name] = play(policy, opponent, hardly)["rare"]
    figures = {
        "minimax": perfect,
        "value_at_serve": solution.value_at_serve,
        **_variety(perfect),
        "largest_continuation": largest_continuation(bc.game),
        "best_response_to_bc_wins": response.value.odds().rally,
        "bc": play_statistics(bc),
        "impossible": int(impossible(bc.game).sum()),
        "rare": rare,
        "unsupported": unsupported,
        "thin": thin,
    }
    return {**figures, "warnings": [text for text, within in criteria(figures).values() if not within]}


def _variety(perfect: dict[str, Any]) -> dict[str, float]:
    shots = list(perfect["shot_mix"].values())
    return {"largest_shot_share": max(shots), "shot_types_above_2_percent": sum(share > OFTEN for share in shots)}


def variety_of(games: Iterable[Game]) -> dict[str, dict[str, float]]:
    """Median, minimum and maximum over games, such as refits, of the variety of shots of perfect play."""
    found = [_variety(play_statistics(solve(game).policy[0])) for game in games]
    return {
        name: {key: float(of([each[name] for each in found])) for key, of in (("median", np.median), ("low", min), ("high", max))}
        for name in (found[0] if found else ())
    }


def criteria(figures: dict[str, Any], limits: Mapping[str, tuple[float, float]] = LIMITS) -> dict[str, tuple[str, bool]]:
    """For every value of :func:`health` with limits, a description and whether it is within them."""
    limited = {**figures, "minimax_mean_rally": figures["minimax"]["mean_rally"]}
    for name in ("rare", "unsupported", "thin"):
        limited |= {f"{who}_{name}": share for who, share in figures[name].items()}
    return {
        name: (f"{name.replace('_', ' ')}: {limited[name]:.4g}, expected {low:g} to {high:g}", low <= limited[name] <= high)
        for name, (low, high) in limits.items()
    }


def play_of_people(rows: Rows) -> dict[str, Any]:
    """The play of people.

    Args:
        rows: strokes of whole matches in playing order. A dropped stroke ends a run of net shots.

    Returns:
        The figures of :func:`shuttle_marl.exact.play.mix`, targets without those of faults, and ``length``: mean number of
        strokes of the rallies whose end is known, 0 without any.
    """
    code = {name: rows.codes[name].astype(np.int64) for name in ("shot", "area", "incoming_shot")}
    follows = (np.diff(rows.stroke, prepend=0) == 1) & (np.diff(rows.match, prepend=-1) == 0)
    fault = rows.outcome == Outcome.FAULT
    ends = rows.stroke[fault | (rows.outcome == Outcome.WINNER)]
    figures = mix(
        code["shot"],
        np.where(fault, -1, code["area"]),
        code["incoming_shot"],
        rows.codes["contact"] == 1,
        np.ones(len(rows)),
        float(in_cross_court_runs(code["shot"], follows).sum()),
    )
    return {**figures, "length": float(ends.mean()) if len(ends) else 0.0}


_SCORED: Final = ("success", "return", "contact", "hurried")
_TEMPLATES: Final = Path(__file__).with_name("templates")


def write_card(folder: Path, card: dict[str, Any]) -> None:
    """Write the card of a model with the hashes of its files. Raises FileWriteError: it cannot be written."""
    files = [*FILES, *(name for name in OPTIONAL_FILES if (folder / name).is_file())]
    replace_sealed(folder / CARD, with_hashes(card, {name: (folder / name).read_bytes() for name in files}))


def add_truth(folder: Path, truth: dict[str, Any]) -> None:
    """Store the result of ``experiments.truth --json`` in the card of a model. Raises ShuttleError: the result lacks a field.
    Raises GameError: the model card cannot be read. Raises FileWriteError: it cannot be written."""
    wanted = ("split", "cross", "train_only", "matches", "strokes", "decision_slope", "promised_realised")
    if missing := [name for name in wanted if name not in truth]:
        raise ShuttleError(f"not a result of experiments.truth: {', '.join(missing)} missing; create one with --json")
    write_card(folder, {**read_model_card(folder), "truth": {name: truth[name] for name in wanted}})


def as_markdown(card: dict[str, Any]) -> str:
    """The card as Markdown."""
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"as": format, "percent": lambda share: f"{100 * share:.1f} %"}
    return environment.get_template("card.md").render(
        card=card,
        scored={name: card["validation"][name] for name in _SCORED if name in card["validation"]},
        criteria=criteria(card["health"]).values(),
        networks=NETWORKS,
        prior_strokes=PRIOR_STROKES,
        credible=CREDIBLE,
        min_end=MIN_END,
        shots=SHOTS,
        exp=math.exp,
    )
