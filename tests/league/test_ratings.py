"""Ratings and intervals against closed forms, other libraries, and simulated leagues."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from shuttle_marl.league.ratings import (
    ELO,
    bradley_terry,
    exact_ratings,
    misfit,
    prior_wins,
    rank_intervals,
    ratings,
    wins_of,
)


def test_two_players() -> None:
    theta = bradley_terry(np.array([[0.0, 30.0], [10.0, 0.0]]))
    assert theta == pytest.approx([math.log(3) / 2, -math.log(3) / 2])
    assert ELO * math.log(10) == pytest.approx(400)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 9))
def test_another_library_finds_the_same(seed: int, n: int) -> None:
    choix = pytest.importorskip("choix")
    rng = np.random.default_rng(seed)
    wins = rng.integers(1, 2000, (n, n)).astype(float) ** rng.uniform(0.2, 1.0, (n, n))
    np.fill_diagonal(wins, 0)
    assert bradley_terry(wins) == pytest.approx(choix.ilsr_pairwise_dense(wins, tol=1e-12), abs=1e-6)


def test_the_prior_is_that_of_jeffreys() -> None:
    """The ratings make the likelihood times the root of the determinant of its information largest."""
    cells, pairs = np.array([[0, 0, 20], [1, 4, 5], [0, 3, 17.0]]), np.array([[0, 1], [0, 2], [1, 2]])
    wins = wins_of(cells, pairs, 3)

    def loss(free: np.ndarray) -> float:
        theta = np.array([*free, 0.0])
        p = 1 / (1 + np.exp(theta - theta[:, None]))
        curvature = (wins + wins.T) * p * (1 - p)
        information = np.diag(curvature.sum(axis=1)) - curvature
        return -float((wins * np.log(p)).sum() + np.linalg.slogdet(information[:2, :2])[1] / 2)

    free = minimize(loss, np.zeros(2), tol=1e-12).x
    expected = np.array([*free, 0.0])
    assert ratings(cells, pairs, 3, np.random.default_rng(0), replicates=1)[0] == pytest.approx(
        expected - expected.mean(), abs=1e-4
    )
    assert prior_wins(wins).sum() == pytest.approx(2)
    for lost in (0.0, 1.0, 3.0):
        assert prior_wins(np.array([[0.0, 120 - lost], [lost, 0]])) == pytest.approx(np.array([[0, 0.5], [0.5, 0]]))


def test_many_fits_at_once_are_single_fits() -> None:
    wins = np.random.default_rng(0).integers(1, 50, (5, 4, 4)).astype(float)
    assert bradley_terry(wins) == pytest.approx(np.array([bradley_terry(w) for w in wins]))


def league(theta: np.ndarray, cells: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Cells whose two matches are negatively correlated: half of them share one draw, as swapped seats do in part."""
    n = len(theta)
    pairs = np.array([(a, b) for a in range(n) for b in range(a + 1, n)])
    p = 1 / (1 + np.exp(theta[pairs[:, 1]] - theta[pairs[:, 0]]))
    u = rng.random((len(pairs), cells))
    twin = np.where(rng.random(u.shape) < 0.5, 1 - u, rng.random(u.shape))
    won = (u < p[:, None]).astype(int) + (twin < p[:, None])
    return np.stack([(won == k).sum(axis=1) for k in range(3)], axis=1).astype(float), pairs


def test_negatively_correlated_cells_give_shorter_intervals() -> None:
    """Independent matches with the same shares, as clusters of two, would be more uncertain."""
    pairs = np.array([[0, 1]])
    spread = [
        np.ptp(np.percentile(ratings(np.array([cells]), pairs, 2, np.random.default_rng(0))[1][:, 0], [2.5, 97.5]))
        for cells in ([10.0, 480.0, 10.0], [125.0, 250.0, 125.0])
    ]
    assert spread[0] < spread[1] / 2


def test_unbeaten_is_not_certain() -> None:
    found, drawn = ratings(np.array([[0.0, 0.0, 50.0]]), np.array([[0, 1]]), 2, np.random.default_rng(0))
    assert np.isfinite(found).all()
    assert np.ptp(np.percentile(ELO * drawn[:, 0], [2.5, 97.5])) > 50


