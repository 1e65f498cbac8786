"""Parts of the fits compared with closed forms and plain loops."""

import math

import numpy as np
import pytest
from scipy.special import expit, logit

from shuttle_marl.dynamics import evaluate, skill
from shuttle_marl.dynamics.choices import Choices, fit_shifts
from shuttle_marl.dynamics.evaluate import calibration_error, log_losses, reliability, scores
from shuttle_marl.dynamics.features import SLOTS
from shuttle_marl.dynamics.fitted import tilted
from shuttle_marl.dynamics.models import log_loss, log_odds, sigmoid, softmax
from shuttle_marl.dynamics.modules import Situations, Trees


def test_faults_are_averaged_over_situations_and_moved_to_a_mean() -> None:
    weights = np.array([[0.5, 0.5, 0, 0], [0, 0, 0, 1]])
    z = np.array([[-1.0, 0.0], [0.5, -2.0]])
    expected = np.stack([0.5 * expit(z[0]) + 0.5 * expit(z[0] + 0.5), expit(z[1] + 1.5)])
    unknown = np.zeros((SLOTS["incoming_shot"], SLOTS["shot"]))
    found = Situations(effort=np.array([0.0, 0.5]), duel=1.0, effort_share=np.array([[0.75, 0.25]]), duel_share=0.25,
                       hurried_share=unknown)  # fmt: skip
    assert found.mixed(z, weights) == pytest.approx(expected)
    assert found.mixed(z[:, 0], weights) == pytest.approx(expected[:, 0])
    share = np.array([[0.25, 0.75], [1.0, 0.0]])
    moved = found.moved_to(np.array([0.2, 0.6]), z, weights, share)
    assert (share * found.mixed(moved, weights)).sum(axis=1) == pytest.approx([0.2, 0.6])
    assert np.diff(moved, axis=1) == pytest.approx(np.diff(z, axis=1)), "the logits of a row move alike"


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


def test_logits_and_probabilities() -> None:
    p = np.array([0.2, 0.5, 0.999])
    assert log_odds(p) == pytest.approx(logit(p))
    assert sigmoid(log_odds(p)) == pytest.approx(p)
    assert log_odds(np.array([0.0, 1.0])) == pytest.approx([logit(1e-9), -logit(1e-9)])
    assert softmax(np.log([[1.0, 3.0], [2.0, 2.0]]) + 1000) == pytest.approx(np.array([[0.25, 0.75], [0.5, 0.5]]))
    assert tilted(np.array([0.5, 0.25, 0.25]), np.log([1.0, 2.0, 4.0])) == pytest.approx([0.25, 0.25, 0.5])


def test_fitted_shifts_balance_the_data_and_the_prior() -> None:
    base = np.tile([0.5, 0.3, 0.2], (60, 1))
    label, one, two = np.arange(60) % 3, np.arange(60) % 2, np.arange(60) // 30
    tables = fit_shifts(base, label, (one, two), (2, 2), (2.0, 5.0))
    p = tilted(base, tables[0][one] + tables[1][two])
    surplus = np.eye(3)[label] - p
    for table, at, precision in zip(tables, (one, two), (2.0, 5.0), strict=True):
        expected = np.stack([surplus[at == k].sum(axis=0) for k in range(2)]) / precision
        assert table == pytest.approx(expected, abs=1e-4), "at the mode the gradient is 0"
    single = Choices(base, np.zeros(60, int), np.zeros(60, int), label).shifts(1, 1, 3.0)
    residual = (np.eye(3)[label] - tilted(base, single[0, 0])).sum(axis=0)
    assert single[0, 0] == pytest.approx(residual / 3 + residual / 12, abs=1e-4)


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
