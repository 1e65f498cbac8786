"""The imitator: its inputs, independence of the future, determinism, and learning from a small sample."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from experiments import next_stroke
from experiments.imitation.context import CODES, hit_contexts
from experiments.imitation.imitator import Imitator, ImitatorConfig
from experiments.imitation.match_adaptation import adapt_to_match
from experiments.imitation.networks import NetworksConfig
from experiments.imitation.trees import TreesConfig
from shuttle_marl.data import load_strokes
from shuttle_marl.data.schema import STROKES, Outcome
from shuttle_marl.dynamics.fitted import FittedModels
from shuttle_marl.game import model_folder
from shuttle_marl.game.stroke import SHOTS

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
SMALL = ImitatorConfig(
    networks=NetworksConfig(members=2, epochs=8, batch=128, learning_rate=0.02, width=32, layers=2),
    trees=TreesConfig(type_rounds=15, area_rounds=5, leaves=7, rate=0.3),
)
AFTER = (
    "shot", "technique", "area", "label_area", "landing_x", "landing_y", "in_court", "outcome", "reason", "points",
    "points_opponent",
)  # fmt: skip
"""Columns that describe the stroke itself or its outcome."""


@pytest.fixture(scope="module")
def strokes() -> pa.Table:
    return load_strokes(SAMPLE).slice(0, 1000)


@pytest.fixture(scope="module")
def imitator(strokes: pa.Table) -> Imitator:
    return Imitator.fit(strokes, config=SMALL)


def changed_after(strokes: pa.Table, row: int) -> pa.Table:
    """The table with everything after the hit of a row changed: the stroke, its outcome, and all later rows."""
    rng = np.random.default_rng(row)
    later = np.arange(strokes.num_rows) > row
    columns = {}
    for field in STROKES:
        values = strokes[field.name]
        if field.name in ("match", "source", "discipline", "player", "opponent"):
            columns[field.name] = values
            continue
        shuffled = values.take(pa.array(rng.permutation(strokes.num_rows)))
        change = later | (np.arange(strokes.num_rows) == row) if field.name in AFTER else later
        columns[field.name] = pa.compute.if_else(pa.array(change), shuffled, values).cast(field.type)
    return pa.table(columns, schema=STROKES)


@pytest.mark.parametrize("row", [0, 1, 5, 700, 900])
def test_nothing_after_the_hit_changes_a_prediction(strokes: pa.Table, imitator: Imitator, row: int) -> None:
    changed = changed_after(strokes, row)
    for name in ("shot", "landing_x", "outcome", "frame"):
        assert changed[name].slice(row).to_pylist() != strokes[name].slice(row).to_pylist()
    for height_known in (True, False):
        before = imitator.predict(strokes, height_known=height_known)[: row + 1]
        np.testing.assert_allclose(imitator.predict(changed, height_known=height_known)[: row + 1], before, atol=1e-12)
    # Also inputs that no network of this fit happens to use.
    np.testing.assert_array_equal(hit_contexts(changed).codes[: row + 1], hit_contexts(strokes).codes[: row + 1])
    np.testing.assert_array_equal(hit_contexts(changed).numbers[: row + 1], hit_contexts(strokes).numbers[: row + 1])


@pytest.mark.parametrize("row", [0, 5, 900])
def test_nothing_after_the_hit_changes_an_adapted_prediction(strokes: pa.Table, imitator: Imitator, row: int) -> None:
    changed = changed_after(strokes, row)
    before, after = (adapt_to_match(imitator.predict(table), table)[: row + 1] for table in (strokes, changed))
    np.testing.assert_allclose(after, before, atol=1e-12)


def test_a_match_corrects_what_it_contradicts(strokes: pa.Table) -> None:
    """Half of the pushes of a match are called drives in it: what was predicted as a push is soon thought to be either."""
    match = strokes.filter(pa.compute.equal(strokes["match"], strokes["match"][0]))
    shot, area = np.array(match["shot"]), np.array(match["area"])
    told = np.full((len(match), 13, 9), 1e-6)
    told[np.arange(len(match)), shot, area] = 1
    told /= told.sum(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(adapt_to_match(told, match), told, atol=1e-3, err_msg="correct predictions stay")
    push, drive = SHOTS.index("push"), SHOTS.index("drive")
    told[:, drive] += 0.05 * told[:, push]
    told /= told.sum(axis=(1, 2), keepdims=True)
    renamed = np.where((shot == push) & (np.cumsum(shot == push) % 2 == 0), drive, shot)
    called = match.set_column(match.schema.get_field_index("shot"), STROKES.field("shot"), pa.array(renamed, pa.int8()))
    corrected = adapt_to_match(told, called).sum(axis=2)
    np.testing.assert_allclose(corrected.sum(axis=1), 1)
    late = np.flatnonzero(shot == push)[-5:]
    assert told.sum(axis=2)[late, drive].max() < 0.05
    assert corrected[late, drive].min() > 0.1


def test_positions_are_in_the_frame_of_the_striker(strokes: pa.Table) -> None:
    contexts = hit_contexts(strokes)
    row = strokes["stroke"].to_pylist().index(4)
    now, incoming, own = (strokes.slice(row - lag, 1).to_pylist()[0] for lag in (0, 1, 2))
    numbers = contexts.numbers[row]
    assert numbers[:2] == pytest.approx([now["striker_x"], now["striker_y"]])
    assert numbers[2:4] == pytest.approx([-incoming["receiver_x"], -incoming["receiver_y"]])
    assert numbers[4:6] == pytest.approx([own["striker_x"], own["striker_y"]])
    assert numbers[10:12] == pytest.approx([now["receiver_x"], now["receiver_y"]])
    assert numbers[30] == pytest.approx((now["frame"] - incoming["frame"]) / 30)
    assert contexts.codes[row, list(CODES).index("shot_1")] == incoming["shot"]
    assert contexts.codes[row, list(CODES).index("area_2")] == own["area"]


def test_probabilities_sum_to_one_and_serves_are_serves(strokes: pa.Table, imitator: Imitator) -> None:
    probability = imitator.predict(strokes)
    assert probability.shape == (strokes.num_rows, 13, 9)
    assert probability.min() >= 0
    np.testing.assert_allclose(probability.sum(axis=(1, 2)), 1)
    served = np.array(strokes["stroke"]) == 1
    assert probability[served, :2].sum(axis=(1, 2)).mean() > 0.9
    assert probability[~served, :2].sum(axis=(1, 2)).mean() < 0.1


def test_areas_of_faults_are_not_learned(strokes: pa.Table) -> None:
    part = strokes.slice(0, 600)
    fault = np.array(part["outcome"]) == Outcome.FAULT
    assert fault.any()
    areas = np.where(fault, (np.array(part["area"].fill_null(0)) + 4) % 9, np.array(part["area"].fill_null(0)))
    # A fault ends its rally, so no other stroke sees its area.
    moved = part.set_column(part.schema.get_field_index("area"), STROKES.field("area"), pa.array(areas, pa.int8()))
    fits = [Imitator.fit(table, config=SMALL).predict(part) for table in (part, moved)]
    assert np.array_equal(fits[0], fits[1])


def test_table_of_the_next_stroke(strokes: pa.Table, imitator: Imitator) -> None:
    part = strokes.slice(0, 300)
    result = json.loads(json.dumps(next_stroke.table(imitator, FittedModels.load(model_folder()), part)))
    assert list(result["rows"]) == ["all strokes", "rally strokes", "rally strokes, contact height not known"]
    for group in result["rows"].values():
        assert list(group) == ["imitator, match watched", "imitator", "own clone", "average clone"]
        for scores in group.values():
            for key in next_stroke.COLUMNS:
                assert len(scores[key]) == 4
                assert (np.diff(scores[key]) >= 0).all()
    alone, hidden = (result["rows"][name]["average clone"] for name in list(result["rows"])[1:])
    assert result["rows"]["all strokes"]["imitator"]["rows"] == len(part) > alone["rows"] == hidden["rows"]
    assert hidden["shot_type_cross_entropy"] > alone["shot_type_cross_entropy"], "the height tells something"
    lines = next_stroke.table_rows({**result, "paper": next_stroke.PAPER})
    assert len(lines) == 12 + 2 * len(result["players"]) + 2
    assert {len(line) for line in lines} == {len(next_stroke.HEADINGS)}