def test_no_one_played() -> None:
    found, drawn = ratings(np.empty((0, 3)), np.empty((0, 2), dtype=np.intp), 3, np.random.default_rng(0), replicates=10)
    assert np.array_equal(found, np.zeros(3))
    assert np.array_equal(drawn, np.zeros((10, 3)))


def test_entrants_in_two_separate_groups_are_rated_within_them() -> None:
    wins = np.zeros((5, 5))
    wins[0, 1], wins[1, 0], wins[2, 3], wins[3, 2] = 30, 10, 10, 30
    theta = bradley_terry(wins)
    assert theta == pytest.approx(np.array([1, -1, -1, 1, 0]) * math.log(3) / 2)


def test_exact_ratings_are_the_limit_of_the_sampled_ones() -> None:
    rng = np.random.default_rng(0)
    theta = np.array([1.5, 0.4, 0.0, -0.7])
    cells, pairs = league(theta, 200_000, rng)
    match = 1 / (1 + np.exp(theta - theta[:, None]))
    match[:, 3] = match[3] = np.nan
    exact = exact_ratings(match)
    assert np.isnan(exact[3])
    assert exact[:3] == pytest.approx(theta[:3] - theta[:3].mean(), abs=1e-9)
    sampled = ratings(cells, pairs, 4, np.random.default_rng(0), replicates=2)[0]
    assert sampled[:3] - sampled[:3].mean() == pytest.approx(exact[:3], abs=0.01)
    certain = np.array([[0.5, 1.0], [0.0, 0.5]])
    assert np.isfinite(exact_ratings(certain)).all()


THETAS = ([1.0, 0.3, 0.2, -1.5], [0.0, 0.0, 0.0, 0.0], [5.0, 2.0, 0.0, -2.0, -5.0], [4.0, 0.0])
"""Entrants that are close, equal, so far from each other that they win all matches, and only two."""


def coverage(theta: list[float], runs: int) -> tuple[float, float]:
    """Share of simulated tournaments in which the intervals of ratings, and of ranks, hold the true ones."""
    rng = np.random.default_rng(2)
    true = np.array(theta) - np.mean(theta)
    best, worst = 1 + (true[:, None] < true).sum(axis=1), len(true) - (true[:, None] > true).sum(axis=1)
    rated, ranked = [], []
    for _ in range(runs):
        cells, pairs = league(true, 60, rng)
        found, drawn = ratings(cells, pairs, len(true), np.random.default_rng(int(rng.integers(1 << 30))), replicates=300)
        low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
        rated.extend(((low <= true) & (true <= high)).tolist())
        ranks = rank_intervals(found, drawn)
        ranked.extend(((ranks[:, 0] <= best) & (worst <= ranks[:, 1])).tolist())
    return float(np.mean(rated)), float(np.mean(ranked))


@pytest.mark.parametrize("theta", THETAS)
def test_intervals_of_ratings_and_ranks_hold(theta: list[float]) -> None:
    rated, ranked = coverage(theta, 60)
    assert 0.90 <= rated <= 0.99
    assert ranked >= 0.88


def test_ranks_that_are_sure() -> None:
    cells, pairs = league(np.array([2.0, 0.0, 0.0, -2.0]), 300, np.random.default_rng(0))
    assert rank_intervals(*ratings(cells, pairs, 4, np.random.default_rng(0))).tolist() == [[1, 1], [2, 3], [2, 3], [4, 4]]


def test_misfit_is_rare_where_the_model_holds_and_found_where_it_does_not() -> None:
    rng = np.random.default_rng(3)
    theta = np.array([0.8, 0.2, 0.0, -0.3, -0.7])
    rejected = []
    for _ in range(150):
        cells, pairs = league(theta, 100, rng)
        rejected.append(misfit(cells, pairs, ratings(cells, pairs, 5, np.random.default_rng(0), replicates=1)[0]).p < 0.05)
    assert 0 < np.mean(rejected) <= 0.12
    circle = np.array([[5.0, 10, 85], [85, 10, 5], [5, 10, 85]])
    pairs = np.array([[0, 1], [0, 2], [1, 2]])
    found = misfit(circle, pairs, ratings(circle, pairs, 3, np.random.default_rng(0), replicates=1)[0])
    assert found.degrees == 1
    assert found.p < 1e-9
    assert found.expected == pytest.approx([0.5] * 3)
    assert np.sign(found.z).tolist() == [1, -1, 1]
    assert math.isnan(misfit(circle[:1], pairs[:1], np.zeros(2)).p)
