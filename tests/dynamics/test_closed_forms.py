"""Parts of the fits on a few rows, with results that can be worked out by hand or by a plain loop."""

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.sparse import csr_matrix, identity
from scipy.special import expit, logit

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.tensor_files import read_tensors
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.data.upstream import matches_of
from shuttle_marl.dynamics import evaluate, features, habits, hurried, make, prior, recovery, skill, splits
from shuttle_marl.dynamics.boosting import check_nodes, stored_trees
from shuttle_marl.dynamics.card import add_truth
from shuttle_marl.dynamics.choices import Choices, _remembered, best_shifts, fit_choice_shifts, fit_shifts
from shuttle_marl.dynamics.compiled import Support
from shuttle_marl.dynamics.evaluate import LIMITS, calibration_error, criteria, log_losses, prediction_scores, reliability, scores
from shuttle_marl.dynamics.features import MOVEMENT, SLOTS, Rows, mirrored_where
from shuttle_marl.dynamics.fitted import PlayerChoices, tilted
from shuttle_marl.dynamics.habits import Plays
from shuttle_marl.dynamics.hurried import Hurry
from shuttle_marl.dynamics.mixed import BOUNDS, MixedModel, fit_variances, gradient_of, posterior
from shuttle_marl.dynamics.models import (
    fault_class,
    judged,
    labelled,
    labels_of,
    latent_target,
    log_loss,
    log_odds,
    sigmoid,
    softmax,
)
from shuttle_marl.dynamics.network import NetworkSpec, attributes, encode, fold_of_match
from shuttle_marl.dynamics.recovery import Court, FittedRecovery
from shuttle_marl.dynamics.situations import Situations
from shuttle_marl.dynamics.trees import Trees
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.shipped import REFITS
from shuttle_marl.game.skill import COMPONENTS, GROUPS
from shuttle_marl.game.stroke import SHOTS
from tests.dynamics.rows import plain_rows

LIFT, SMASH, NET = (SHOTS.index(name) for name in ("lift", "smash", "net-shot"))


def i16(*numbers: int) -> Any:
    return np.array(numbers, np.int16)


# Habits.


def test_straight_strokes_go_to_the_other_side_of_the_receiver() -> None:
    met, area = np.repeat([0, 1, 2], 3), np.tile([6, 7, 8], 3)
    assert habits.straight(met, area, opposite=False).tolist() == [False, False, True, False, True, False, True, False, False]
    assert habits.straight(met, area, opposite=True).tolist() == [True, True, False, True, False, True, False, True, True]


def test_the_dispersion_of_counts_is_chi_squared_by_its_degrees() -> None:
    table = np.array([[6, 1, 9, 0], [2, 8, 5, 1], [4, 4, 4, 1], [9, 0, 1, 0], [1, 7, 2, 1], [5, 5, 5, 1]])
    group, answer = (np.repeat(part.ravel(), table.ravel()) for part in np.indices(table.shape))
    zero = np.zeros(len(group), np.int64)
    columns: dict[str, Any] = {field.name: zero for field in dataclasses.fields(Plays)}
    plays = Plays(**columns | {"group": group, "weight": np.ones(len(group))})
    expected = stats.chi2_contingency(table[:, :3], correction=False)
    assert habits._dispersion(answer, plays, 4) == pytest.approx(expected.statistic / 10), (
        "an answer of four strokes does not count"
    )
    five = plays.take(np.r_[np.arange(len(group)), len(group) - 1])  # a fifth stroke with the last answer
    table[5, 3] += 1
    whole = stats.chi2_contingency(table, correction=False)
    assert habits._dispersion(np.r_[answer, 3], five, 4) == pytest.approx(whole.statistic / 15)
    few = group < 5
    assert habits._dispersion(np.where(few, answer, -1), plays, 4) == 1, "8 degrees are too few"
    assert habits._dispersion(np.full(len(group), -1), plays, 4) == 1
    more = habits._dispersion(np.where(answer == 3, -1, answer), plays, 3)
    assert more == pytest.approx(expected.statistic / 10)


# Effort and duels.


def situations(**changes: Any) -> Situations:
    share = np.tile([0.75, 0.25], (SLOTS["own_shot"], 1))
    share[SMASH] = [0.5, 0.5]
    usual: dict[str, Any] = {"effort": np.array([0.0, 0.5]), "duel": 1.0, "effort_share": share, "duel_share": 0.25,
                             "hurried_share": np.zeros((SLOTS["incoming_shot"], SLOTS["shot"]))}  # fmt: skip
    return Situations(**usual | changes)


def test_weights_of_situations() -> None:
    rows = plain_rows(7, codes={"own_shot": i16(SMASH, 2, 2, SMASH, 2, 2, 2), "shot": i16(NET, NET, LIFT, NET, LIFT, NET, NET)},
                      attacks=i16(0, 5, 1, -1, -1, 0, 0), net_run=i16(2, 3, 4, 9, 0, -1, 0))  # fmt: skip
    found = situations()
    assert found.offsets.tolist() == [0, 0.5, 1, 1.5]
    assert found.weights(rows).tolist() == [
        [1, 0, 0, 0], [0, 0, 0, 1], [0, 1, 0, 0], [0, 0, 0.5, 0.5], [0.75, 0.25, 0, 0], [0.75, 0, 0.25, 0], [1, 0, 0, 0],
    ]  # fmt: skip
    codes = found.codes(rows)
    assert (codes["effort"].tolist(), codes["duel"].tolist()) == ([0, 1, 1, 2, 2, 0, 0], [0, 1, 1, 1, 0, 2, 0])


