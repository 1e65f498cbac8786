"""Fits to the simulated sample, and the shipped models, compared with golden files."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.data import read_matches
from shuttle_marl.dynamics.choices import fit_history, player_choices
from shuttle_marl.dynamics.compiled import codes_of_pairs, layouts_of, support_of
from shuttle_marl.dynamics.evaluate import evaluate
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.dynamics.habits import plays_of_strokes, tally
from shuttle_marl.dynamics.models import (
    EnsembleConfig,
    all_targets,
    fit_binary,
    fit_choice,
    fit_success,
    fit_target,
    intended_targets,
    judged,
    mean_probabilities,
)
from shuttle_marl.game.shipped import default_game, load_game, model_folder
from tests import golden

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"


@pytest.fixture(scope="module")
def models() -> FittedModels:
    return FittedModels.load(model_folder())


@pytest.fixture(scope="module")
def rows() -> Rows:
    found = rows_from_strokes(read_matches(SAMPLE))
    return found.take(found.match % 2 == 0)


def sums(value: Any) -> Any:
    """Weighted sums of the arrays of a structure, and of the masks of their finite numbers."""
    if dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value) if field.init}
    if isinstance(value, Mapping):
        return {str(name): sums(each) for name, each in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        known = np.isfinite(value)
        return [*value.shape, golden.weighted_sum(known.ravel() + 0.0), golden.weighted_sum(np.where(known, value, 0.0).ravel())]
    return None


def test_codes_and_places_of_the_sample(rows: Rows) -> None:
    golden.check("dynamics", {"rows": sums(rows)}, 1e-3)


def test_habits_of_the_sample() -> None:
    golden.check("dynamics", {"habits": sums(tally(plays_of_strokes(read_matches(SAMPLE))))})


@pytest.mark.parametrize("opposite", [False, True])
def test_chances_of_the_shipped_models(opposite: bool, models: FittedModels) -> None:
    game = load_game("default:opposite" if opposite else "default")
    models = dataclasses.replace(models, opposite=opposite)
    codes = codes_of_pairs(game, np.random.default_rng(0).integers(0, game.n_base_pairs, 300), opposite=opposite)
    parts = (models.targets, models.choice, models.fault, models.returned, models.above, models.hurried)
    found = {part.__name__: sums(models.averaged(part, codes)) for part in parts}
    choices = models.choices
    players = np.arange(300) % len(choices.players)
    found["of players"] = [
        sums(shifted(average(codes | {"discipline": np.ones(300, np.int16)}), codes, players))
        for shifted, average in ((choices.shifted_choice, models.choice), (choices.shifted_targets, models.targets))
    ]
    golden.check("dynamics", {f"chances, {opposite=}": found})


def test_networks_after_one_epoch(models: FittedModels, rows: Rows) -> None:
    """Logits of targets, success with unknown targets, returns and choices, for fixed seeds."""
    config = EnsembleConfig(epochs=1, batch=512, folds=2, members=2)
    parts = judged(rows)
    (known, _), (good, returned) = parts["success"], parts["return"]
    target = fit_target(rows, intended_targets(models.m_target, models.m_succ.network, rows), config, 1)
    success = fit_success(known, mean_probabilities(target, known.codes), config, 2)
    found = {
        "target": target.logits(known.codes),
        "success": all_targets(success, known),
        "return": fit_binary("return", good, returned, config, 3).logits(known.codes),
        "choice": fit_choice(rows, config, 4).logits(known.codes),
    }
    golden.check("dynamics", {"after one epoch": {name: sums(logits[:, ::10]) for name, logits in found.items()}}, 1e-2)


def test_support_and_layout_of_the_sample(models: FittedModels, rows: Rows) -> None:
    game = default_game()
    support = support_of(rows, intended_targets(models.m_target, models.m_succ.network, rows), game)
    between = [sums(layout) for layout in layouts_of(rows, models)]
    golden.check("dynamics", {"support": sums(support), "layouts": between})


def test_scores_and_choices_of_players_of_the_sample(models: FittedModels, rows: Rows) -> None:
    last = rows.match == rows.match.max()
    train, validation = rows.take(~last), rows.take(last)
    choices, chosen = player_choices(models.choosers, train, validation, 5)
    shifts, scores = fit_history(models.choosers, train, validation, 5)
    found = evaluate(models, train, validation, report=lambda line: None)
    golden.check("dynamics", {"choices": [sums(choices), chosen], "history": [sums(shifts), scores], "scores": found}, 1e-4)
