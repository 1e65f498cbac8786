"""Trees beside the networks: the arrays say what LightGBM says, and files with other arrays are refused."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import expit, logit

from shuttle_marl.data import load_strokes
from shuttle_marl.dynamics.card import write_card
from shuttle_marl.dynamics.features import Rows, rows_from_strokes
from shuttle_marl.dynamics.fitted import FittedModels, ModelError
from shuttle_marl.dynamics.models import ridge_logits
from shuttle_marl.dynamics.trees import INPUTS, PARAMETERS, Trees, fit_trees
from shuttle_marl.game import model_folder
from shuttle_marl.game.shipped import read_model_card

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"


def sample() -> tuple[Rows, np.ndarray, np.ndarray]:
    """Strokes, and labels that depend on two attributes together."""
    rows = rows_from_strokes(load_strokes(SAMPLE))
    truth = expit(np.where((rows.codes["shot"] % 3 == 0) ^ (rows.codes["contact"] == 1), 1.5, -1.5))
    return rows, np.random.default_rng(2).random(len(rows)) < truth, truth


def test_arrays_say_what_the_library_says() -> None:
    lightgbm = pytest.importorskip("lightgbm")
    rows, label, truth = sample()
    trees = fit_trees(rows.codes, label, leaves=6, rounds=40)
    x = np.stack([rows.codes[name] for name in INPUTS], axis=1).astype(np.int32)
    data = lightgbm.Dataset(x, label.astype(int), categorical_feature=list(range(len(INPUTS))))
    booster = lightgbm.train({**PARAMETERS, "num_leaves": 6}, data, num_boost_round=40)
    assert np.abs(booster.predict(x, raw_score=True) - trees.logits(rows.codes)).max() < 1e-12
    assert np.abs(expit(trees.logits(rows.codes)) - truth).mean() < 0.1
    again = fit_trees(rows.codes, label, leaves=6, rounds=40)
    assert all(np.array_equal(value, vars(again)[name]) for name, value in vars(trees).items())


def test_blends_are_means_of_logits() -> None:
    """Trees have a third of the weight in the return, where there is a ridge regression too, and half of it in the contact."""
    rows, label, _ = sample()
    rows = rows.take(np.arange(2000))
    codes, trees = rows.codes, fit_trees(rows.codes, label[:2000], rounds=10)
    models = FittedModels.load(model_folder())
    models = dataclasses.replace(models, trees={"return": trees, "contact": trees}, calibration=np.tile([1.0, 0.0], (5, 1)))
    of_trees, ridge = trees.logits(codes), ridge_logits(models.ridge, codes)
    of_return, of_contact = (models.networks[name].logits(codes)[..., 0] for name in ("return", "contact"))
    assert models.returned(codes) == pytest.approx(expit((of_return + ridge + of_trees) / 3).mean(axis=0))
    assert models.above(codes) == pytest.approx(expit((of_contact + of_trees) / 2).mean(axis=0))


def test_trees_correct_a_fault_at_every_target_alike() -> None:
    rows, label, truth = sample()
    offset = np.full(len(rows), -0.5)
    trees = fit_trees(rows.with_area(0), label, rounds=200, offset=offset)
    assert np.abs(expit(offset + trees.logits(rows.codes)) - truth).mean() < 0.1
    part = rows.take(np.arange(500))
    assert np.array_equal(trees.logits(part.with_area(1)), trees.logits(part.with_area(8)))
    models = dataclasses.replace(FittedModels.load(model_folder()), trees={})
    corrected = dataclasses.replace(models, trees={"success": trees})
    for area in (1, 8):
        codes = part.with_area(area)
        moved = logit(corrected.fault(codes)) - logit(models.fault(codes))
        assert moved == pytest.approx(trees.logits(codes), abs=1e-6)


def with_trees(folder: Path, trees: dict[str, Trees]) -> Path:
    """A copy of the shipped model, with other trees."""
    shutil.copytree(model_folder(), folder / "model", ignore=shutil.ignore_patterns("agents"))
    dataclasses.replace(FittedModels.load(model_folder()), trees=trees).save(folder / "model")
    write_card(folder / "model", read_model_card(model_folder()))
    return folder / "model"


def test_trees_are_stored_with_the_model(tmp_path: Path) -> None:
    rows, label, _ = sample()
    trees = fit_trees(rows.codes, label, rounds=10)
    loaded = FittedModels.load(with_trees(tmp_path, {"contact": trees})).trees
    assert set(loaded) == {"contact"}
    assert np.array_equal(loaded["contact"].logits(rows.codes), trees.logits(rows.codes))


@pytest.mark.parametrize(("name", "change"), [
    ("attribute", lambda a: a * 0 + len(INPUTS)),
    ("child", lambda a: a * 0),
    ("child", lambda a: a * 0 - 1000),
    ("value", lambda a: a * np.nan),
    ("value", lambda a: a[:1]),
])  # fmt: skip
def test_forged_trees_are_refused(tmp_path: Path, name: str, change: Any) -> None:
    rows, label, _ = sample()
    trees = fit_trees(rows.codes, label, rounds=5)
    changed = dataclasses.replace(trees, **{name: np.ascontiguousarray(change(getattr(trees, name)))})
    folder = with_trees(tmp_path, {"return": changed})
    with pytest.raises(ModelError, match="networks"):
        FittedModels.load(folder)
