"""Hurried strikers, effort and long duels: planted signals are recovered, and strokes of a rally are counted."""

import dataclasses
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from scipy.special import expit

from shuttle_marl.base.arrays import Bools
from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.data import read_matches
from shuttle_marl.data.schema import REASONS, STROKES, Outcome
from shuttle_marl.dynamics.boosting import SHARE, fit_hurry
from shuttle_marl.dynamics.features import MOVEMENT, SLOTS, Hurry, Rows, rows_from_strokes
from shuttle_marl.dynamics.models import fit_situations
from shuttle_marl.dynamics.modules import Situations
from shuttle_marl.game.stroke import SHOTS
from tests import golden
from tests.dynamics.rows import plain_rows

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"
N, MATCHES = 6_000, 12
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
    return rows, late, hurry


def test_late_strikers_are_found_in_matches_of_the_fit_and_in_others(fitted: tuple[Rows, Bools, Hurry]) -> None:
    rows, late, hurry = fitted
    elsewhere = dataclasses.replace(rows, matches=tuple(f"other {name}" for name in rows.matches))
    own = hurry.bits(rows)
    for bits in (own, hurry.bits(elsewhere)):
        known = bits >= 0
        assert (known == np.isfinite(rows.movement).all(axis=1)).all()
        assert (bits[known] == 1).mean() == pytest.approx(SHARE, abs=0.02)
        assert ((bits[known] == 1) == late[known]).mean() > 0.93
    golden.check("dynamics", {"hurried": golden.weighted_sum(own)})
    some = rows.match == 3
    assert hurry.fold[3] == 3
    assert np.array_equal(hurry.bits(rows.take(some)), own[some])


def test_a_table_without_positions_knows_no_hurried_striker() -> None:
    table = read_matches(SAMPLE)
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
    table = read_matches(SAMPLE).slice(0, 2)
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


SERVE, SMASH, NETTED, CROSS, LIFTED = (
    SHOTS.index(shot) for shot in ("short-serve", "smash", "net-shot", "cross-court-net-shot", "lift")
)


def rally(shots: list[int]) -> pa.Table:
    """The first rally of the sample that is as long, with other shot types."""
    table = read_matches(SAMPLE)
    key = np.stack([table[name].to_numpy(zero_copy_only=False) for name in ("game", "rally", "stroke")])
    starts = np.flatnonzero(key[2] == 1)
    lengths = np.diff(np.r_[starts, len(table)])
    part = table.slice(int(starts[lengths >= len(shots)][0]), len(shots))
    column = part.schema.get_field_index("shot")
    return part.set_column(column, part.schema.field(column), pa.array(shots, part.schema.field(column).type))


def counts(table: pa.Table) -> list[list[int]]:
    rows = rows_from_strokes(table)
    return [getattr(rows, name).tolist() for name in ("attacks", "opponent_attacks", "net_run")]


def test_attacks_and_net_shots_of_a_rally_are_counted() -> None:
    """A dropped row may have been an attack and a net shot: both are unknown from there on, but a serve is neither."""
    table = rally([SERVE, LIFTED, SMASH, NETTED, CROSS, NETTED, NETTED, LIFTED, SMASH])
    whole = [[0, 0, 0, 0, 1, 0, 1, 0, 1], [0, 0, 0, 1, 0, 1, 0, 1, 0], [0, 0, 0, 0, 1, 2, 3, 4, 0]]
    assert counts(table) == whole
    assert counts(table.slice(1)) == [part[1:] for part in whole]
    without = pa.concat_tables([table.slice(0, 3), table.slice(4)])
    assert counts(without) == [[0, 0, 0, 1, -1, 1, -1, 1], [0, 0, 0, -1, 1, -1, 1, -1], [0, 0, 0, -1, -1, -1, -1, 0]]


def simulated(count: int, effort: float, duel: float) -> tuple[np.ndarray, np.ndarray, Rows]:
    """Logits of two targets, their shares, and rows whose faults follow them with planted offsets."""
    rng = np.random.default_rng(3)
    logit, share = rng.normal(-2.0, 0.8, (count, 2)), rng.dirichlet([2.0, 1.0], count)
    attacks = np.where(rng.random(count) < 0.05, -1, rng.poisson(0.7, count)).astype(np.int16)
    run = rng.integers(-1, 6, count).astype(np.int16)
    shot = rng.choice([NETTED, LIFTED], count).astype(np.int16)
    # Unknown rows fault more often than their counts would say: taken for zero they would spoil the fit.
    hidden = np.where(attacks < 0, 2, np.minimum(attacks, 2))
    offset = effort * hidden + duel * ((shot == NETTED) & (run >= 3))
    fault = rng.random(count) < (share * expit(0.8 * logit - 0.3 + offset[:, None])).sum(axis=1)
    rows = plain_rows(
        count,
        codes={"shot": shot},
        outcome=np.where(fault, Outcome.FAULT, Outcome.RETURNED).astype(np.int8),
        match=(np.arange(count) // 600).astype(np.int32),
        matches=tuple(map(str, range(count // 600 + 1))),
        attacks=attacks,
        opponent_attacks=attacks,
        net_run=run,
    )
    return logit, share, rows


def test_a_planted_fatigue_is_recovered() -> None:
    logit, share, rows = simulated(60_000, effort=0.25, duel=0.6)
    line, found = fit_situations(logit, share, rows, levels=3)
    assert line == pytest.approx([0.8, -0.3], abs=0.08)
    assert found.effort == pytest.approx([0, 0.25, 0.5], abs=0.06)
    assert found.duel == pytest.approx(0.6, abs=0.1)
    assert found.duel_share == pytest.approx(3 / 4, abs=0.02)
    assert found.effort_share[0] == pytest.approx(np.exp(-0.7) * np.array([1, 0.7, np.exp(0.7) - 1.7]), abs=0.01)


def test_what_is_not_known_is_averaged_over() -> None:
    shares = np.zeros((SLOTS["own_shot"], 3))
    shares[:] = (0.7, 0.2, 0.1)
    unknown = np.zeros((SLOTS["incoming_shot"], SLOTS["shot"]))
    situations = Situations(
        effort=np.array([0.0, 0.1, 0.2]), duel=0.5, effort_share=shares, duel_share=0.25, hurried_share=unknown
    )
    rows = simulated(2000, effort=0.0, duel=0.0)[2]
    weights = situations.weights(rows)
    assert weights.sum(axis=1) == pytest.approx(1)
    known = (rows.attacks >= 0) & (rows.net_run >= 0)
    assert (np.sort(weights[known])[:, -1] == 1).all()
    long = known & (rows.net_run >= 3) & (rows.codes["shot"] == NETTED) & (rows.attacks == 1)
    assert long.any()
    assert situations.mixed(np.zeros(len(rows)), weights)[long] == pytest.approx(expit(0.6))
    neither = (rows.attacks < 0) & (rows.net_run < 0) & (rows.codes["shot"] == NETTED)
    assert neither.any()
    assert weights[neither] == pytest.approx(np.outer(np.ones(neither.sum()), [0.525, 0.15, 0.075, 0.175, 0.05, 0.025]))