def test_faults_are_averaged_over_situations_and_moved_to_a_mean() -> None:
    weights = np.array([[0.5, 0.5, 0, 0], [0, 0, 0, 1]])
    z = np.array([[-1.0, 0.0], [0.5, -2.0]])
    expected = np.stack([0.5 * expit(z[0]) + 0.5 * expit(z[0] + 0.5), expit(z[1] + 1.5)])
    found = situations()
    assert found.mixed(z, weights) == pytest.approx(expected)
    assert found.mixed(z[:, 0], weights) == pytest.approx(expected[:, 0])
    share = np.array([[0.25, 0.75], [1.0, 0.0]])
    moved = found.moved_to(np.array([0.2, 0.6]), z, weights, share)
    assert (share * found.mixed(moved, weights)).sum(axis=1) == pytest.approx([0.2, 0.6])
    assert np.diff(moved, axis=1) == pytest.approx(np.diff(z, axis=1)), "the logits of a row move alike"


# Scores.


def test_log_losses_and_bins() -> None:
    label, p = np.array([True, False, True, False]), np.array([0.25, 0.5, 1.0, 1.0])
    assert log_losses(label, p) == pytest.approx([math.log(4), math.log(2), 1e-7, -math.log(1e-7)])
    assert log_loss(label[:2], p[:2]) == pytest.approx(1.5 * math.log(2))
    label, p = np.arange(20) % 4 == 0, np.linspace(0, 0.95, 20)
    bins = [(p[k : k + 5].mean(), label[k : k + 5].mean()) for k in range(0, 20, 5)]
    assert calibration_error(label, p, 4) == pytest.approx(sum(abs(a - b) / 4 for a, b in bins))
    told = reliability(label, p)
    assert [each["rows"] for each in told] == [2] * 5 + [1] * 10
    assert (told[0], told[-1]) == (
        {"predicted": 0.025, "observed": 0.5, "rows": 2},
        {"predicted": 0.95, "observed": 0, "rows": 1},
    )
    found = scores(label, p)
    assert found["brier"] == pytest.approx(((p - label) ** 2).mean())
    assert (found["rows"], found["log_loss"]) == (20, pytest.approx(log_losses(label, p).mean()))
    pairs = [(a > b) + 0.5 * (a == b) for a in p[label] for b in p[~label]]
    assert found["auc"] == pytest.approx(np.mean(pairs))
    ties = evaluate.area_under_curve(np.array([True, True, False]), np.array([0.5, 0.7, 0.5]))
    assert ties == 0.75
    assert math.isnan(evaluate.area_under_curve(np.zeros(3, np.bool_), np.ones(3)))


def test_differences_of_losses_are_resampled_by_match() -> None:
    match = np.repeat([3, 5, 9], [10, 20, 30])
    found = evaluate.difference_by_match(np.where(match == 9, 0.5, 0.25), np.full(60, 0.25), match, seed=4)
    assert found["mean"] == pytest.approx(0.125)
    assert (found["low"], found["high"]) == (0, 0.25), "only the last match differs: in some resamples it is all, in others none"


def test_predictions_of_strokes_are_scored() -> None:
    rows = plain_rows(4, codes={"shot": i16(2, 3, 3, 4), "area": i16(0, 8, -1, 4)}, outcome=np.array([0, 2, 0, 1], np.int8))
    shot = np.full((4, len(SHOTS)), 0.02)
    shot[:, 2:6] = [0.4, 0.2, 0.1, 0.1]
    area = np.full((4, 9), 0.05)
    area[:, [8, 0]] = [0.4, 0.25]
    given = area[:, ::-1]
    found = prediction_scores(shot, area, given, rows)
    assert found["rows"] == 4
    assert found["shot_type"] == [0.25, 0.75, 1, 1]
    assert found["area"] == [0.5, 1, 1, 1], "of the two strokes in play with a known area"
    assert found["area_given_type"] == [0.5, 1, 1, 1]
    assert found["cross_entropy"] == pytest.approx(-(math.log(0.4 * 0.4) + math.log(0.2 * 0.25)) / 2)
    assert found["shot_type_cross_entropy"] == pytest.approx(-(math.log(0.4) + 2 * math.log(0.2) + math.log(0.1)) / 4)


def test_criteria_are_limits_of_the_figures() -> None:
    parts = {name: {"bc": 9.0, "minimax": 0.01, "best_response": 0.02} for name in ("rare", "unsupported", "thin")}
    figures = {"impossible": 0, "largest_shot_share": 0.5, "shot_types_above_2_percent": 7, "largest_continuation": 0.9975,
               "minimax": {"mean_rally": 20.5}, **parts}  # fmt: skip
    found = criteria(figures)
    assert found.keys() == LIMITS.keys()
    assert [name for name, (_, within) in found.items() if not within] == ["minimax_mean_rally", "largest_continuation"]
    assert found["minimax_mean_rally"][0] == "minimax mean rally: 20.5, expected 5 to 20"
    assert found["best_response_rare"] == ("best response rare: 0.02, expected 0 to 0.02", True)
    assert criteria(figures, {"impossible": (1, 2)})["impossible"][1] is False
    shares = {"shot_mix": {"a": 0.5, "b": 0.02, "c": 0.021, "d": 0.459}}
    assert evaluate._variety(shares) == {"largest_shot_share": 0.5, "shot_types_above_2_percent": 3}
    assert evaluate.variety_of([]) == {}


