"""Hurried strikers, effort and long duels: planted signals are recovered, and compiled games keep what the data bounds."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pytest
from scipy.special import expit

from shuttle_marl.base.arrays import F64, Bools
from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.data import read_matches
from shuttle_marl.data.schema import REASONS, STROKES, Outcome
from shuttle_marl.dynamics.compiled import (
    MIN_END,
    Support,
    compile_game,
    is_duel_pair,
    is_long_duel_pair,
    is_serve_pair,
    pair_probabilities,
)
from shuttle_marl.dynamics.features import MOVEMENT, SLOTS, Rows, rows_from_strokes, states_of
from shuttle_marl.dynamics.fit import _fit_hurried, _hurried_lines, _out_of_fold_hurried
from shuttle_marl.dynamics.hurried import SHARE, Hurry, fit_hurry
from shuttle_marl.dynamics.models import HURRIED, sigmoid, was_timed
from shuttle_marl.dynamics.situations import Situations, _hurried_shares, fit_situations
from shuttle_marl.game.stroke import SHOTS, Catalogue
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import layout
from shuttle_marl.game.thresholds import ONE
from tests import golden
from tests.dynamics.rows import plain_rows
from tests.exact.exact_games import game_without_outcomes

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
    golden.check("dynamics", {"hurried": golden.weighted_sum(hurry.bits(rows))})
    some = rows.match == 3
    assert hurry.fold[3] == 3
    assert np.array_equal(hurry.bits(rows.take(some)), hurry.bits(rows)[some])


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


def test_chances_of_hurried_receivers_are_recovered() -> None:
    rows, _ = strokes()
    rng = np.random.default_rng(1)
    chance: F64 = np.where(rows.codes["area"] < 3, 0.4, 0.1) + 0.2 * rows.next_contact * (rows.codes["hurried"] == 0)
    said = np.where(rows.next_contact >= 0, rng.random(N) < chance, -1).astype(np.int8)
    rows = dataclasses.replace(rows, next_hurried=said)
    met = rows.take(was_timed(rows))
    trees, late = _fit_hurried(met, met.next_hurried == 1), met.next_hurried == 1
    lines = _hurried_lines(_out_of_fold_hurried(met, late), met, late)
    assert set(trees) == set(HURRIED)
    golden.check("dynamics", {"lines of hurried receivers": lines})
    for contact, name in enumerate(HURRIED):
        those = met.next_contact == contact
        p = sigmoid(lines[contact, 0] * trees[name].logits(met.take(those).codes) + lines[contact, 1])
        assert p.mean() == pytest.approx((met.next_hurried[those] == 1).mean(), abs=0.01)
        assert np.abs(p - chance[was_timed(rows)][those]).mean() < 0.04


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


def duel_game(levels: int) -> Game:
    """A serve, two net shots, a lift and a smash; anything answers anything, and nothing else happens."""
    names = (
        "short-serve:front-centre:below:backhand",
        "lift:back-centre:below:forehand",
        "smash:middle-left:above:forehand",
        "net-shot:front-centre:below:forehand",
        "cross-court-net-shot:front-left:below:forehand",
    )
    replies = np.array([[0, 1, 1, 1, 1]] * 5 + [[1, 0, 0, 0, 0]], dtype=bool)
    tables = layout(Catalogue.from_names(names), replies, duels=True)
    return game_without_outcomes(Catalogue.from_names(names), tables, [ONE] * levels)


@pytest.mark.parametrize("levels", [1, 3])
def test_states_of_recorded_strokes_hold_effort_and_duel(levels: int) -> None:
    game = duel_game(levels)
    table = rally([SERVE, LIFTED, SMASH, NETTED, CROSS, NETTED, NETTED, LIFTED, SMASH])
    for dropped in (None, 3):
        part = table if dropped is None else pa.concat_tables([table.slice(0, dropped), table.slice(dropped + 1)])
        rows = rows_from_strokes(part)
        index = np.array([0, 1, 2, 3, 4, 3, 3, 1, 2])
        kept = np.delete(np.arange(9), [] if dropped is None else dropped)
        own, incoming = (np.append(index, 5)[np.maximum(kept - lag, -1)] for lag in (2, 1))
        state = states_of(game, rows, own, incoming)
        counted = (rows.attacks >= 0) & (rows.opponent_attacks >= 0) if levels > 1 else rows.attacks < 99
        assert ((state >= 0) == (counted & (rows.net_run >= 0))).all()
        known = state[state >= 0]
        assert game.effort(known).tolist() == np.clip(rows.attacks, 0, levels - 1)[state >= 0].tolist()
        assert game.opponent_effort(known).tolist() == np.clip(rows.opponent_attacks, 0, levels - 1)[state >= 0].tolist()
        assert game.duel(known).tolist() == np.minimum(rows.net_run, 3)[state >= 0].tolist()
        assert game.incoming(known).tolist() == incoming[state >= 0].tolist()


class Constant:
    """Models that say the same of every stroke, but for a factor of the odds of a hurried striker's fault."""

    knows_hurried = True
    opposite = False

    def __init__(self, situations: Situations, fault: float, returned: float, late: float) -> None:
        self.situations, self.fault, self.returned, self.above, self.late = situations, fault, returned, 0.5, late
        self.hurried = np.array([0.25, 0.5])

    def averaged(self, probability: float | np.ndarray, codes: dict[str, np.ndarray], **_: object) -> np.ndarray:
        size = len(codes["contact"])
        if np.ndim(probability):
            return np.tile(probability, (size, 1))
        p = np.full(size, probability)
        odds = p / (1 - p) * np.where(codes["hurried"] == 1, self.late if probability == self.fault else 1.0, 1.0)
        return np.asarray(odds / (1 + odds))


