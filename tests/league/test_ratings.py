"""Ratings and intervals against closed forms, other libraries, and simulated leagues."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from shuttle_marl.league.ranking import ELO, bradley_terry, ratings, smoothed, wilson, wins_of


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


def test_a_gradient_of_zero_at_one_sided_results() -> None:
    """The smoothed wins are lopsided, yet the expected wins are still the observed ones."""
    cells = np.array([[0, 0, 500], [0, 0, 500], [0, 3, 497]], dtype=float)
    pairs = np.array([[0, 1], [0, 2], [1, 2]])
    counts = smoothed(cells)
    wins = wins_of(counts / counts.sum(axis=1, keepdims=True), counts.sum(axis=1), pairs, 3)
    theta = bradley_terry(wins)
    assert np.isfinite(theta).all()
    expected = (wins + wins.T) / (1 + np.exp(theta[None, :] - theta[:, None]))
    assert expected.sum(axis=1) == pytest.approx(wins.sum(axis=1), rel=1e-8)


def test_many_fits_at_once_are_single_fits() -> None:
    wins = np.random.default_rng(0).integers(1, 50, (5, 4, 4)).astype(float)
    assert bradley_terry(wins) == pytest.approx(np.array([bradley_terry(w) for w in wins]))


def league(theta: np.ndarray, cells: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Cells whose two matches are negatively correlated: they share one draw, as swapped seats do."""
    n = len(theta)
    pairs = np.array([(a, b) for a in range(n) for b in range(a + 1, n)])
    p = 1 / (1 + np.exp(theta[pairs[:, 1]] - theta[pairs[:, 0]]))
    u = rng.random((len(pairs), cells))
    won = (u < p[:, None]).astype(int) + (1 - u < p[:, None])
    return np.stack([(won == k).sum(axis=1) for k in range(3)], axis=1).astype(float), pairs


def test_simulated_ratings_are_found_and_lie_in_their_intervals() -> None:
    rng = np.random.default_rng(1)
    theta = np.array([1.5, 0.5, 0.0, -0.6, -1.4])
    inside = []
    for _ in range(60):
        cells, pairs = league(theta, 200, rng)
        found, drawn = ratings(cells, pairs, 5, seed=0, replicates=300)
        assert found == pytest.approx(theta, abs=0.35)
        low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
        inside.extend(((low <= theta) & (theta <= high)).tolist())
    assert 0.90 <= np.mean(inside) <= 0.99


def test_negatively_correlated_cells_give_shorter_intervals() -> None:
    """Independent matches with the same shares, as clusters of two, would be more uncertain."""
    pairs = np.array([[0, 1]])
    spread = [
        np.ptp(np.percentile(ratings(np.array([cells]), pairs, 2, seed=0)[1][:, 0], [2.5, 97.5]))
        for cells in ([10.0, 480.0, 10.0], [125.0, 250.0, 125.0])
    ]
    assert spread[0] < spread[1] / 2


def test_unbeaten_is_not_certain() -> None:
    found, drawn = ratings(np.array([[0.0, 0.0, 50.0]]), np.array([[0, 1]]), 2, seed=0)
    assert np.isfinite(found).all()
    assert np.ptp(np.percentile(ELO * drawn[:, 0], [2.5, 97.5])) > 50


def test_no_one_played() -> None:
    found, drawn = ratings(np.empty((0, 3)), np.empty((0, 2), dtype=np.intp), 3, seed=0, replicates=10)
    assert np.array_equal(found, np.zeros(3))
    assert np.array_equal(drawn, np.zeros((10, 3)))


@given(st.integers(0, 1000), st.integers(1, 1000))
def test_wilson(wins: int, losses: int) -> None:
    expected = binomtest(wins, wins + losses).proportion_ci(method="wilson")
    assert wilson(wins, wins + losses) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_wilson_without_matches() -> None:
    assert all(map(math.isnan, wilson(0, 0)))