# Hurried strikers.


def test_the_worst_quarter_of_a_cell_is_hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hurried, "MIN_CELL", 4)
    shot, contact = np.repeat([2, 2, 3, 4], [5, 3, 4, 3]), np.repeat([0, 1, 1, 0], [5, 3, 4, 3])
    rows = plain_rows(15, codes={"incoming_shot": i16(*shot), "contact": i16(*contact)})
    index = np.arange(15.0)
    found = hurried._thresholds(index, rows, np.ones(15, np.bool_))
    lowest = np.finfo(np.float64).min
    assert found.shape == (SLOTS["incoming_shot"], 2)
    assert found[2].tolist() == [1.0, 1.75], "five strokes of one height; with three of the other both count"
    assert found[3].tolist() == [np.quantile([8, 9, 10, 11], 0.25)] * 2
    assert (found[4] == lowest).all(), "three strokes of both heights are too few"
    assert hurried._thresholds(index, rows, index != 8)[3].tolist() == [lowest] * 2


def test_one_step_values_are_a_fixed_point() -> None:
    # Lifts (from below) are met above by smashes, half of which win and half fault; what follows the others is not known.
    codes = {"incoming_shot": i16(NET, LIFT, LIFT, LIFT), "shot": i16(LIFT, SMASH, SMASH, SMASH), "contact": i16(0, 1, 1, 1)}
    outcome = np.array([Outcome.RETURNED, Outcome.WINNER, Outcome.WINNER, Outcome.RETURNED], np.int8)
    rows = plain_rows(4, codes=codes, outcome=outcome, next_contact=np.array([1, -1, -1, -1], np.int8), stroke=i16(2, 3, 3, 3))
    assert hurried._step_values(rows).tolist()[:3] == [-1, 1, 1]
    assert math.isnan(hurried._step_values(rows)[3])
    fault = dataclasses.replace(rows, outcome=np.array([0, 1, 2, 1], np.int8))
    assert hurried._step_values(fault) == pytest.approx([1 / 3, -1, 1, -1])
    above = hurried._above_usual(np.array([0.5, -1.0, 1.0, -1.0]), fault)
    mean = (-1 + 20 * (0.5 - 1) / 4) / 23
    usual = (0.5 + 20 * (0.5 - 1) / 4) / 21
    assert above == pytest.approx([0.5 - usual, -1 - mean, 1 - mean, -1 - mean])
    serve = dataclasses.replace(fault, stroke=i16(1, 3, 3, 3))
    assert hurried._above_usual(np.array([0.5, -1.0, 1.0, np.nan]), serve)[:3] == pytest.approx([0.5, -1, 1])


def forests() -> Hurry:
    """Two forests of two trees with two nodes: on the incoming shot type and then the contact; and on the reach."""
    attribute = np.array([[[0, 2], [3 + MOVEMENT.index("reach"), 0]]] * 2, np.int32)
    cut = np.array([[[3.5, 0.5], [1.0, 0.0]]] * 2)
    child = np.array([[[[1, -3], [-1, -2]], [[-1, -2], [-1, -1]]]] * 2, np.int32)
    value = np.array([[[1.0, 2.0, 4.0], [10.0, 20.0, 40.0]]]) * np.array([[[1.0]], [[100.0]]])
    threshold = np.full((SLOTS["incoming_shot"], 2), 11.5)
    return Hurry(
        matches=("b",), fold=np.zeros(1, np.int32), attribute=attribute, cut=cut, child=child, value=value, threshold=threshold
    )


def test_trees_of_the_index_are_walked_from_node_to_node() -> None:
    movement = np.zeros((5, len(MOVEMENT)), np.float32)
    movement[:, MOVEMENT.index("reach")] = [1.0, 1.5, 0.0, 0.0, np.nan]
    codes = {"incoming_shot": i16(3, 3, 4, 3, 3), "contact": i16(0, 1, 1, 0, 0)}
    rows = plain_rows(5, codes=codes, movement=movement, match=np.array([0, 0, 0, 1, 0], np.int32), matches=("b", "a"),
                      hurried=np.array([-1, 1, -1, -1, -1], np.int8),
                      next_contact=np.array([0, 1, 0, -1, -1], np.int8))  # fmt: skip
    hurry = forests()
    np.testing.assert_array_equal(hurry.index(rows), [11, 22, 14, 1100, np.nan])
    assert hurry.bits(rows).tolist() == [1, 0, 0, 0, -1]
    marked = hurry.marked(rows)
    assert marked.hurried.tolist() == [1, 1, 0, 0, -1], "what a table knows stays"
    assert marked.next_hurried.tolist() == [1, 0, 0, -1, -1]
    assert marked.codes["hurried"].tolist() == [1, 1, 0, 0, 0]