def compiled(
    effort: list[float], fault: float, returned: float, fault_range: tuple[float, float], late: float = 1.0
) -> tuple[Game, Situations]:
    layout_of = duel_game(1)
    edges = len(layout_of.edge_own)
    shares = np.tile(np.array([0.5, 0.3, 0.2]) if len(effort) == 3 else np.ones(1), (SLOTS["own_shot"], 1))
    hurried = np.full((SLOTS["incoming_shot"], SLOTS["shot"]), 0.25)
    situations = Situations(effort=np.array(effort), duel=0.8, effort_share=shares, duel_share=0.25, hurried_share=hurried)
    count = np.zeros(edges)
    support = Support(
        strokes=count, faults=count, winners=count,
        fault_range=np.tile(fault_range, (edges, 1)), winner_range=np.tile([0.0, 1.0], (edges, 1)),
    )  # fmt: skip
    models = cast("Any", Constant(situations, fault, returned, late))
    return compile_game(layout_of, pair_probabilities(models, layout_of, support)), situations


def test_the_mean_over_situations_is_what_the_data_bounds() -> None:
    game, situations = compiled([0.0, 0.6, 1.2], fault=0.5, returned=0.9, fault_range=(0.02, 0.10))
    fault = game.limits[..., 0].astype(float) / ONE
    duel, long = is_duel_pair(game), is_long_duel_pair(game)
    golden.check("dynamics", {"compiled": golden.weighted_sum(game.threshold)})
    # Half of the net shots of duels of two or more strokes belong to each of the twin states.
    assert duel.sum() == 2 * long.sum() > 0
    plain = fault[:, ~duel]
    assert np.tensordot([0.5, 0.3, 0.2], plain, 1) == pytest.approx(0.10, abs=2e-4)
    assert (plain[2] > 0.13).all(), "at high effort outside of the range"
    means = [np.tensordot([0.5, 0.3, 0.2], fault[:, which], 1) for which in (duel & ~long, long)]
    assert 0.75 * means[0][0] + 0.25 * means[1][0] == pytest.approx(0.10, abs=2e-4)
    odds = fault / (1 - fault)
    assert odds[1] / odds[0] == pytest.approx(np.exp(0.6), rel=2e-3)
    assert (odds[0, long][0] / odds[0, duel & ~long][0]) == pytest.approx(np.exp(situations.duel), rel=2e-3)


@pytest.mark.parametrize("effort", [[0.0, 0.2, 0.4], [0.0, -0.5, -1.0]])
def test_every_stroke_but_a_serve_ends_some_rallies_at_every_level(effort: list[float]) -> None:
    game, _ = compiled(effort, fault=0.0001, returned=0.9999, fault_range=(0.0, 1.0))
    ending = 1 - np.diff(game.limits.astype(float), axis=2, append=ONE)[..., 1:].sum(axis=2) / ONE
    rally = ~is_serve_pair(game)
    assert ending[:, rally].min() >= MIN_END - 1 / ONE
    assert ending[:, rally].min() <= MIN_END + 1e-4
    assert (ending[:, ~rally] < MIN_END).all()


def test_the_mean_over_hurried_strikers_and_others_is_what_the_data_bounds() -> None:
    game, _ = compiled([0.0], fault=0.3, returned=0.9, fault_range=(0.02, 0.10), late=4.0)
    fault, late = game.threshold[:, 0] / ONE, game.hurried(game.base_pair_state) == 1
    plain = ~is_duel_pair(game)
    calm, hurried = fault[plain & ~late], fault[plain & late]
    assert 0.75 * calm + 0.25 * hurried == pytest.approx(0.10, abs=2e-4)
    assert hurried / (1 - hurried) == pytest.approx(4 * calm / (1 - calm), rel=5e-3)
    assert (hurried > 0.10).all()
    assert (game.hurry == [64, 128]).all()


def test_shares_of_hurried_strikers_are_shrunk_to_those_after_the_incoming_stroke() -> None:
    count = np.zeros((2, 15, 13))
    count[0, NET, :2], count[1, NET, :2] = (30, 10), (20, 0)  # not hurried and hurried, by own shot type
    rows = SimpleNamespace(hurried=np.zeros(1), take=lambda _: SimpleNamespace(count=lambda *_: count))
    found = _hurried_shares(cast(Rows, rows))
    usual = 20 / 60
    assert found[NET, :3] == pytest.approx([(20 + 20 * usual) / 70, 20 * usual / 30, usual])
    assert (found[LIFT] == 0).all(), "nobody met one"
