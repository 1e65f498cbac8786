"""The index of hurried strikers: planted signals, tables that know them, data without positions, files; and hurried receivers."""

import dataclasses
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.data import load_strokes
from shuttle_marl.data.schema import REASONS, STROKES, Outcome
from shuttle_marl.dynamics.features import MOVEMENT, Rows, rows_from_strokes
from shuttle_marl.dynamics.fit import _fit_hurried
from shuttle_marl.dynamics.hurried import SHARE, Hurry, fit_hurry
from shuttle_marl.dynamics.models import HURRIED, sigmoid, was_timed
from shuttle_marl.game.stroke import SHOTS
from tests.dynamics.rows import plain_rows

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
N, MATCHES = 12_000, 24
NET, LIFT = SHOTS.index("net-shot"), SHOTS.index("lift")


def strokes() -> tuple[Rows, Bools]:
    """Replies to net shots and lifts, which fault often where the shuttle is met far from the striker; and where that is."""
    rng = np.random.default_rng(5)
    codes = {name: rng.choice([NET, LIFT], N).astype(np.int16) for name in ("incoming_shot", "shot")}
    codes["area"] = rng.integers(0, 9, N).astype(np.int16)
    movement = rng.normal(size=(N, len(MOVEMENT))).astype(np.float32)
    reach = movement[:, MOVEMENT.index("reach")]
    late = reach > np.quantile(reach, 1 - SHARE)
    movement[::50, 3] = np.nan
    outcome = np.where(rng.random(N) < np.where(late, 0.35, 0.05), Outcome.FAULT, Outcome.RETURNED).astype(np.int8)
    returned = outcome == Outcome.RETURNED
    unknown = np.full(N, -1, dtype=np.int8)
    rows = plain_rows(
        N,
        codes=codes,
        outcome=outcome,
        reason=np.where(returned, REASONS.index("returned"), REASONS.index("net")).astype(np.int8),
        next_contact=np.where(returned, rng.integers(0, 2, N), -1).astype(np.int8),
        match=(np.arange(N) * MATCHES // N).astype(np.int32),
        matches=tuple(f"match {k}" for k in range(MATCHES)),
        movement=movement,
        hurried=unknown,
        next_hurried=unknown,
    )
    return rows, late


@pytest.fixture(scope="module")
def fitted() -> tuple[Rows, Bools, Hurry]:
    rows, late = strokes()
    hurry = fit_hurry(rows)
    assert hurry is not None
    return rows, late, hurry


def test_late_strikers_are_found_in_matches_of_the_fit_and_in_others(fitted: tuple[Rows, Bools, Hurry]) -> None:
    rows, late, hurry = fitted
    elsewhere = dataclasses.replace(rows, matches=tuple(f"other {name}" for name in rows.matches))
    for part in (rows, elsewhere):
        bits = hurry.bits(part)
        known = bits >= 0
        assert (known == np.isfinite(rows.movement).all(axis=1)).all()
        assert (bits[known] == 1).mean() == pytest.approx(SHARE, abs=0.02)
        assert ((bits[known] == 1) == late[known]).mean() > 0.93
    some = rows.match == 3
    assert hurry.fold[3] == 3
    assert np.array_equal(hurry.bits(rows.take(some)), hurry.bits(rows)[some])


def test_a_table_without_positions_knows_no_hurried_striker() -> None:
    table = load_strokes(SAMPLE)
    places = [name for name in table.column_names if name.endswith(("_x", "_y")) or name == "hurried"]
    for name in places:
        field = STROKES.field(name)
        table = table.set_column(table.column_names.index(name), field, pa.nulls(len(table), field.type))
    rows = rows_from_strokes(table)
    assert np.isnan(rows.movement).any(axis=1).all()
    assert ((rows.hurried == 0) == (rows.stroke == 1)).all(), "serves are never hurried"
    assert not rows.codes["hurried"].any()
    assert (rows.next_hurried == -1).all()


def test_movement_is_in_the_frame_of_the_striker() -> None:
    table = load_strokes(SAMPLE).slice(0, 2)
    rows = rows_from_strokes(table)
    serve, reply = table.to_pylist()
    found = dict(zip(MOVEMENT, rows.movement[1].tolist(), strict=True))
    assert np.isnan(rows.movement[0]).any()
    assert found["own_y"] == pytest.approx(-serve["receiver_y"])
    assert found["forward"] == pytest.approx(reply["striker_y"] + serve["receiver_y"], abs=1e-5)
    assert found["sideways"] == pytest.approx(reply["striker_x"] + serve["receiver_x"], abs=1e-5)
    assert found["opponent_x"] == pytest.approx(-serve["striker_x"])
    assert found["before"] == 0
    assert found["since"] > 0


def test_an_index_is_the_same_after_saving(fitted: tuple[Rows, Bools, Hurry], tmp_path: Path) -> None:
    rows, _, hurry = fitted
    hurry.save(tmp_path / "hurry.safetensors")
    tensors = read_tensors(tmp_path / "hurry.safetensors")
    assert np.array_equal(Hurry.checked(tensors).bits(rows), hurry.bits(rows))
    for name, broken in (("child", hurry.child * 0), ("attribute", hurry.attribute + 99), ("cut", hurry.cut * np.nan)):
        with pytest.raises(ValueError, match=r"."):
            Hurry.checked(tensors._replace(arrays={**tensors.arrays, name: broken}))


def test_chances_of_hurried_receivers_are_recovered() -> None:
    rows, _ = strokes()
    rng = np.random.default_rng(1)
    chance: F64 = np.where(rows.codes["area"] < 3, 0.4, 0.1) + 0.2 * rows.next_contact * (rows.codes["hurried"] == 0)
    said = np.where(rows.next_contact >= 0, rng.random(N) < chance, -1).astype(np.int8)
    rows = dataclasses.replace(rows, next_hurried=said)
    met = rows.take(was_timed(rows))
    trees, lines = _fit_hurried(met)
    assert set(trees) == set(HURRIED)
    for contact, name in enumerate(HURRIED):
        those = met.next_contact == contact
        p = sigmoid(lines[contact, 0] * trees[name].logits(met.take(those).codes) + lines[contact, 1])
        assert p.mean() == pytest.approx((met.next_hurried[those] == 1).mean(), abs=0.01)
        assert np.abs(p - chance[was_timed(rows)][those]).mean() < 0.04