@pytest.mark.parametrize(
    ("attribute", "child", "fine"),
    [([0, 2], [[1, -1], [-2, -3]], True), ([0, 3], [[1, -1], [-2, -3]], False), ([-1, 0], [[1, -1], [-2, -3]], False),
     ([0, 0], [[0, -1], [-2, -3]], False), ([0, 0], [[1, -1], [1, -3]], False), ([0, 0], [[2, -1], [-2, -3]], False),
     ([0, 0], [[1, -1], [-2, -4]], False)],
)  # fmt: skip
def test_nodes_test_an_input_and_lead_to_later_nodes_or_leaves(attribute: list[int], child: list[list[int]], fine: bool) -> None:
    arrays: tuple[Any, Any] = np.array(attribute, np.int32), np.array(child, np.int32)
    if fine:
        check_nodes(*arrays, 3)
    else:
        with pytest.raises(ValueError, match="an unknown attribute, or an unknown or earlier child"):
            check_nodes(*arrays, 3)
    with pytest.raises(ValueError, match="trees without a node"):
        check_nodes(np.zeros((2, 0), np.int32), np.zeros((2, 0, 2), np.int32), 3)


def test_trees_of_the_library_as_arrays() -> None:
    leaves = [{"leaf_index": k, "leaf_value": v} for k, v in enumerate((0.5, 1.5, 2.5))]
    inner = {"split_index": 1, "split_feature": 7, "threshold": "2||4", "left_child": leaves[0], "right_child": leaves[2]}
    root = {"split_index": 0, "split_feature": 3, "threshold": "1", "left_child": leaves[1], "right_child": inner}

    class Booster:
        def dump_model(self) -> dict[str, Any]:
            return {"tree_info": [{"tree_structure": root}, {"tree_structure": {"leaf_value": 9.0}}]}

    arrays, nodes = stored_trees(Booster(), 4)
    assert arrays["attribute"].tolist() == [[3, 7, 0], [0, 0, 0]]
    assert arrays["child"].tolist() == [[[-2, 1], [-1, -3], [-1, -1]], [[-1, -1]] * 3]
    assert arrays["value"].tolist() == [[0.5, 1.5, 2.5, 0], [9, 0, 0, 0]]
    assert sorted(nodes) == [(0, 0, "1"), (0, 1, "2||4")]


def test_masks_of_trees_reach_the_leaves_of_a_walk() -> None:
    rng = np.random.default_rng(0)
    names = list(SLOTS)
    # A chain, a tree whose second node is on the right, and one without a split.
    child = np.array([[[1, -1], [2, -2], [-3, -4]], [[-1, 1], [-2, 2], [-3, -4]], [[-1, -1]] * 3], np.int32)
    attribute = rng.integers(0, len(SLOTS), (3, 3)).astype(np.int32)
    left = np.array([[sum(1 << c for c in range(16) if rng.random() < 0.5) for _ in range(3)] for _ in range(3)], np.int32)
    value = rng.normal(size=(3, 4))
    codes = {name: rng.integers(0, size, 200).astype(np.int16) for name, size in SLOTS.items()}
    expected = np.zeros(200)
    for row in range(200):
        for tree in range(3):
            node = 0
            while node >= 0:
                first = left[tree, node] >> codes[names[attribute[tree, node]]][row] & 1
                node = child[tree, node, 0 if first else 1]
            expected[row] += value[tree, -1 - node]
    assert Trees(attribute=attribute, left=left, child=child, value=value).logits(codes) == pytest.approx(expected)


# Rows.


def test_rows_are_counted_taken_and_joined() -> None:
    rows = plain_rows(4, codes={"shot": i16(2, 2, 3, 2), "contact": i16(0, 1, 1, 0), "area": i16(0, 4, -1, 8),
                                "technique": i16(0, 1, 2, 2),
                                "hands": i16(0, 1, 0, 1), "own_area": i16(0, 2, 9, 10)},
                      match=np.array([0, 0, 1, 1], np.int32), matches=("a", "b"))  # fmt: skip
    counted = rows.count("shot", "contact")
    assert counted.shape == (len(SHOTS), 2)
    assert (counted[2].tolist(), counted[3].tolist(), counted.sum()) == ([2, 1], [0, 1], 4)
    assert rows.cells.tolist() == [(2 * 9 + 0) * 6, (2 * 9 + 4) * 6 + 3 + 1, -1, (2 * 9 + 8) * 6 + 2]
    assert rows.game_codes["area"].tolist() == [0, 4, -1, 6]
    assert rows.game_codes["own_area"].tolist() == [0, 0, 9, 10]
    assert rows.with_area(5)["area"].tolist() == [5] * 4
    both = Rows.joined([rows, rows.take(np.array([3, 0]))])
    assert (len(both), both.matches, both.match.tolist()) == (6, ("a", "b", "a", "b"), [0, 0, 1, 1, 3, 2])
    assert both.codes["shot"].tolist() == [2, 2, 3, 2, 2, 2]
    assert rows.in_matches(["b", "c"]).codes["shot"].tolist() == [3, 2]
    assert len(rows.none()) == 0
    assert mirrored_where(np.array([True, True, True, False]), i16(0, 7, 9, 0)).tolist() == [2, 7, 9, 0]


def test_rates_of_frames_are_slopes() -> None:
    match = np.repeat([0, 1, 2, 3, 4], 3)
    clock = np.tile([1.0, 2.0, 4.0], 5)
    frame = np.r_[100 + 30 * clock[:3], 10 * clock[3:6], 9.9 * clock[6:9], 130 * clock[9:12], 130.1 * clock[12:]]
    clock[1] = np.nan
    np.testing.assert_allclose(features._frame_rates(match, frame, clock), [30, 10, np.nan, 130, np.nan])
    assert np.isnan(features._frame_rates(match, np.full(15, np.nan), clock)).all()


