"""The sequential test against its definition, and its errors in simulated pairings."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from shuttle_marl.game import load_game
from shuttle_marl.league.entrants import enter
from shuttle_marl.league.tournament import (
    BOUND,
    ERROR,
    MatchOptions,
    Tournament,
    decided,
    log_likelihood_ratio,
    round_robin,
    share_of,
)

ELO = 40.0


def test_the_ratio_is_that_of_the_likeliest_distributions_with_the_two_means() -> None:
    cells = (31, 120, 49)

    def likelihood(mean: float) -> float:
        """By a general optimiser, over the probability of a split; the mean leaves one number free."""

        def loss(split: np.ndarray) -> float:
            both = mean - split[0] / 2
            p = np.array([1 - split[0] - both, split[0], both])
            return 1e9 if (p <= 0).any() else -float((np.array(cells) * np.log(p)).sum())

        return -minimize(loss, [0.5], method="Nelder-Mead", options={"xatol": 1e-12, "fatol": 1e-12}).fun

    expected = likelihood(share_of(ELO)) - likelihood(share_of(-ELO))
    assert log_likelihood_ratio(cells, ELO) == pytest.approx(expected, abs=1e-6)
    assert log_likelihood_ratio(cells[::-1], ELO) == pytest.approx(-expected, abs=1e-6)
    assert share_of(400) == pytest.approx(10 / 11)
    assert math.isfinite(log_likelihood_ratio((0, 0, 5), 1000.0))
    assert log_likelihood_ratio((0, 0, 0), ELO) == pytest.approx(0, abs=1e-9)


def distribution(mean: float, correlation: float) -> np.ndarray:
    """Results of cells of two matches, each won with a probability, that are correlated."""
    both = mean**2 + correlation * mean * (1 - mean)
    return np.array([1 - 2 * mean + both, 2 * (mean - both), both])


def simulate(elo: float, correlation: float, runs: int, looks: int = 16) -> tuple[float, float]:
    """Share of the pairings that were decided for the weaker one, and mean number of cells."""
    rng = np.random.default_rng(0)
    p = distribution(share_of(elo), correlation)
    wrong, used = 0, 0
    for _ in range(runs):
        cells = np.zeros(3, dtype=int)
        while not decided(tuple(cells), ELO):
            cells += rng.multinomial(looks, p)
        wrong += log_likelihood_ratio(tuple(cells), ELO) < 0
        used += cells.sum()
    return wrong / runs, used / runs


def test_errors_are_as_rare_as_promised() -> None:
    found, cells = simulate(ELO, -0.3, 250)
    assert found <= ERROR + 3 * math.sqrt(ERROR / 250)
    assert cells < 100  # a fixed number of cells with the same errors needs about twice as many


def test_bounds_of_the_test_are_those_of_wald() -> None:
    assert pytest.approx(math.log(0.95 / 0.05)) == BOUND


def test_a_pairing_stops_when_it_is_decided(small_model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    game = load_game(small_model)
    monkeypatch.setattr("shuttle_marl.league.entrants.reads_score", lambda policy: True)
    asked = enter("safe", game)
    monkeypatch.undo()
    entrants = [asked, enter("random", game), enter("attacking", game)]

    def results(batch: int, decide: float | None) -> list[tuple[int, tuple[int, int, int]]]:
        options = MatchOptions(matches=64, seed=1, batch=batch, keep_strokes=True, decide=decide)
        tournament = Tournament(game, entrants, options)
        blocks = [block for group in tournament.play(round_robin(["a", "b", "c"])) for block in group]
        return [(sum(seat["matches"] for seat in result.seats), result.cells) for result, _ in blocks]

    short, whole = results(64, 200.0), results(8192, None)
    assert short == results(8192, 200.0)
    assert short[2] == whole[2]  # both have tables
    for (matches, cells), (_, all_cells) in zip(short[:2], whole[:2], strict=True):
        assert matches % 32 == 0
        assert matches == 2 * sum(cells)
        assert 32 <= matches <= 64
        assert all(a <= b for a, b in zip(cells, all_cells, strict=True))
        assert matches == 64 or abs(log_likelihood_ratio(cells, 200.0)) >= BOUND