def test_rows_before_and_after_are_of_the_same_rally() -> None:
    key = np.array([[0, 0, 0, 0, 1], [1, 1, 1, 1, 1], [1, 1, 1, 2, 2]])
    number = i16(1, 2, 4, 5, 6)
    row, known = features._lagged(key, number, 1)
    assert (row.tolist(), known.tolist()) == ([-1, 0, 1, 2, 3], [False, True, False, False, False])
    row, known = features._lagged(key, number, -1)
    assert (row.tolist(), known.tolist()) == ([1, 2, 3, 4, -1], [True, False, False, False, False])
    assert features._ranks(np.array([1.0, 2.0, 2.0, 5.0]), np.array([0.0, 1.0, 2.0, 5.0, 9.0])).tolist() == [
        0.125, 0.125, 0.5, 0.875, 0.875
    ]  # fmt: skip


def test_previous_strokes_are_looked_up_in_the_catalogue() -> None:
    strokes = np.arange(13 * 9 * 2 * 3).reshape(13, 9, 2, 3)
    codes = {"own_shot": i16(2, 13, 14, 2, 2), "own_area": i16(1, 9, 10, 10, 1), "own_height": i16(1, 2, 3, 0, 3),
             "own_technique": i16(2, 3, 4, 0, 0)}  # fmt: skip
    found = features.strokes_before(plain_rows(5, codes=codes), "own", strokes, 777)
    assert found.tolist() == [strokes[2, 1, 1, 2], 777, -1, -1, -1]


# Labels.


def test_labels_of_the_models() -> None:
    reason = [REASONS.index(name) for name in ("returned", "out", "net", "unknown", "landed", "returned", "unknown")]
    rows = plain_rows(7, codes={"area": i16(3, 4, 5, 6, 7, -1, 0), "shot": i16(*range(2, 9)),
                             "technique": i16(0, 1, 2, 0, 1, 2, 0)},
                      outcome=np.array([0, 1, 1, 1, 2, 0, 3], np.int8), reason=np.array(reason, np.int8),
                      next_contact=np.array([1, -1, -1, -1, -1, 0, -1], np.int8),
                      next_hurried=np.array([-1] * 7, np.int8))  # fmt: skip
    assert fault_class(rows).tolist() == [0, 1, 2, 2, 0, 0, 0]
    assert latent_target(rows).tolist() == [False, False, True, True, False, True, False]
    assert labelled("target", rows).tolist() == [True, True, False, False, True, False, True]
    assert labelled("choice", rows).all()
    assert labels_of("choice", rows).tolist() == [6, 10, 14, 15, 19, 23, 24]
    assert labels_of("target", rows).tolist() == [3, 4, 5, 6, 7, -1, 0]
    found = {name: (part.codes["shot"].tolist(), label.tolist()) for name, (part, label) in judged(rows).items()}
    assert found == {
        "success": ([2, 3, 4, 5, 6, 7], [False, True, True, True, False, False]), "return": ([2, 6], [True, False]),
        "contact": ([2], [True]), "hurried": ([], []),
    }  # fmt: skip
    timed = dataclasses.replace(rows, next_hurried=np.array([1, -1, -1, -1, -1, 0, -1], np.int8))
    assert judged(timed)["hurried"][1].tolist() == [True]


def test_logits_and_probabilities() -> None:
    p = np.array([0.2, 0.5, 0.999])
    assert log_odds(p) == pytest.approx(logit(p))
    assert sigmoid(log_odds(p)) == pytest.approx(p)
    assert log_odds(np.array([0.0, 1.0])) == pytest.approx([logit(1e-9), -logit(1e-9)])
    assert softmax(np.log([[1.0, 3.0], [2.0, 2.0]]) + 1000) == pytest.approx(np.array([[0.25, 0.75], [0.5, 0.5]]))
    assert tilted(np.array([0.5, 0.25, 0.25]), np.log([1.0, 2.0, 4.0])) == pytest.approx([0.25, 0.25, 0.5])


def test_codes_select_columns_of_the_multi_hot_input() -> None:
    spec = NetworkSpec(inputs=("contact", "shot"), crosses=(("shot", "contact"), ("hands", "contact")), outputs=1)
    codes = {"contact": i16(0, 1), "shot": i16(4, 12), "hands": i16(1, 1)}
    # Two contacts, 13 shot types, 26 pairs and 4 pairs; the last name of a product varies fastest.
    assert encode(spec, attributes(codes)).tolist() == [[0, 6, 15 + 8, 41 + 2], [1, 14, 15 + 25, 41 + 3]]
    table = attributes({"contact": i16(1)})
    assert table.shape == (1, len(SLOTS))
    assert int(table.sum()) == 1
    assert fold_of_match(np.array([7, 7, 3, 5, 3, 9]), 3).tolist() == [0, 0, 1, 2, 1, 0]


# Choices of players.


def test_shifts_of_players_apply_in_their_cells() -> None:
    style = np.zeros((2, SLOTS["incoming_shot"], 2, 39))
    style[1, 3, 1, 5] = math.log(3)
    choices = PlayerChoices(players=("a", "b"), style=style, area=np.zeros((2, 13, 3, 9)))
    assert choices.index(np.array(["b", "c", "a"])).tolist() == [1, -1, 0]
    even = np.full((4, 39), 1 / 39)
    codes = {"incoming_shot": i16(3, 3, 3, 3), "contact": i16(1, 0, 1, 1)}
    found = choices.shifted_choice(even, codes, np.array([1, 1, 0, -1]))
    assert found[0, 5] == pytest.approx(3 / 41)
    assert found[0, 6] == pytest.approx(1 / 41)
    assert found[1:] == pytest.approx(even[1:])
    nobody = PlayerChoices(players=(), style=style[:0], area=choices.area[:0])
    assert nobody.shifted_choice(even, codes, np.full(4, -1)) is even


def test_fitted_shifts_balance_the_data_and_the_prior() -> None:
    base = np.tile([0.5, 0.3, 0.2], (60, 1))
    label, one, two = np.arange(60) % 3, np.arange(60) % 2, np.arange(60) // 30
    tables = fit_shifts(base, label, (one, two), (2, 2), (2.0, 5.0))
    p = tilted(base, tables[0][one] + tables[1][two])
    surplus = np.eye(3)[label] - p
    for table, at, precision in zip(tables, (one, two), (2.0, 5.0), strict=True):
        expected = np.stack([surplus[at == k].sum(axis=0) for k in range(2)]) / precision
        assert table == pytest.approx(expected, abs=1e-4), "at the mode the gradient is 0"
    single = fit_choice_shifts(base, np.zeros(60, int), 1, np.zeros(60, int), 1, label, 3.0)
    residual = (np.eye(3)[label] - tilted(base, single[0, 0])).sum(axis=0)
    assert single[0, 0] == pytest.approx(residual / 3 + residual / 12, abs=1e-4)


def test_the_best_precision_is_that_of_other_choices() -> None:
    zero = np.zeros(40, np.int64)
    ours = Choices(np.full((40, 2), 0.5), zero, zero, np.r_[zero[:30], zero[:10] + 1])
    assert ours.cross_entropy() == pytest.approx(math.log(2))
    assert ours.cross_entropy(np.array([[[math.log(3), 0]]])) == pytest.approx(-(0.75 * math.log(0.75) + 0.25 * math.log(0.25)))
    loss, precision, shift = best_shifts(ours, ours, 1, 1, (1.0, 100.0))
    assert (precision, loss) == (1.0, pytest.approx(ours.cross_entropy(shift)))
    other = ours._replace(label=1 - ours.label)
    assert best_shifts(ours, other, 1, 1, (1.0, 100.0))[1] == 100
    none = Choices(np.zeros((0, 2)), zero[:0], zero[:0], zero[:0])
    assert best_shifts(ours, none, 1, 1, (1.0, 100.0))[:2] == (-100, 100)


def test_strokes_three_and_four_before_are_remembered() -> None:
    none, unknown = (np.array([[size - 2] * 2, [area - 2] * 2, [technique - 2] * 2]).ravel() + k for k in (0, 1)
                     for size, area, technique in [(SLOTS["own_shot"], SLOTS["own_area"], SLOTS["own_technique"])])  # fmt: skip
    codes = {"own_shot": i16(13, 13, 0, 2, 14), "incoming_shot": i16(13, 0, 2, 3, 3), "own_area": i16(9, 9, 1, 6, 10),
             "incoming_area": i16(9, 1, 6, 8, 8), "own_technique": i16(3, 3, 0, 1, 4),
             "incoming_technique": i16(3, 0, 1, 2, 2)}  # fmt: skip
    found = _remembered(plain_rows(5, codes=codes, stroke=i16(1, 2, 3, 4, 6)))
    assert found.shape == (6, 5)
    assert found[:, 0].tolist() == found[:, 1].tolist() == none.tolist()
    assert found[:, 2].tolist() == none.tolist(), "of the serve, which had none before it"
    assert found[:, 3].tolist() == [0, 13, 1, 9, 0, 3], "of the second stroke"
    assert found[:, 4].tolist() == unknown.tolist()


# Corrections and skill.


def test_a_shift_is_the_mode_and_its_deviation_the_curvature() -> None:
    label = np.r_[np.ones(30), np.zeros(10)] == 1
    z = np.linspace(-1, 1, 40)
    shift, deviation = prior.shift_of(lambda b: expit(z + b), label)
    p = expit(z + shift)
    assert (label - p).sum() == pytest.approx(4 * shift, abs=1e-3)
    assert deviation == pytest.approx(1 / math.sqrt((p * (1 - p)).sum() + 4), rel=1e-3)
    assert prior.shift_of(lambda b: expit(z[:0] + b), label[:0]) == pytest.approx((0, 0.5), abs=1e-4)


def support(**changes: Any) -> Support:
    usual: dict[str, Any] = {"strokes": np.array([5.0, 6.0]), "faults": np.array([1.0, 2.0]), "winners": np.array([0.5, 0.0]),
                             "fault_range": np.array([[0.0, 0.5], [0.25, 1.0]]),
                             "winner_range": np.array([[0.2, 0.8], [0.0, 1.0]])}  # fmt: skip
    return Support(**usual | changes)


def test_supports_are_added_and_their_ranges_moved() -> None:
    found = prior._moved(support(), {"success": 1.0, "return": 0.5}, support(strokes=np.array([1.0, 2.0])))
    assert (found.strokes.tolist(), found.faults.tolist(), found.winners.tolist()) == ([6, 8], [2, 4], [1, 0])
    assert found.fault_range == pytest.approx(np.array([[0, expit(1)], [expit(logit(0.25) + 1), 1]]))
    assert found.winner_range == pytest.approx(np.array([[expit(logit(0.2) - 0.5), expit(logit(0.8) - 0.5)], [0, 1]]))


def test_the_slope_of_truth_on_offsets() -> None:
    # Two offsets with ten rows each, of which 5 and 8 are positive: the regression meets both rates.
    shift, label = np.repeat([0.0, 1.0], 10), np.r_[np.arange(10) < 5, np.arange(10) < 8]
    found = skill.slope_on_offset(np.zeros(20), shift, label, np.arange(20))
    assert found["slope"] == pytest.approx(logit(0.8), abs=1e-4)
    # Each row is a cluster: the variance of a difference of two independent log-odds.
    assert found["high"] - found["slope"] == pytest.approx(1.96 * math.sqrt(1 / 2.5 + 1 / 1.6), rel=1e-3)
    assert found["slope"] - found["low"] == pytest.approx(found["high"] - found["slope"])
    moved = skill.slope_on_offset(np.full(20, 0.5), shift, label, np.arange(20))
    assert moved["slope"] == pytest.approx(found["slope"], abs=1e-4)
    paired = skill.slope_on_offset(np.zeros(40), np.tile(shift, 2), np.tile(label, 2), np.tile(np.arange(20), 2))
    assert paired["high"] - paired["low"] == pytest.approx(found["high"] - found["low"], rel=1e-3), (
        "copies in a match tell no more"
    )
    assert skill.deviations_in({}) is None
    names = {c: dict.fromkeys(skill.VARIANCES, float(i)) for i, c in enumerate(COMPONENTS)}
    told = skill.deviations_in({"skill": {"deviations": names}})
    assert told is not None
    assert told.tolist() == [[float(i)] * 9 for i in range(3)]


def test_every_shot_type_has_the_group_that_names_it() -> None:
    assert [GROUPS[group] for group in skill.GROUP] == [
        next(group for group, shots in skill.SHOTS_OF_GROUP.items() if name in shots) for name in SHOTS
    ]  # fmt: skip


def test_days_of_matches_without_a_date_are_the_last_ones() -> None:
    rows = plain_rows(1, matches=("1970-01-11 a", "b", "1970-03-02 c"))
    assert skill.days_of(rows).tolist() == [10, 60, 60]
    assert skill.days_of(plain_rows(1)).tolist() == [0]


def test_a_normal_effect_is_at_its_mode() -> None:
    label = np.arange(30) < np.repeat([8, 14, 23], 10)
    model = MixedModel(x=csr_matrix(identity(3)), row=np.repeat([0, 1, 2], 10), offset=np.zeros(30), label=label,
                       difference=csr_matrix(identity(3)), component=np.array([0, 0, 1]),
                       scale=np.array([1.0, 4.0, 1.0]))  # fmt: skip
    sd = np.array([0.5, 0.2])
    found = posterior(model, sd)
    variance = np.array([0.25, 1.0, 0.04])
    p = expit(found.mode)
    wins = np.array([label[k : k + 10].sum() for k in (0, 10, 20)])
    assert wins - 10 * p == pytest.approx(found.mode / variance, abs=1e-4)
    curvature = 10 * p * (1 - p) + 1 / variance
    assert found.deviation == pytest.approx(curvature**-0.5, rel=1e-4)
    terms = wins * np.log(p) + (10 - wins) * np.log1p(-p) - found.mode**2 / variance / 2
    assert found.log_likelihood == pytest.approx((terms - np.log(curvature * variance) / 2).sum(), rel=1e-6)
    step = 1e-4
    slopes = [(posterior(model, sd * np.exp(e)).log_likelihood - posterior(model, sd * np.exp(-e)).log_likelihood) / (2 * step)
              for e in step * np.eye(2)]  # fmt: skip
    assert gradient_of(model, found) == pytest.approx(slopes, abs=1e-3)
    fixed = fit_variances(model, np.array([0.5, np.nan]))
    assert fixed.sd[0] == pytest.approx(0.5)
    assert BOUNDS[0] * 0.999 <= fixed.sd[1] <= BOUNDS[1]
    assert fixed.log_likelihood >= found.log_likelihood - 1e-6


# Positions.


def test_places_are_compared_with_where_strokes_are_met() -> None:
    meeting = np.zeros((13, 9, 2))
    meeting[SMASH, 4] = [1.0, 3.0]
    court = Court(np.zeros((N_POSITIONS, 2)), meeting)
    place = np.array([[1.5, 3.5], [0.0, 1.0]])
    shot, area = np.array([SMASH, SMASH]), np.array([4, 4])
    assert court.features(shot, area, place).tolist() == [[0.5, 0.5, 0], [1, 0, 2]]
    coefficients = np.zeros((3, 4, 3))
    coefficients[0, 0], coefficients[1, 0], coefficients[2, 1] = [1, 2, 3], [-9, 0, 0], [5, 5, 5]
    fitted = FittedRecovery(None, coefficients, court)
    assert fitted.shift(shot, area, place).tolist() == [[1.5, 4], [-4, -4], [0, 0]], "at most 4"
    assert fitted.shift(np.array([0]), np.array([4]), place[:1]).tolist() == [[0], [0], [0]]


def test_units_add_up_and_none_is_lost() -> None:
    share = np.array([[0.5, 0.25, 0.25], [1 - 2e-9, 2e-9, 0.0], [1 / 3, 1 / 3, 1 / 3]])
    units = recovery._units(share).astype(int)
    assert (units.sum(axis=1) == CHOICE_ONE).all()
    assert units[1].tolist() == [CHOICE_ONE - 1, 1, 0]
    assert (np.abs(units - share * CHOICE_ONE) <= 1).all()


def test_means_are_shrunk_and_coefficients_penalised() -> None:
    values, around = np.array([[1.0], [3.0], [5.0]]), np.array([[2.0], [10.0], [7.0]])
    assert recovery._means(np.array([0, 0, 1]), values, around, 2.0).tolist() == [[(4 + 4) / 4], [(5 + 20) / 3], [7]]
    rng = np.random.default_rng(1)
    x, offset = rng.normal(size=(200, 2)), rng.normal(size=200)
    label = rng.random(200) < expit(offset + x @ [1.0, -0.5])
    w = recovery._logistic(x, label, offset)
    assert x.T @ (label - expit(offset + x @ w)) == pytest.approx(20 * w)
    assert w[0] > 0 > w[1]


# Enough data.


@pytest.mark.parametrize(
    ("strokes", "matches", "prior_model", "says"),
    [(1000, 2, False, ""), (999, 2, False, "999 strokes in 2 train matches, at least 1000 needed"),
     (2000, 1, False, "a model needs 3"),
     (300, 1, True, ""), (299, 1, True, "299 strokes in 1 train matches, at least 300 needed"), (0, 0, True, "a model needs 2")],
)  # fmt: skip
def test_enough_strokes_and_matches(strokes: int, matches: int, prior_model: bool, says: str) -> None:
    def rows(n: int, first: int, count: int) -> Rows:
        return plain_rows(n, match=(first + np.arange(n) % max(1, count)).astype(np.int32), matches=("a", "b", "c", "d"))

    train, validation = rows(strokes, 0, matches), rows(5, 3, 1)
    if says:
        with pytest.raises(ShuttleError, match=says):
            splits.require_enough(train, validation, prior=prior_model)
    else:
        splits.require_enough(train, validation, prior=prior_model)
    with pytest.raises(ShuttleError, match="one of them to check the fit"):
        splits.require_enough(train, validation.none(), prior=prior_model)


def test_a_truth_lacks_no_field(tmp_path: Path) -> None:
    fields = dict.fromkeys(("split", "cross", "train_only", "matches", "strokes", "decision_slope", "promised_realised"), 1)
    for name in fields:
        with pytest.raises(ShuttleError, match=f"not a result of experiments.truth: {name} missing; create one with --json"):
            add_truth(tmp_path, {key: value for key, value in fields.items() if key != name})


@pytest.mark.parametrize(
    ("refits", "matches", "of_prior", "found"),
    [(None, make.MIN_MATCHES_FOR_REFITS, None, REFITS), (None, make.MIN_MATCHES_FOR_REFITS - 1, None, 0),
     (3, make.MIN_MATCHES_FOR_REFITS, None, 3), (3, make.MIN_MATCHES_FOR_REFITS - 1, None, "train matches, at least"),
     (0, 2, None, 0), (None, 1, 2, 2), (2, 1, 2, 2), (0, 1, 2, 0),
     (3, 99, 2, "the model of --prior has 2, which are corrected too")],
)  # fmt: skip
def test_refits_need_matches_or_those_of_the_prior(refits: int | None, matches: int, of_prior: int | None, found: Any) -> None:
    start: Any = None if of_prior is None else SimpleNamespace(refits=[None] * of_prior)
    if isinstance(found, str):
        with pytest.raises(ShuttleError, match=f"--refits {refits}: .*{found}"):
            make._checked_refits(refits, matches, start)
    else:
        assert make._checked_refits(refits, matches, start) == found


def test_splits_without_strokes_are_refused() -> None:
    rows = plain_rows(3)
    with pytest.raises(ShuttleError, match="no match of the split 'train' in the data"):
        splits.rows_of(rows, "train")
    named = plain_rows(3, matches=("x", matches_of("train")[0]), match=np.array([0, 1, 1], np.int32))
    assert len(splits.rows_of(named, "train")) == 2
    for share in (0.0, 1.0, -0.1, 1.1):
        with pytest.raises(ShuttleError, match="expected a number between 0 and 1, such as"):
            splits.train_and_validation(rows, share)
    club = plain_rows(10, matches=tuple("abcdefghij"), match=np.arange(10, dtype=np.int32))
    for share, aside in ((0.01, 1), (0.2, 2), (0.21, 3), (0.99, 9)):
        train, validation = splits.train_and_validation(club, share)
        assert (len(train), len(validation)) == (10 - aside, aside)


@pytest.mark.parametrize(("fold", "fine"), [(0, True), (1, True), (2, False), (-1, False)])
def test_an_index_has_the_forests_that_its_folds_name(fold: int, fine: bool, tmp_path: Path) -> None:
    dataclasses.replace(forests(), fold=np.array([fold], np.int32)).save(tmp_path / "h")
    if fine:
        found = Hurry.checked(read_tensors(tmp_path / "h"))
        assert (found.matches, found.fold.tolist(), found.value.tolist()) == (("b",), [fold], forests().value.tolist())
    else:
        with pytest.raises(ValueError, match="an unknown fold"):
            Hurry.checked(read_tensors(tmp_path / "h"))
